"""Findings: one folder each with the files that reproduce the fault."""

import os
import re
import shlex
import shutil
import stat
import threading
from collections import Counter
from pathlib import Path

from judge import Fault
from process import Ended

KEPT = 3
"""Findings kept of a kind; the rest are counted."""
LARGEST_FILE = 64 << 20
LARGEST_INPUT = 256 << 20


class Findings:
    """All findings of a campaign."""

    def __init__(self, folder: Path, binary: Path) -> None:
        self.folder, self.binary = folder, binary
        self.counts: Counter[tuple[str, str, str]] = Counter()
        self.records: list[dict[str, object]] = []
        self.lock = threading.Lock()

    def add(self, case: "object", fault: Fault, ended: Ended | None) -> str | None:
        """Keeps a finding if few of its kind exist; returns its name."""
        key = (case.attack, fault.kind, fault.signature)
        with self.lock:
            self.counts[key] += 1
            if self.counts[key] > KEPT:
                return None
            words = re.sub(r"[^a-z0-9]+", "-", f"{fault.kind} {case.label}".lower()).strip("-")
            name = f"{len(self.records) + 1:04}-{words[:60]}"
            record = {
                "name": name,
                "attack": case.attack,
                "case": f"{case.attack}/{case.number}",
                "about": case.label,
                "kind": fault.kind,
                "signature": fault.signature,
                "found": fault.found,
                "expected": fault.expected,
                "command": shlex.join(["kinegrad", *ended.arguments]) if ended else None,
            }
            self.records.append(record)
        folder = self.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        copied(case.folder, folder / "input")
        write(
            folder / "expected.txt",
            f"found: {fault.found}\nexpected: {fault.expected}\ncase: {record['case']}\n",
        )
        if ended:
            write(folder / "stdout", ended.stdout)
            write(folder / "stderr", ended.stderr)
            write(folder / "exit_code", f"{ended.code}\n")
        self._write_command(folder, case, fault, ended)
        return name

    def _write_command(self, folder: Path, case: object, fault: Fault, ended: Ended | None) -> None:
        lines = [
            "#!/bin/sh",
            f"# found: {' '.join(fault.found.split())}",
            f"# expected: {' '.join(fault.expected.split())}",
            f"# the whole case again: scripts/campaign/run --seed {case.seed} --replay "
            f"{case.attack}/{case.number}",
            'cd "$(dirname "$0")/input" || exit',
            *[f"export {name}={shlex.quote(value)}" for name, value in case.variables.items()],
            f'KINEGRAD="${{KINEGRAD:-{self.binary}}}"',
        ]
        lines += ["# before: " + line.replace("\n", "\\n") for line in case.history[:-1]]
        if ended:
            made = "runs" if ended.arguments[0] == "train" else "out"
            if "--resume" not in ended.arguments:
                lines.append(f"rm -rf {made}  # what an earlier call has made")
            if ended.limits.memory is not None:
                lines.append(f"ulimit -v {ended.limits.memory >> 10}")
            if ended.limits.file_size is not None:
                lines.append("trap '' XFSZ" if not ended.limits.file_size_signal else "")
                lines.append(f"# the limit on files was {ended.limits.file_size} bytes")
                lines.append(f"ulimit -f {max(ended.limits.file_size >> 9, 1)}")
            lines.append(f'"$KINEGRAD" {shlex.join(ended.arguments)}')
            lines.append('echo "exit code $?"')
        script = folder / "command.sh"
        write(script, "\n".join(lines) + "\n")
        script.chmod(0o755)

    @property
    def total(self) -> int:
        """Number of findings."""
        return sum(self.counts.values())


def write(path: Path, text: str) -> None:
    """Writes text in which names of files may be any bytes."""
    path.write_text(text, errors="surrogateescape")


def copied(source: Path, target: Path) -> None:
    """Copies a folder; links stay links, pipes are created again, large files are omitted."""
    target.mkdir(parents=True, exist_ok=True)
    room = LARGEST_INPUT
    for path in sorted(source.rglob("*")):
        other = target / path.relative_to(source)
        try:
            status = path.lstat()
            if stat.S_ISDIR(status.st_mode):
                other.mkdir(parents=True, exist_ok=True)
            elif stat.S_ISLNK(status.st_mode):
                other.symlink_to(path.readlink())
            elif stat.S_ISFIFO(status.st_mode):
                os.mkfifo(other)
            elif status.st_size > LARGEST_FILE or status.st_size > room:
                with other.open("wb") as file:
                    file.truncate(status.st_size)
            else:
                room -= status.st_size
                other.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, other)
        except OSError:
            continue
