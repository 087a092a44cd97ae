"""Full disks and limited file sizes: no damage, and the run resumes."""

import contextlib
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

from attack import TRAINING, RunAttack
from case import Case, Setting
from judge import FAILED, INVALID, SUCCESS
from process import Limits
from recipes import Recipe


class Disks(RunAttack):
    """A limit on the size of files, and a small file system in memory."""

    name = "disks"
    weight = 2

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.mounts = can_mount(setting.work / "mount")
        if not self.mounts:
            setting.say("SKIPPED: no file system can be mounted here (needs root): disks by limits")
        self.sizes = {recipe.name: sizes(recipe.reference) for recipe in setting.recipes}

    def attack(self, case: Case) -> None:
        """Fills the disk of a new run or of one that was killed."""
        recipe = self.recipe(case)
        mounted = self.mounts and case.random.random() < 0.4
        with small_disk(case.folder / "runs") if mounted else contextlib.nullcontext() as resize:
            if case.random.random() < 0.6 and not self.half_run(case, recipe):
                return
            if mounted:
                self.fill(case, recipe, resize)
            else:
                self.limit(case, recipe)
            if (case.folder / "runs/small").exists():
                self.complete(case, recipe)

    def limit(self, case: Case, recipe: Recipe) -> None:
        """Trains with a limit on the size of files."""
        largest = max(self.sizes[recipe.name])
        size = int(largest * 1.1 * case.random.random() ** 2)
        if case.random.random() < 0.3:
            size = max(case.random.choice(self.sizes[recipe.name]) + case.random.randint(-1, 1), 0)
        deadly = case.random.random() < 0.3
        limits = Limits(60, 60, file_size=size, file_size_signal=deadly)
        case.label += f" files of {'deadly ' if deadly else ''}limit"
        self.train(case, recipe, limits)

    def fill(self, case: Case, recipe: Recipe, resize: Callable[[int], None]) -> None:
        """Trains on a disk with too little room."""
        used = shutil.disk_usage(case.folder / "runs").used
        room = int(3 * sum(self.sizes[recipe.name]) * case.random.random() ** 2)
        resize(used + room + 8192)
        case.label += " full disk"
        self.train(case, recipe, TRAINING)
        resize(64 << 20)

    def train(self, case: Case, recipe: Recipe, limits: Limits) -> None:
        """Trains with too little room."""
        ended = case.run(*self.training(case, recipe), limits=limits, allowed=(0, 1, 2))
        case.counts["full"] += ended.code != SUCCESS
        if ended.code in (FAILED, INVALID) and "error" not in ended.stderr:
            case.wrong("no reason", "full", ended.stderr[:300], "a reason on stderr", ended)
        self.sound(case, ended)


def sizes(run: Path) -> list[int]:
    """Sizes of the files of a run, bytes."""
    return [path.stat().st_size for path in sorted(run.rglob("*")) if path.is_file()]


def can_mount(folder: Path) -> bool:
    """True if a file system can be mounted."""
    if os.geteuid() != 0:
        return False
    try:
        with small_disk(folder):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Callable[[int], None]]:
    """Mounts a file system in the folder; yields a function that resizes it."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64m", "campaign", str(folder)],
        check=True, capture_output=True,
    )

    def resize(size: int) -> None:
        options = f"remount,size={size}"
        subprocess.run(["mount", "-o", options, str(folder)], check=True, capture_output=True)

    try:
        yield resize
    finally:
        if subprocess.run(["umount", str(folder)], capture_output=True).returncode != 0:
            subprocess.run(["umount", "-l", str(folder)], capture_output=True)
