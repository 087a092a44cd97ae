"""Interrupts: a checkpoint, exit code 130, and a run that resumes."""

import signal
import time

from attack import TRAINING, RunAttack
from case import Case
from judge import INTERRUPTED, SUCCESS
from runs import checkpoints, steps_logged

NUMBERS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


class Signals(RunAttack):
    """SIGINT, SIGTERM and SIGHUP, once or twice, at random times."""

    name = "signals"
    weight = 2

    def attack(self, case: Case) -> None:
        """Interrupts a run a few times, then lets it end."""
        recipe = self.recipe(case)
        for _ in range(case.random.choice([1, 1, 2, 3])):
            number = case.random.choice(NUMBERS)
            times = case.random.choice([1, 1, 2])
            case.label = f"{recipe.name} {number.name}{' twice' if times == 2 else ''}"
            earlier = steps_logged(case.folder / "runs/small")
            with self.setting.turns.taken():
                process = case.start(self.training(case, recipe), TRAINING)
                wait = recipe.seconds * case.random.random()
                until = time.monotonic() + wait
                while time.monotonic() < until and not process.ended():
                    time.sleep(0.002)
                before = steps_logged(case.folder / "runs/small")
                process.send(number)
                if times == 2:
                    time.sleep(0.05 * case.random.random())
                    process.send(case.random.choice(NUMBERS))
                ended = process.wait()
            case.history[-1] += f"  # {number.name} x {times} after {wait:.3f} s"
            case.judge(ended)
            case.counts["signals"] += 1
            self.sound(case, ended)
            # Before its first output, it has no signal handler.
            silent = not ended.stderr.strip() and not ended.stdout.strip()
            unready = silent and ended.code in [-number for number in NUMBERS]
            if ended.killed and ended.code not in (INTERRUPTED, SUCCESS) and not unready:
                found = f"exit code {ended.code} after {number.name}"
                case.wrong("exit code", number.name, found, "130, or 0 if it had ended", ended)
                return
            # Steps of a process before this one may be logged without a checkpoint.
            stepped = before > earlier
            alone = ended.code == INTERRUPTED and times == 1 and stepped
            if alone and not checkpoints(case.folder / "runs/small"):
                case.wrong("no checkpoint", number.name, "no checkpoint", "a checkpoint", ended)
            if ended.code == SUCCESS:
                # It reports that it had ended.
                self.compare(case, recipe, ended, exact=False)
                return
        self.complete(case, recipe, exact=False)
