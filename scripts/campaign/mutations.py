"""Damaged files of every format, and paths that are no regular files."""

import os
import random

from attack import Attack
from case import Case, Setting
from formats import WRITES, Format, Formats
from process import Limits

SPECIAL = ["empty", "folder", "pipe", "zeros without end", "noise without end", "5 GiB", "dangling"]
EVERY = 60
"""One case in this many is special, until all have been used."""
SPARSE_BYTES = 5 << 30
SHARES = {"checkpoint": 0.4, "ids": 0.2, "capture": 1.6, "c3d": 1.5, "metrics.jsonl": 0.6}
"""Weight of a format, if not 1: slow ones are less frequent."""


class Mutations(Attack):
    """Each format in turn, a valid file of it with some damage."""

    name = "mutations"
    weight = 14

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        formats = Formats(setting)
        self.formats = formats.all()
        self.left_out = formats.missing
        """Formats without a command that accepts a valid file."""
        self.shares = [SHARES.get(form.name.split()[0], 1.0) for form in self.formats]
        self.special = [
            (form, kind, command) for form in self.formats for kind in SPECIAL
            for command in form.commands[:1]
        ]
        random.Random(f"{setting.seed}/special").shuffle(self.special)

    def attack(self, case: Case) -> None:
        """Runs the program with one file."""
        limits = Limits(cpu=20, wall=6, memory=self.setting.bounded.memory)
        turn, rest = divmod(case.number, EVERY)
        if rest == EVERY - 1 and turn < len(self.special):
            form, kind, command = self.special[turn]
            form.stage(case.folder)
            put_special(case, form, kind)
            case.counts["special"] += 1
            case.label = f"{form.name} {kind}"
            if kind == "5 GiB":
                # Under a limit a program that reads all of it ends with an error as well.
                limits = Limits(cpu=60, wall=6)
            case.run(*command, limits=limits)
            return
        form = case.random.choices(self.formats, self.shares)[0]
        case.label = form.name
        case.counts[f"format {form.name}"] += 1
        form.stage(case.folder)
        content = form.damage(case.random, case.random.choice(form.seeds), form.seeds)
        form.put(case.folder, content)
        command = case.random.choice(form.commands)
        ended = case.run(*command, limits=limits)
        case.counts["taken"] += ended.code == 0
        case.counts["refused"] += ended.code != 0
        if command[0] == "sample" and not form.name.startswith(("checkpoint", "state")):
            case.must_be_finite(ended, "out*.npy")
        wanted = WRITES.get(command[0])
        if ended.code == 0 and wanted and not any(case.folder.glob(wanted)):
            case.wrong("nothing written", command[0], "exit code 0, no file", wanted, ended)


def put_special(case: Case, form: Format, kind: str) -> None:
    """Replaces the file by something that is no regular file of the format."""
    path = case.folder / form.file
    path.unlink(missing_ok=True)
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "zeros without end":
        path.symlink_to("/dev/zero")
    elif kind == "noise without end":
        path.symlink_to("/dev/urandom")
    elif kind == "dangling":
        path.symlink_to("nowhere")
    else:
        with path.open("wb") as file:
            file.truncate(SPARSE_BYTES)
