"""Every option of every command with every value, alone; required options have valid values."""

import random
import re
from pathlib import Path

from attack import Attack
from case import Case, Setting
from process import Limits
from program import Program
from sweep import asks_much
from values import LONG, WORDS

OPTION = re.compile(r"^ +(?:-\w, )?(--[\w-]+)(?: <([^>]*)>)?", re.MULTILINE)
USAGE = re.compile(r"^Usage: kinegrad (.*)$", re.MULTILINE)
REQUIRED = re.compile(r"(--[\w-]+) <([^>]*)>|<([^>]*)>|\[(CONFIG)\]")
"""Placeholders of a usage that get a valid value. `train` also runs without its config, but then
every option has the same error."""
LONG_ENOUGH = 3.0
MANY_FILES = 400


class Options(Attack):
    """The command line, as `--help` describes it."""

    name = "options"
    weight = 23

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        program = Program(setting.binary, setting.out, setting.environment())
        self.units: list[tuple[str, list[str]]] = []
        """The tried option, and the command line."""
        for command, help_text in program.commands():
            usage = USAGE.search(help_text)
            if not usage:
                continue
            for recipe in setting.recipes:
                base = [*command, *self.required(usage[1], recipe.name)]
                takes_run = any("recipes/" in word for word in base)
                name_of = " ".join(command)
                for option, name in OPTION.findall(help_text):
                    values = [f"{option}={word}" for word in [*WORDS, LONG]] if name else [option]
                    self.units += [(f"{name_of} {option}", [*base, value]) for value in values]
                for place in range(len(command), len(base)):
                    for word in WORDS:
                        line = [*base[:place], word, *base[place + 1:]]
                        self.units.append((f"{name_of} argument {place}", line))
                if not takes_run:
                    break
        random.Random(f"{setting.seed}/{self.name}").shuffle(self.units)

    def required(self, usage: str, recipe: str) -> list[str]:
        """Valid values of a command's required arguments."""
        words = []
        for option, name, place, config in REQUIRED.findall(usage.replace("...", "")):
            if option:
                words += [option, valid(name, recipe, output=option == "--out")]
            else:
                words.append(valid(place or config, recipe, output=False))
        return words

    def total(self) -> int | None:
        """The size of the sweep."""
        return len(self.units)

    def attack(self, case: Case) -> None:
        """Runs one command line."""
        case.label, unit = self.units[case.number]
        much = any(asks_much(word) for word in unit)
        limits = Limits(memory=self.setting.bounded.memory, much=much)
        enough = lambda cpu: cpu > LONG_ENOUGH and (much or many_files(case.folder))
        ended = case.run(*unit, limits=limits, enough=enough)
        case.counts["long"] += ended.killed


def valid(name: str, recipe: str, output: bool) -> str:
    """A valid value for a placeholder of the help."""
    if output:
        return {"FILE.svg|FILE.png": "out.svg"}.get(name, "out")
    folder = f"shared/recipes/{recipe}"
    known = {
        "CONFIG": f"{folder}/shortest.toml",
        "WEIGHTS.pt": "shared/seeds/pt/0.pt",
        "ARCH": "gmd_trajectory",
        "PLAN.toml": "shared/seeds/plan/0.toml",
        "SHELL": "bash",
        "SONG": "shared/seeds/wav/0.wav",
        "URI": "shared/datasets/0",
        "PATH": "shared/seeds/motion npy/0.npy",
    }
    return known.get(name, f"{folder}/runs/small")


def many_files(folder: Path) -> bool:
    """True if a command keeps writing files."""
    return sum(1 for path in folder.rglob("*") if path.is_file()) > MANY_FILES
