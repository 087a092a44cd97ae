"""Stand-ins for ffmpeg that fail in every way."""

import os
import shutil
import time

import seeds
from attack import Attack
from case import Case
from judge import FAILED, INVALID, SUCCESS
from process import Ended, Limits

LAST = 'for last; do :; done; case "$last" in file:*) ;; *) exit 0;; esac; out="${last#file:}"; '
"""The last argument is the file to write, unless it is asked for its version."""
VERSION = 'case "$*" in *-version*) echo ffmpeg version 6; exit 0;; esac; '
"""Answers the question for its version as ffmpeg does."""
SECONDS = 150
"""After which a stand-in that waits ends by itself."""
FAULTY = {
    "exits": "exit 0",
    "fails": "exit 1",
    "fails after all": "cat > /dev/null; exit 1",
    "exits without a file": "cat > /dev/null; exit 0",
    "closes its input": f"exec 0<&-; sleep {SECONDS}",
    "never reads": f"sleep {SECONDS}",
    "reads and waits": f"cat > /dev/null; exec sleep {SECONDS}",
    "writes half, fails": f'{LAST}echo half > "$out"; head -c 1000 > /dev/null; exit 1',
    "writes half, dies": f'{LAST}echo half > "$out"; head -c 1000 > /dev/null; kill -SEGV $$',
    "writes half, waits": f'{LAST}echo half > "$out"; exec sleep {SECONDS}',
    "writes half, exits": f'{LAST}echo half > "$out"; head -c 1000 > /dev/null; exit 0',
    "killed": "kill -KILL $$",
    "endless messages": f"timeout {SECONDS} yes 'frame= 1 fps= 1' >&2",
    "endless line": f"timeout {SECONDS} cat /dev/zero >&2",
    "endless output": f"timeout {SECONDS} yes",
    "garbage messages": r"printf '\033]0;title\007\033[31m\377\376\r\n\000end' >&2; exit 1",
    "long message": "head -c 200000 /dev/zero | tr '\\0' x >&2; exit 1",
    "removes the file": f'{LAST}rm -f "$out"; cat > /dev/null; exit 0',
    "file becomes a link": f'{LAST}ln -sf motion.npy "$out"; cat > /dev/null; exit 0',
    "lies": f'{LAST}cat > /dev/null; echo noise > "$out"; exit 0',
    "leaves a child": f"(sleep {SECONDS} &) ; exit 1",
    "a child keeps the pipes": f"sleep {SECONDS} & exit 0",
    "exit code 255": "cat > /dev/null; exit 255",
    "stops itself": "kill -STOP $$",
}
"""What a stand-in does instead of encoding."""
NO_PROGRAM = {
    "not executable": (b"#!/bin/sh\nexit 0\n", 0o644),
    "no interpreter": (b"#!/no/such/program\n", 0o755),
    "no program": (b"\x7fELFxxxx", 0o755),
    "empty": (b"", 0o755),
}
"""Files that cannot be started, with their permissions."""
LIMITS = Limits(cpu=20, wall=100)
"""The program waits a minute for progress."""


class Exporters(Attack):
    """An `ffmpeg` that hangs, floods, dies or lies."""

    name = "exporters"
    weight = 3

    def total(self) -> int | None:
        """Every stand-in with and without an answer to `-version`, with a song or without, or
        instead of a decoder."""
        return 4 * len(FAULTY) + len(NO_PROGRAM)

    def attack(self, case: Case) -> None:
        """Writes a film, or reads a song of a foreign format, with one stand-in."""
        program = case.folder / "bin/ffmpeg"
        program.parent.mkdir()
        kind, way = divmod(case.number, 4)
        if kind < len(FAULTY):
            case.label = list(FAULTY)[kind] + ("" if way else " at once")
            known = VERSION if way else ""
            program.write_text(f"#!/bin/sh\n{known}{FAULTY[case.label.removesuffix(' at once')]}\n")
            program.chmod(0o755)
        else:
            case.label = list(NO_PROGRAM)[case.number - 4 * len(FAULTY)]
            content, mode = NO_PROGRAM[case.label]
            program.write_bytes(content)
            program.chmod(mode)
            (program.parent / "prlimit").symlink_to(shutil.which("prlimit"))
        # What cannot be started is passed over for the next of its name.
        case.variables["PATH"] = f"bin:{os.environ.get('PATH', '')}" if kind < len(FAULTY) else "bin"
        (case.folder / "motion.npy").write_bytes(seeds.npy((8, 25), seeds.phrase(8)))
        (case.folder / "song.wav").write_bytes(seeds.wav(22050, 1, 2, 0.5))
        if way == 3:
            self.decode(case)
        else:
            self.film(case, ["--audio", "song.wav"] if way == 2 else [])

    def film(self, case: Case, song: list[str]) -> None:
        """The film is absent or what it was, and nothing else is left."""
        out = case.folder / "film.mp4"
        older = case.random.random() < 0.5
        if older:
            out.write_bytes(b"an older film")
        before = names(case)
        overwrite = ["--overwrite"] if older else []
        ended = case.run("view", "motion.npy", *song, "--mp4", "film.mp4", *overwrite, limits=LIMITS)
        lies = case.label.startswith("lies")
        if ended.code == SUCCESS and not lies:
            found = "exit code 0 of a film that was not encoded"
            case.wrong("false success", case.label, found, "1 or 2", ended)
        if lies and ended.code == SUCCESS:
            # It took all pictures: no other program can know what it wrote.
            case.counts["believed"] += 1
        elif (out.read_bytes() if out.is_file() else None) != (b"an older film" if older else None):
            case.wrong("half a film", case.label, "film.mp4 is written", "as before", ended)
        if ended.code in (FAILED, INVALID) and "ffmpeg" not in ended.stderr:
            case.wrong("no reason", case.label, ended.stderr[:300], "ffmpeg by name", ended)
        self.nothing_more(case, before | {"film.mp4"}, ended)

    def decode(self, case: Case) -> None:
        """A song of a format that this program does not read is refused, with any ffmpeg."""
        song = b"\0\0\0\x1cftypM4A \0\0\2\0M4A isomiso2" + case.random.randbytes(4000)
        (case.folder / "song.m4a").write_bytes(song)
        before = names(case)
        ended = case.run("audio", "features", "song.m4a", "--out", "out", limits=LIMITS)
        if ended.code == SUCCESS:
            case.wrong("false success", case.label, "exit code 0 of noise", "2", ended)
        self.nothing_more(case, before, ended)

    def nothing_more(self, case: Case, expected: set[str], ended: Ended) -> None:
        """No file is left but the expected ones."""
        # A file that a stand-in writes late appears late.
        time.sleep(0.05)
        if not ended.hang and (more := names(case) - expected):
            case.wrong("leftovers", case.label, ", ".join(sorted(more)), "none", ended)


def names(case: Case) -> set[str]:
    """The names in the folder of a case."""
    return set(os.listdir(case.folder))
