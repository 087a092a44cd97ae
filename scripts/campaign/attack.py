"""The base of all attacks, and of attacks on runs."""

from case import Case, Setting
from judge import INVALID, SUCCESS
from process import Ended, Limits
from recipes import Recipe
from runs import checkpoints, contents, damaged_checkpoints, differences, last_differs, leftovers


class Attack:
    """A kind of attack. Case N of it depends on the seed and N alone."""

    name: str
    weight: float
    """Share of the time."""
    on_disk = False
    """True if its folders must be on a disk."""
    not_applicable = ""
    """Why the attack does not apply to this build; then it has no cases."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting

    def total(self) -> int | None:
        """Number of cases; None if limited only by time."""
        return None

    def attack(self, case: Case) -> None:
        """Carries out a case."""
        raise NotImplementedError


TRAINING = Limits(cpu=60)


class RunAttack(Attack):
    """An attack on runs, which in the end must be those of their recipe's reference."""

    on_disk = True

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.references = {recipe.name: contents(recipe.reference) for recipe in setting.recipes}

    def recipe(self, case: Case) -> Recipe:
        """The recipe of a case: each in turn."""
        recipe = self.setting.recipes[case.number % len(self.setting.recipes)]
        case.label = recipe.name
        return recipe

    def training(self, case: Case, recipe: Recipe) -> list[str]:
        """The training command; it resumes if there is a run."""
        resume = ["--resume"] if (case.folder / "runs/small").exists() else []
        return ["train", f"shared/recipes/{recipe.name}/config.toml", "--runs-dir", "runs", *resume]

    def complete(self, case: Case, recipe: Recipe, exact: bool = True) -> bool:
        """Lets the run end, and compares it with the reference: every file, or if not `exact` the
        last checkpoint."""
        resumed = case.run(*self.training(case, recipe), limits=TRAINING, allowed=(0, 1, 2))
        if resumed.code != SUCCESS:
            self.lost(case, resumed)
            return False
        self.compare(case, recipe, resumed, exact)
        return True

    def lost(self, case: Case, resumed: Ended) -> None:
        """A run that does not resume."""
        if not resumed.killed and resumed.code in (1, INVALID):
            found = f"exit code {resumed.code}: {resumed.stderr.strip()[:300]}"
            case.wrong("lost run", "resume", found, "the run resumes and ends", resumed)

    def compare(self, case: Case, recipe: Recipe, ended: Ended, exact: bool = True) -> None:
        """Compares a finished run with the reference."""
        run = case.folder / "runs/small"
        if exact:
            wrong = differences(run, self.references[recipe.name])
        else:
            wrong = last_differs(run, recipe.reference)
        if wrong:
            first = wrong[0].rpartition("/")[2]
            expected = "the bytes of a run that never stopped"
            case.wrong("wrong bytes", first, "; ".join(wrong[:6]), expected, ended)
        if left := leftovers(case.folder / "runs"):
            case.wrong("leftovers", left[0].rpartition("/")[2], ", ".join(left), "none", ended)

    def sound(self, case: Case, ended: Ended) -> None:
        """No checkpoint under its final name may ever be damaged."""
        if faults := damaged_checkpoints(case.folder / "runs"):
            found = "; ".join(faults)
            case.wrong("damaged checkpoint", "after an end", found, "whole checkpoints", ended)

    def half_run(self, case: Case, recipe: Recipe) -> bool:
        """Creates a run that is killed after some checkpoint; returns True on success."""
        wanted = case.random.randint(1, 3)
        folder = case.folder / "runs/small"
        with self.setting.turns.taken():
            process = case.start(self.training(case, recipe), TRAINING)
            enough = lambda cpu: len(checkpoints(folder)) >= wanted
            ended = process.wait(tick=0.001, enough=enough)
        case.judge(ended, allowed=(SUCCESS,))
        if ended.killed:
            case.counts["kills"] += 1
        return bool(checkpoints(folder)) and ended.killed
