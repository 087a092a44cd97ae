"""The sweep: every key of every recipe with every value, shown, trained, resumed, sampled."""

import random
import re
from pathlib import Path

from attack import Attack
from case import ROOM, Case, Setting
from judge import FAILED, INVALID, SUCCESS
from process import Ended, Limits
from program import Program, leaves, set_options
from recipes import Recipe
from runs import steps_logged
from values import LONG, VALUES, WORDS_OF_SETTINGS

LONG_ENOUGH = 2.0
"""Seconds of work after which a run that makes progress is accepted."""
KNOWN_ENOUGH = 4.0
"""Seconds of work of a setting that hung twice."""
MUCH = 4000
"""A number above this may require more work than the time allows."""
MUCH_ENOUGH = 6.0
"""Seconds of work of such a run, which shows that it does not fail at once."""


# Settings such as a learning rate of 1e9 make weights whose samples overflow. That is documented to
# fail, and counted, so that a report shows where more settings come to it.
OVERFLOWED = "is not finite: it is not written"


class Sweep(Attack):
    """Each setting alone, once."""

    name = "settings"
    weight = 44

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.units: list[tuple[Recipe, list[str]]] = []
        self.plausible: dict[str, list[str]] = {}
        """By recipe, settings of the right type."""
        self.shown = {}
        program = Program(setting.binary, setting.out, setting.environment())
        for recipe in setting.recipes:
            self.shown[recipe.name] = program.show(recipe.shortest).stdout
            values = dict(leaves(recipe.shown))
            plausible = self.plausible.setdefault(recipe.name, [])
            for key in program.keys(recipe.shortest, recipe.shown):
                words = []
                of_words = isinstance(values.get(key, ""), (str, list))
                if of_words:
                    words = [f'"{word}"' for word in program.choices(recipe.shortest, key)]
                plausible += [f"{key}={value}" for value in words or of_type(values.get(key))]
                if of_words:
                    words += [*WORDS_OF_SETTINGS, f'"{LONG}"']
                for value in [*VALUES, *words]:
                    self.units.append((recipe, [f"{key}={value}"]))
        random.Random(f"{setting.seed}/{self.name}").shuffle(self.units)
        self.hangs: dict[str, int] = {}

    def total(self) -> int | None:
        """The size of the sweep."""
        return len(self.units)

    def attack(self, case: Case) -> None:
        """Tries one setting."""
        recipe, settings = self.units[case.number]
        self.attempt(case, recipe, settings)

    def attempt(self, case: Case, recipe: Recipe, settings: list[str]) -> None:
        """Shows a config with settings, trains with it if it is accepted, resumes, samples."""
        key = settings[0].partition("=")[0]
        case.label = key if len(settings) == 1 else "settings"
        config = f"shared/recipes/{recipe.name}/shortest.toml"
        options = set_options(settings)
        limits = Limits(memory=self.setting.address_space + ROOM)
        shown = case.run("config", "show", config, *options, limits=limits, allowed=(0, 2))
        if shown.code != SUCCESS:
            case.counts["refused"] += 1
            return
        if shown.stdout == self.shown[recipe.name]:
            case.counts["as before"] += 1
            return
        case.counts["trained"] += 1
        known = self.hangs.get(key, 0) >= 2
        much = any(asks_much(setting) for setting in settings)
        cpu = KNOWN_ENOUGH if known else MUCH_ENOUGH if much else 20
        limits = Limits(cpu=cpu, memory=limits.memory, much=much)
        train = ["train", config, *options, "--runs-dir", "runs"]
        ended = case.run(*train, limits=limits, enough=Progress(case.folder, cpu).is_enough)
        if ended.hang and not much:
            self.hangs[key] = self.hangs.get(key, 0) + 1
            case.counts["long without progress"] += 1
        if ended.killed:
            case.counts["long"] += 1
        if ended.code == FAILED:
            case.counts["failed with a sentence"] += 1
        if ended.code in (FAILED, INVALID) and "error:" not in ended.stderr:
            case.wrong("no reason", "train", ended.stderr[:300], "a reason on stderr", ended)
        if ended.code == SUCCESS:
            self.after(case, recipe, key, train, limits)

    def after(
        self, case: Case, recipe: Recipe, key: str, train: list[str], limits: Limits
    ) -> None:
        """The requirements on a run that ended with 0."""
        runs = [path for path in (case.folder / "runs").glob("*") if path.is_dir()]
        if not runs:
            found = "exit code 0, and no run in the folder of runs"
            case.wrong("nothing written", key, found, "a run", None)
            return
        resumed = case.run(*train, "--resume", limits=limits)
        self.must(case, key, "resume", resumed)
        run = runs[0].relative_to(case.folder)
        used = case.run(*recipe.use(run), limits=limits)
        if not recipe.generates:
            # Settings may have left nothing to evaluate on.
            if "is held out" not in used.stderr:
                self.must(case, key, "evaluation", used)
            return
        self.must(case, key, "sample", used)
        case.must_be_finite(used, "sample*.npy")

    def must(self, case: Case, key: str, what: str, ended: Ended) -> None:
        """Records an exit code other than 0."""
        if what == "sample" and ended.code == FAILED and OVERFLOWED in ended.stderr:
            case.counts["samples overflowed"] += 1
            return
        if ended.code in (FAILED, INVALID) and not ended.killed:
            found = f"{what} of a finished run: exit code {ended.code}: {ended.stderr[:200]}"
            sentence = re.sub(r"\d[\w.]*", "N", ended.stderr.strip().partition("\n")[0])[:100]
            case.wrong(f"no {what}", sentence, found, "exit code 0", ended)


class Progress:
    """True if a training makes progress."""

    def __init__(self, folder: Path, most: float) -> None:
        self.folder, self.most = folder, most
        self.first: float | None = None
        """Seconds of work when the first step was seen."""

    def is_enough(self, cpu: float) -> bool:
        """True if it has worked for long enough and makes progress: it made a second step, or its
        steps are longer than its time."""
        # Of a run or of its longest stage. Checkpoints are not read, because they are replaced.
        runs = self.folder / "runs"
        logs = [*runs.glob("*/metrics.jsonl"), *runs.glob("*/*/metrics.jsonl")]
        steps = max((steps_logged(log.parent) for log in logs), default=0)
        if steps and self.first is None:
            self.first = cpu
        is_slow = self.first is not None and self.first > self.most / 4
        return cpu > LONG_ENOUGH and (steps > 1 or is_slow)


class Combinations(Sweep):
    """Two to five settings at once, of the right type."""

    name = "combinations"
    weight = 3

    def total(self) -> int | None:
        """Limited by time only."""
        return None

    def attack(self, case: Case) -> None:
        """Tries some settings together."""
        recipe = case.random.choice(self.setting.recipes)
        settings = self.plausible[recipe.name]
        count = case.random.randint(2, 5)
        self.attempt(case, recipe, [case.random.choice(settings) for _ in range(count)])



def asks_much(setting: str) -> bool:
    """True if a setting is a large number."""
    try:
        return float(setting.partition("=")[2]) > MUCH
    except ValueError:
        return False


def of_type(value: object) -> list[str]:
    """Values like another."""
    if isinstance(value, bool):
        return ["true", "false"]
    if isinstance(value, int):
        return ["0", "1", "2", "3", "5", "8", "17", "100"]
    if isinstance(value, float):
        return ["0", "0.5", "1", "1e-300", "1e-9", "3.5", "100", "1e9", "1e300"]
    if isinstance(value, list) and value:
        return [str(value[:1]), str([*value, value[-1]]), str([value[0]] * len(value))]
    return ["1", "0.5", "true", "[1]", '"a"']
