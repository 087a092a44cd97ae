"""Inputs that double: time and memory must not grow faster."""

import os
import shutil
from collections.abc import Iterable

from attack import Attack
from case import Case, Setting
from growing import Reader, arrays, lists, of_runs
from growing_ground import goals, paths
from growing_takes import captures, songs
from judge import SUCCESS
from process import Ended, Limits

MOST_GROWTH = 2.5
"""Of time and of memory from one size to its double."""
FLOOR_SECONDS = 0.3
"""Added to the time that the smaller size allows."""
FLOOR_BYTES = 48 << 20
"""The same of memory."""
REPEATS = 3
"""Measurements of both sizes before a finding."""
ENOUGH_SECONDS = 4.0
"""Work of one command after which the input does not grow any more."""
LARGEST_INPUT = 6 << 20
Measured = tuple[float, int]
"""Seconds of work, and peak resident bytes."""


class Growth(Attack):
    """Each reader with an input that doubles until it is large or slow."""

    name = "growth"
    weight = 8

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.readers: list[Reader] = [
            *arrays(), *paths(), *goals(), *captures(), *songs(), *lists(), *of_runs(setting.recipes),
        ]

    def total(self) -> int | None:
        """Each reader once."""
        return len(self.readers)

    def attack(self, case: Case) -> None:
        """Doubles the input of one reader."""
        reader = self.readers[case.number]
        case.label = reader.name
        size, before = reader.start, None
        while size <= reader.most:
            measured, ended, total = self.measure(case, reader, size)
            case.counts["taken"] += ended.code == SUCCESS
            case.counts["sizes"] += 1
            if before and grew(before, measured):
                before = least(self.measure(case, reader, size // 2)[0] for _ in range(REPEATS))
                measured = least(self.measure(case, reader, size)[0] for _ in range(REPEATS))
                if what := grew(before, measured):
                    found = f"{what} with {total} bytes of input, size {size} after {size // 2}"
                    limit = f"{MOST_GROWTH} times as much for a double size"
                    case.wrong("growth", what.split()[0], found, limit, ended)
                    return
            if measured[0] > ENOUGH_SECONDS or total > LARGEST_INPUT or ended.hang:
                return
            size, before = 2 * size, measured

    def measure(self, case: Case, reader: Reader, size: int) -> tuple[Measured, Ended, int]:
        """Time and memory of a size, the end, and the size of the input in bytes."""
        folder = case.folder / "in"
        shutil.rmtree(folder, ignore_errors=True)
        for name in ("out", "out.svg", "out.bvh", "runs"):
            remove(case, name)
        total = 0
        for name, content in reader.files(size).items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            total += len(content)
        ended = case.run(*reader.command, limits=Limits(memory=self.setting.bounded.memory))
        return (ended.cpu, ended.peak), ended, total


def remove(case: Case, name: str) -> None:
    """Removes an output of the measurement before."""
    path = case.folder / name
    if path.is_dir():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()


def least(measured: Iterable[Measured]) -> Measured:
    """The least of each: other processes only add."""
    seconds, peaks = zip(*measured)
    return min(seconds), min(peaks)


def grew(before: Measured, after: Measured) -> str:
    """What has grown too much; empty if nothing."""
    if after[0] > MOST_GROWTH * before[0] + FLOOR_SECONDS:
        return f"time grows from {before[0]:.2f} to {after[0]:.2f} s"
    if after[1] > MOST_GROWTH * before[1] and after[1] > before[1] + FLOOR_BYTES:
        return f"memory grows from {before[1] >> 20} to {after[1] >> 20} MiB"
    return ""
