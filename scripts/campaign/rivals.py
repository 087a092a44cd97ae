"""Two processes on one run: one works, the other is refused or only reads."""

import time

from attack import TRAINING, RunAttack
from case import Case
from judge import INVALID, SUCCESS
from recipes import Recipe

PAIRS = [
    ("train", "train"), ("resume", "resume"), ("train", "resume"), ("resume", "train"),
    ("train", "sample"), ("resume", "sample"), ("train", "plot"),
]


class Rivals(RunAttack):
    """Pairs of commands that start within moments of each other."""

    name = "rivals"
    weight = 2

    def attack(self, case: Case) -> None:
        """Starts a pair, on a new run or on one that was killed."""
        recipe = self.recipe(case)
        pair = PAIRS[(case.number // len(self.setting.recipes)) % len(PAIRS)]
        case.label = f"{recipe.name} {' and '.join(pair)}"
        if pair[0] == "resume" and not self.half_run(case, recipe):
            return
        delay = case.random.choice([0.0, 0.002, 0.05, 1.0]) * case.random.random()
        if pair[1] in ("sample", "plot"):
            delay = recipe.seconds * case.random.random()
        with self.setting.turns.taken(2):
            processes = [case.start(self.command(recipe, pair[0]), TRAINING)]
            time.sleep(delay)
            processes.append(case.start(self.command(recipe, pair[1]), TRAINING))
            ends = [process.wait() for process in processes]
        case.history[-1] += f"  # {delay:.4f} s after the other"
        for ended in ends:
            case.judge(ended, allowed=(SUCCESS, INVALID))
            if "damaged" in ended.stderr:
                found = ended.stderr.strip()[:300]
                case.wrong("damaged checkpoint", "beside another", found, "none", ended)
        if all(ended.arguments[0] == "train" and ended.code != SUCCESS for ended in ends):
            found = "; ".join(ended.stderr.strip()[:200] for ended in ends)
            case.wrong("no winner", " and ".join(pair), found, "one trains", ends[1])
        self.sound(case, ends[0])
        codes = [ended.code for ended in ends]
        if pair == ("train", "train") and codes == [SUCCESS, SUCCESS]:
            case.wrong("two winners", "train", "both exit with 0", "one is refused", ends[1])
        if (case.folder / "runs/small").exists():
            self.complete(case, recipe)

    def command(self, recipe: Recipe, what: str) -> list[str]:
        """One process of a pair."""
        if what == "sample":
            return recipe.use("runs/small")
        if what == "plot":
            return ["plot", "runs/small", "--out", "losses.svg"]
        resume = ["--resume"] if what == "resume" else []
        return ["train", f"shared/recipes/{recipe.name}/config.toml", "--runs-dir", "runs", *resume]
