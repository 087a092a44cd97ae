"""The program's recipes, kinds, keys and options, read from its own output."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from process import Ended, Limits, Process

NOTHING = "zzz"
"""A string that is no key and no value of the program."""
AMONG = re.compile(r"is not among ([^\n]*)")
ALLOWED = re.compile(r"unknown key [^\n]*allowed: ([^\n]*)")


class Program:
    """The program's description, read before the attacks."""

    def __init__(self, binary: Path, folder: Path, environment: dict[str, str]) -> None:
        self.binary, self.folder, self.environment = binary, folder, environment
        self.address_space = 0
        self.resident = 0

    def run(self, *arguments: object, watch: bool = False) -> Ended:
        """Runs a command to its end."""
        words = [str(argument) for argument in arguments]
        limits = Limits(cpu=120, wall=120)
        started = Process(self.binary, words, self.folder, self.environment, limits)
        ended = started.wait(watch_memory=watch)
        self.address_space = max(self.address_space, ended.peak_address_space)
        self.resident = max(self.resident, ended.peak)
        return ended

    def show(self, config: Path, settings: list[str] = ()) -> Ended:
        """`config show` with settings."""
        return self.run("config", "show", config, *set_options(settings))

    def choices(self, config: Path, key: str, settings: list[str] = ()) -> list[str]:
        """The values that a key of words may have."""
        said = AMONG.search(self.show(config, [*settings, f"{key}={NOTHING}"]).stderr)
        return [word.strip() for word in said[1].split(",")] if said else []

    def keys(self, config: Path, shown: dict[str, object]) -> list[str]:
        """Every key of a config, those that `config show` leaves out too."""
        keys = dict.fromkeys(key for key, _ in leaves(shown))
        tables = ["", *tables_of(shown)]
        seen = set()
        while tables:
            table = tables.pop(0)
            if table in seen:
                continue
            seen.add(table)
            prefix = f"{table}." if table else ""
            said = ALLOWED.search(self.show(config, [f"{prefix}{NOTHING}=1"]).stderr)
            for name in said[1].split(",") if said else []:
                key = prefix + name.strip()
                if key in keys or key in seen:
                    continue
                if ALLOWED.search(self.show(config, [f"{key}.{NOTHING}=1"]).stderr):
                    tables.append(key)
                else:
                    keys[key] = None
        return list(keys)

    def commands(self) -> Iterator[tuple[list[str], str]]:
        """Every command with its help."""
        waiting: list[list[str]] = [[]]
        while waiting:
            command = waiting.pop(0)
            help_text = self.run(*command, "--help").stdout
            listed = re.search(r"^Commands:\n((?:  .*\n)+)", help_text, re.MULTILINE)
            if listed:
                names = re.findall(r"^  (\w[\w-]*)", listed[1], re.MULTILINE)
                waiting += [[*command, name] for name in names if name != "help"]
            else:
                yield command, help_text


def set_options(settings: list[str]) -> list[str]:
    """`--set` for each setting."""
    return [word for setting in settings for word in ("--set", setting)]


def parsed(shown: str) -> dict[str, object]:
    """A config as `config show` prints it."""
    return tomllib.loads(shown)


def leaves(table: dict[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """All dotted keys with their values."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def tables_of(table: dict[str, object], prefix: str = "") -> Iterator[str]:
    """All dotted names of tables."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield prefix + name
            yield from tables_of(value, f"{prefix}{name}.")
