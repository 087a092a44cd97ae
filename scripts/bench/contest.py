"""Processes that run a row's steps in turn, and the results."""

import array
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from load import TOLERABLE, load_now
from rows import Row

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
TOLERANCE = 1e-3
"""Largest relative difference of first losses, and of samples relative to their largest value."""
SETTLE_SECONDS = 0.1
"""Pause before each step: the threads of the previous process still spin."""


class Failure(Exception):
    """A row that has no numbers, and why."""


@dataclass(frozen=True)
class Setting:
    """Shared settings of all rows."""

    python: str
    """Interpreter that has torch."""
    worker: Path
    """kinegrad's worker."""
    device: str
    threads: int
    folder: Path
    """For files."""
    against: Path | None = None
    """Another build of kinegrad's worker, in place of PyTorch."""

    def environment(self) -> dict[str, str]:
        """Environment of every process. OpenMP's wait policy is not changed: without spinning,
        PyTorch takes twice as long for these steps."""
        paths = [str(ROOT / "scripts" / "peer"), os.environ.get("PYTHONPATH")]
        return os.environ | {
            "OMP_NUM_THREADS": str(self.threads),
            "RAYON_NUM_THREADS": str(self.threads),
            "PYTHONPATH": os.pathsep.join(path for path in paths if path),
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    @property
    def contenders(self) -> dict[str, list[str]]:
        """The commands of all sides, kinegrad's first."""
        kinegrad = [str(self.worker), "{folder}", self.device]
        if self.against:
            return {"kinegrad": kinegrad, "other build": [str(self.against), *kinegrad[1:]]}
        pytorch = [self.python, str(HERE / "torch_worker.py"), "{folder}", self.device]
        sides = {"kinegrad": kinegrad, "PyTorch": pytorch}
        if self.device != "cpu":
            sides["PyTorch compiled"] = [*pytorch, "--compile"]
        return sides


@dataclass
class Side:
    """The measurements of one process."""

    parameters: int
    start_kib: int | None
    seconds: list[float] = field(default_factory=list)
    """Of each round that counts."""
    losses: list[float | None] = field(default_factory=list)
    """Of every round."""
    peak_kib: int | None = None
    """Peak resident set of the steps; on a GPU, allocated device memory."""

    def counted_mib(self, row: Row) -> float | None:
        """The peak without uncounted memory."""
        if self.peak_kib is None or self.start_kib is None:
            return None
        return (self.peak_kib - self.start_kib) / 1024 - row.floor_bytes / 1024**2

    @property
    def peak_mib(self) -> float | None:
        """The raw peak."""
        return None if self.peak_kib is None else self.peak_kib / 1024


class Worker:
    """A process that waits for lines and answers each with one."""

    def __init__(self, name: str, command: list[str], setting: Setting, errors: IO[str]) -> None:
        self.name = name
        self.errors = errors
        self.on_gpu = setting.device != "cpu"
        self.held_kib: int | None = 0
        before = self._device_memory()
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env=setting.environment(),
        )
        ready = self._answer()
        self._count_device_memory(before)
        start_kib = 0 if self.on_gpu else ready["start_kib"]
        self.side = Side(ready["parameters"], start_kib)

    def ask(self, line: str) -> dict[str, Any]:
        """The answer to a line."""
        try:
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # the answer has the reason
        return self._answer()

    def step(self) -> float:
        """One step; its seconds."""
        time.sleep(SETTLE_SECONDS)
        before = self._device_memory()
        answer = self.ask("step")
        self._count_device_memory(before)
        self.side.losses.append(answer["loss"])
        self.side.peak_kib = self.held_kib if self.on_gpu else answer["peak_kib"]
        return answer["seconds"]

    def end(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.communicate()

    def _answer(self) -> dict[str, Any]:
        line = self.process.stdout.readline()
        if line:
            return json.loads(line)
        code = self.process.wait()
        self.errors.seek(0)
        lines = [text.rstrip() for text in self.errors if text.strip()]
        reason = "\n".join(lines[-12:]) or "it said nothing"
        raise Failure(f"{self.name} ended with {code}:\n{reason}")

    def _device_memory(self) -> int | None:
        """KiB in use on the GPU by all processes, if known."""
        if not self.on_gpu:
            return None
        query = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
        try:
            answer = subprocess.run(query, capture_output=True, text=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError):
            return None
        return int(answer.split()[0]) * 1024

    def _count_device_memory(self, before: int | None) -> None:
        """Assigns the growth of GPU memory to this process, which alone was working."""
        after = self._device_memory()
        if self.on_gpu and (before is None or after is None):
            self.held_kib = None
        elif self.on_gpu and self.held_kib is not None:
            self.held_kib += after - before


@contextmanager
def workers(row: Row, setting: Setting, names: list[str]) -> Iterator[list[Worker]]:
    """The named sides of a row, ready for their first step."""
    folder = prepare(row, setting)
    with ExitStack() as stack:
        started = []
        for name in names:
            errors = stack.enter_context(tempfile.TemporaryFile("w+"))
            command = [part.format(folder=folder) for part in setting.contenders[name]]
            worker = Worker(name, command, setting, errors)
            stack.callback(worker.end)
            if worker.side.parameters != row.parameters:
                found = f"{worker.side.parameters:,} parameters"
                raise Failure(f"{name} has {found}, where {row.parameters:,} are expected")
            started.append(worker)
        yield started


def prepare(row: Row, setting: Setting) -> Path:
    """The folder with the files of both workers."""
    folder = setting.folder / row.name
    if folder.exists():
        return folder
    folder.mkdir()
    networks = f"{row.model['kind']}_{row.parameters}.safetensors"
    spec = row.spec(str(setting.folder / networks))
    Path(folder, "row.json").write_text(json.dumps(spec))
    command = [setting.python, str(HERE / "torch_inputs.py"), str(folder)]
    made = subprocess.run(command, capture_output=True, text=True, env=setting.environment())
    if made.returncode != 0:
        raise Failure(f"the inputs could not be made:\n{made.stderr.strip()}")
    return folder


@dataclass
class Measured:
    """A row's numbers."""

    sides: dict[str, Side]
    """By contender."""
    differences: dict[str, float]
    """Difference of the others' losses or samples from kinegrad's."""
    quiet: bool
    """True if the machine was quiet in the counted rounds."""


def measure(row: Row, setting: Setting, rounds: int) -> Measured:
    """All sides of a row, in turn."""
    with workers(row, setting, list(setting.contenders)) as contenders:
        for index in range(row.warm_up):
            for worker in contenders:
                worker.step()
            if index == 0 and row.trains:
                check_first_losses(contenders)
        quiet = timed_rounds(contenders, rounds)
        ours, *others = contenders
        if row.trains:
            differences = {w.name: loss_difference(ours.side, w.side) for w in others}
        else:
            differences = sample_differences(contenders, setting.folder / row.name)
        return Measured(
            sides={worker.name: worker.side for worker in contenders},
            differences=differences,
            quiet=quiet,
        )


def timed_rounds(contenders: list[Worker], rounds: int) -> bool:
    """Times rounds on a quiet machine, with up to twice as many tries. Returns True if at least
    half were quiet; else the disturbed ones count too."""
    processes = [os.getpid(), *(worker.process.pid for worker in contenders)]
    quiet: list[dict[str, float]] = []
    disturbed: list[dict[str, float]] = []
    while len(quiet) < rounds and len(quiet) + len(disturbed) < 2 * rounds:
        # Whoever goes first finds another machine than whoever goes second.
        order = contenders[:: 1 if (len(quiet) + len(disturbed)) % 2 == 0 else -1]
        before = load_now(processes)
        seconds = {worker.name: worker.step() for worker in order}
        after = load_now(processes)
        busy = before and after and after.elsewhere_since(before) > TOLERABLE
        (disturbed if busy else quiet).append(seconds)
    enough = 2 * len(quiet) >= rounds
    for worker in contenders:
        counted = quiet if enough else quiet + disturbed
        worker.side.seconds = [seconds[worker.name] for seconds in counted]
    return enough


def peak_only(row: Row, setting: Setting, name: str) -> float | None:
    """The counted memory of one side, for a row that is compared with another row's."""
    with workers(row, setting, [name]) as (worker,):
        for _ in range(row.warm_up + 1):
            worker.step()
        return worker.side.counted_mib(row)


def check_first_losses(contenders: list[Worker]) -> None:
    """Refuses to compare the speed of different computations."""
    ours, *others = contenders
    for other in others:
        difference = loss_difference(ours.side, other.side)
        if not difference <= TOLERANCE:
            losses = f"{ours.side.losses[0]} (kinegrad) and {other.side.losses[0]} ({other.name})"
            raise Failure(f"the first losses differ by {difference:.1e} of their size: {losses}")


def loss_difference(ours: Side, theirs: Side) -> float:
    """The largest over all rounds, relative."""
    pairs = zip(ours.losses, theirs.losses, strict=True)
    return max(abs(a - b) / max(abs(b), sys.float_info.min) for a, b in pairs)


def sample_differences(contenders: list[Worker], folder: Path) -> dict[str, float]:
    """Largest difference of samples from kinegrad's, relative to the largest value."""
    samples = {}
    for worker in contenders:
        path = folder / "sample"
        worker.ask(f"save {path}")
        samples[worker.name] = array.array("f", path.read_bytes())
    for name, sample in samples.items():
        if not all(map(math.isfinite, sample)):
            raise Failure(f"the sample of {name} is not finite")
    ours = samples.pop("kinegrad")
    differences = {}
    for name, theirs in samples.items():
        scale = max(map(abs, theirs))
        difference = max(abs(a - b) for a, b in zip(ours, theirs, strict=True)) / scale
        if not difference <= TOLERANCE:
            raise Failure(f"the samples of kinegrad and {name} differ by {difference:.1e}")
        differences[name] = difference
    return differences
