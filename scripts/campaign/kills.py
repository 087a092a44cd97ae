"""Runs that are killed repeatedly end like an uninterrupted run."""

import contextlib
import os
import time

from attack import TRAINING, RunAttack
from case import Case
from judge import SUCCESS
from process import Process
from recipes import Recipe
from runs import checkpoints

KILLS = 8
"""Number of kills after which a run may end."""
ATTEMPTS = 40


class Kills(RunAttack):
    """SIGKILL at random times, and while a checkpoint is written."""

    name = "kills"
    weight = 6

    def attack(self, case: Case) -> None:
        """Kills a run until it is complete or was killed often enough."""
        recipe = self.recipe(case)
        aimed = case.random.random() < 0.6
        case.label += " at a checkpoint" if aimed else " at any time"
        kills = 0
        for _ in range(ATTEMPTS):
            if kills == KILLS:
                break
            with self.setting.turns.taken():
                process = case.start(self.training(case, recipe), TRAINING)
                self.kill(case, recipe, process, aimed)
                ended = process.wait()
            seconds = ended.seconds
            case.judge(ended, allowed=(0, 1, 2))
            if ended.killed and ended.code == -9:
                kills += 1
                case.counts["kills"] += 1
                case.history[-1] = f"timeout -s KILL {seconds:.4f} {case.history[-1]}"
            elif ended.code != SUCCESS:
                self.lost(case, ended)
                return
            self.sound(case, ended)
            if not ended.killed:
                self.compare(case, recipe, ended)
                return
            if case.random.random() < 0.08 and checkpoints(case.folder / "runs/small"):
                case.run(*recipe.use("runs/small"), allowed=(0,))
        self.complete(case, recipe)

    def kill(self, case: Case, recipe: Recipe, process: Process, aimed: bool) -> None:
        """Kills the process at a random time: of the run, or of the writing of a checkpoint."""
        offset = case.random.random()
        end = time.monotonic() + 3 * recipe.seconds
        if aimed:
            nth = case.random.choice([1, 1, 1, 2, 3])
            writing = False
            while time.monotonic() < end and not process.ended():
                now = writes(case.folder)
                nth -= now and not writing
                writing = now
                if nth == 0:
                    break
                time.sleep(0.0002)
            time.sleep(0.004 * offset**2)
        else:
            until = time.monotonic() + 0.8 * recipe.seconds * offset
            while (left := until - time.monotonic()) > 0 and not process.ended():
                time.sleep(min(left, 0.01))
        process.send(9)


def writes(folder: os.PathLike[str]) -> bool:
    """True if a run of the folder is writing a checkpoint."""
    for run in ("small", "small/base", "small/decoder"):
        with contextlib.suppress(OSError):
            names = os.listdir(f"{folder}/runs/{run}/checkpoints")
            if any(name.startswith(".writing-") for name in names):
                return True
    return False
