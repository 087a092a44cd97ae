"""One case of an attack, and the shared state of all cases."""

import array
import math
import os
import random
import shlex
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from findings import Findings
from judge import FAILED, INVALID, SUCCESS, Fault, judged
from process import Ended, Limits, Process
from recipes import Recipe
from texts import table_faults
from turns import Turns

USUAL = (SUCCESS, FAILED, INVALID)
ROOM = 2 << 30
"""Bytes of address space that a damaged input may take beyond a valid one."""
RESIDENT_ROOM = 1 << 30
"""The same of resident memory."""


@dataclass
class Setting:
    """Shared state of all cases."""

    root: Path
    """Root of the repository."""
    out: Path
    binary: Path
    seed: int
    turns: Turns
    findings: Findings
    say: Callable[[str], None]
    recipes: list[Recipe] = field(default_factory=list)
    memory: Path = Path()
    """Folders of active cases that need no disk: in memory, if possible."""
    address_space: int = 2 << 30
    """Memory of the largest valid command, bytes."""
    resident: int = 256 << 20

    @property
    def shared(self) -> Path:
        """Files that cases read and never change."""
        return self.out / "shared"

    @property
    def work(self) -> Path:
        """Folders of active cases."""
        return self.out / "work"

    @property
    def bounded(self) -> Limits:
        """The limits of a command on a damaged input."""
        return Limits(memory=self.address_space + ROOM)

    def environment(self) -> dict[str, str]:
        """Environment of every process: no user settings, one thread."""
        home = self.out / "home"
        home.mkdir(exist_ok=True)
        return {
            "PATH": os.environ.get("PATH", ""),
            "HOME": str(home),
            "XDG_CACHE_HOME": str(home / "cache"),
            **VARIABLES,
        }


VARIABLES = {"RAYON_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1", "RUST_BACKTRACE": "0"}


class Stopped(Exception):
    """The campaign is over."""


class Case:
    """A case: a folder, its random numbers and its events."""

    over = threading.Event()

    def __init__(self, setting: Setting, attack: str, number: int, on_disk: bool = True) -> None:
        self.setting, self.attack, self.number = setting, attack, number
        self.seed = setting.seed
        self.random = random.Random(f"{setting.seed}/{attack}/{number}")
        self.label = attack
        """The subject, for the name of a finding."""
        self.folder = (setting.work if on_disk else setting.memory) / f"{attack}-{number}"
        self.variables = dict(VARIABLES)
        """Environment of its processes, beyond that of all."""
        self.since = 0
        """Start of its last process, nanoseconds."""
        self.history: list[str] = []
        self.counts: Counter[str] = Counter()
        self.found: list[str] = []
        self.faults = 0
        self.peak = 0
        self.slowest: tuple[float, str] = (0.0, "")

    def __enter__(self) -> "Case":
        self.remove()
        self.folder.mkdir(parents=True)
        (self.folder / "shared").symlink_to(self.setting.shared)
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Removes the folder."""
        with suppress(FileNotFoundError):
            shutil.rmtree(self.folder)

    def start(self, arguments: list[str], limits: Limits | None = None) -> Process:
        """Starts the program; the caller has acquired the slots."""
        if self.over.is_set():
            raise Stopped
        self.since = time.time_ns()
        self.history.append("kinegrad " + shlex.join(arguments))
        return Process(
            self.setting.binary,
            arguments,
            self.folder,
            {**self.setting.environment(), **self.variables},
            limits or Limits(),
        )

    def run(
        self,
        *arguments: object,
        limits: Limits | None = None,
        allowed: tuple[int, ...] = USUAL,
        writes: str | None = None,
        enough: Callable[[float], bool] | None = None,
    ) -> Ended:
        """Runs the program to its end, or until `enough` returns True, and judges the end. With
        exit code 0 it must have written `writes`."""
        with self.setting.turns.taken():
            process = self.start([str(argument) for argument in arguments], limits)
            ended = process.wait(enough=enough)
        self.judge(ended, allowed, writes)
        return ended

    def judge(
        self, ended: Ended, allowed: tuple[int, ...] = USUAL, writes: str | None = None
    ) -> None:
        """Records the faults of an end."""
        if self.over.is_set():
            raise Stopped
        self.counts["commands"] += 1
        self.peak = max(self.peak, ended.peak)
        if not ended.killed:
            self.slowest = max(self.slowest, (ended.cpu, shlex.join(ended.arguments)))
        # A setting may ask for a large network.
        room = ROOM if ended.limits.much else RESIDENT_ROOM
        most = self.setting.resident + room
        for fault in judged(ended, self.label, allowed, most):
            self.finding(fault, ended)
        for kind, found in table_faults(self.folder, self.since):
            self.wrong(kind, ended.arguments[0], found, "numbers and plain text", ended)
        if writes and ended.code == 0 and not (self.folder / writes).exists():
            found = f"exit code 0, and nothing in `{writes}`"
            self.finding(Fault("nothing written", ended.arguments[0], found, "a file"), ended)

    def finding(self, fault: Fault, ended: Ended | None = None) -> None:
        """Records a finding."""
        self.faults += 1
        name = self.setting.findings.add(self, fault, ended)
        if name:
            self.found.append(name)
            self.setting.say(f"FOUND {name} in {self.attack}/{self.number}: {fault.found}")

    def must_be_finite(self, ended: Ended, pattern: str) -> None:
        """Written arrays must contain finite numbers."""
        for path in sorted(self.folder.glob(pattern)) if ended.code == SUCCESS else []:
            if not finite(path.read_bytes()):
                found = f"exit code 0, and a number in {path.name} is not finite"
                self.wrong("not finite", ended.arguments[0], found, "finite numbers", ended)
                return

    def wrong(
        self, kind: str, signature: str, found: str, expected: str, ended: Ended | None = None
    ) -> None:
        """Records a finding of an attack's own kind."""
        self.finding(Fault(kind, f"{self.label}: {signature}", found, expected), ended)


def finite(content: bytes) -> bool:
    """True if all numbers of an npy file of float32 are finite."""
    start = 10 + int.from_bytes(content[8:10], "little")
    if b"<f4" not in content[:start]:
        return True
    numbers = array.array("f")
    numbers.frombytes(content[start:start + (len(content) - start) // 4 * 4])
    return all(map(math.isfinite, numbers))
