"""Files and folders whose names are no plain text."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import seeds
from attack import Attack
from case import Case, Setting
from judge import SUCCESS
from process import Limits
from program import Program
from texts import raw_text, text_files
from values import NAMES

LIMITS = Limits(cpu=30, wall=15)


@dataclass
class Trial:
    """A command on strange names."""

    words: list[bytes | str]
    """Values of options follow their option; words in bytes are names."""
    written: bytes | None = None
    """What must exist after exit code 0."""
    files: dict[bytes, bytes] = field(default_factory=dict)
    """Inputs by name."""
    folders: dict[bytes, Path] = field(default_factory=dict)
    """Copied folders by name."""


class Names(Attack):
    """Names with control characters, that are no UTF-8, look like options, or are long."""

    name = "names"
    weight = 4

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.phrases = setting.shared / "named"
        shutil.rmtree(self.phrases, ignore_errors=True)
        Program(setting.binary, setting.out, setting.environment()).run(
            "data", "synth", "--out", self.phrases, "--phrases", 3, "--frames", 48)
        self.kinds: list[Callable[[Case, bytes], Trial]] = [
            motions, motions, songs, matches, self.runs, self.trains, self.datasets, prepares,
        ]

    def attack(self, case: Case) -> None:
        """One name, one command."""
        name = NAMES[case.number % len(NAMES)]
        trial = case.random.choice(self.kinds)(case, name)
        top = os.fsencode(case.folder)
        try:
            for path, content in trial.files.items():
                put(top + b"/" + path, content)
            for path, folder in trial.folders.items():
                shutil.copytree(os.fsencode(folder), top + b"/" + path)
        except OSError:
            # A name that the file system does not take is tried as a missing file.
            case.counts["not a name here"] += 1
        case.label = f"{' '.join(word for word in trial.words if isinstance(word, str))[:40]}"
        words = [os.fsdecode(word) if isinstance(word, bytes) else word for word in trial.words]
        ended = case.run(*words, limits=LIMITS)
        case.counts["taken"] += ended.code == SUCCESS
        wanted = trial.written
        if ended.code == SUCCESS and wanted and not os.path.lexists(top + b"/" + wanted):
            found = f"exit code 0, and no {wanted!r}"
            case.wrong("another name", trial.words[0], found, "a file of the asked name", ended)
        inputs = {top + b"/" + file for file in trial.files}
        for path in text_files(top):
            if path not in inputs and (around := raw_text(path)):
                said = f"{path[len(top) + 1:]!r} contains {around!r}"
                kind = f"{trial.words[0]} {os.path.splitext(path)[1].decode()}"
                case.wrong("raw name", kind, said, "escaped text", ended)
                break

    def runs(self, case: Case, name: bytes) -> Trial:
        """A run of that name."""
        recipe = case.random.choice(self.setting.recipes)
        run = b"runs/" + name
        folders = {run: recipe.reference}
        use = [run if word == "RUN" else word for word in recipe.use("RUN", "out")]
        words, written = case.random.choice([
            (["runs", "runs"], None), (["runs", "runs", "--json"], None),
            (["report", run], run + b"/report.html"), (["eval", run], None),
            (["report", run, "--out", b"out.html"], b"out.html"),
            (["plot", run, run, "--out", b"out.svg"], b"out.svg"), (use, None),
            (["merge", run, "--out", name], None),
        ])
        if recipe.generates and case.random.random() < 0.3:
            words = ["sample", run, "--out", name, "--steps", "1", "--allow-unusable", "--json"]
            written = name + b".npy" if not name.endswith(b".npy") else name
        return Trial(words, written, {}, folders)

    def trains(self, case: Case, name: bytes) -> Trial:
        """A new run of that name, or in a folder of that name."""
        recipe = case.random.choice(self.setting.recipes)
        train = ["train", f"shared/recipes/{recipe.name}/shortest.toml"]
        if case.random.random() < 0.5:
            return Trial([*train, b"--runs-dir=" + name], name + b"/small")
        text = json.dumps(name.decode(errors="replace"), ensure_ascii=False)
        return Trial([*train, "--set", f"run.name={text}"])

    def datasets(self, case: Case, name: bytes) -> Trial:
        """A dataset of that name, or whose item has that name."""
        if case.random.random() < 0.3:
            return Trial(["data", "synth", "--phrases", "2", "--frames", "44", "--out", name], name)
        if case.random.random() < 0.5:
            return Trial(["data", "inspect", as_path(case, name)], folders={name: self.phrases})
        first = sorted((self.phrases / "motion").iterdir())[0].name
        folders = {b"set": self.phrases}
        folders |= {
            b"set/" + part + b"/" + name: self.phrases / part.decode() / first
            for part in (b"motion", b"audio_features")
        }
        json_too = case.random.choice([[], ["--json"]])
        return Trial(["data", "inspect", "set", *json_too], folders=folders)


def as_path(case: Case, name: bytes) -> bytes:
    """A name as an argument: as it is, or after `./`."""
    return case.random.choice([b"", b"./"]) + name


def motions(case: Case, name: bytes) -> Trial:
    """A motion of that name."""
    ending, content = case.random.choice([
        (b".bvh", seeds.bvh(20, spine=True)), (b".npy", seeds.npy((30, 25), seeds.phrase(30)))])
    file = name + ending
    place = as_path(case, file)
    folder = b"in" if case.random.random() < 0.3 else b""
    if folder:
        file, place = folder + b"/" + file, folder
    words, written = case.random.choice([
        (["check", place], None), (["check", "--json", place], None),
        (["plot", place, "--out", name + b".svg"], name + b".svg"),
        (["view", place, b"--out=" + name + b".html"], name + b".html"),
        (["view", place], file[:-4] + b".html"),
        (["view", place, "--glb", name + b".glb"], name + b".glb"),
        (["view", place, "--bvh", b"n" + name + b".bvh"], b"n" + name + b".bvh"),
        (["view", place, "--gif", name + b".gif"], name + b".gif"),
        (["view", "--title", name, place, "--out", b"out.html"], b"out.html"),
    ])
    return Trial(words, written, {file: content})


def songs(case: Case, name: bytes) -> Trial:
    """A song of that name."""
    file = name + b".wav"
    words = ["audio", "features", as_path(case, file), "--out"]
    out = case.random.choice([b"out", name])
    plot = case.random.choice([[], ["--plot"]])
    return Trial([*words, out, *plot], out, {file: seeds.wav(22050, 1, 2, 0.4)})


def matches(case: Case, name: bytes) -> Trial:
    """Examples and results of that name."""
    file, new = name + b".bvh", b"n" + name + b".bvh"
    words = ["match", as_path(case, file), b"--out=" + new]
    more = case.random.choice([[], ["--svg", name + b".svg"], ["--json"]])
    return Trial([*words, *more], new, {file: seeds.bvh(40, spine=True)})


def prepares(case: Case, name: bytes) -> Trial:
    """A plan of that name, or whose files have it."""
    text = name.decode(errors="replace")
    plan, file = seeds.PLAN, b"motion.bvh"
    if case.random.random() < 0.7:
        quoted = json.dumps(text, ensure_ascii=False)
        ending = json.dumps(text + ".bvh", ensure_ascii=False)
        plan = plan.replace('"motion.bvh"', ending).replace('"one"', quoted)
        file = text.encode() + b".bvh"
    files = {name + b".toml": plan.encode(), file: seeds.bvh(40)}
    return Trial(["data", "prepare", as_path(case, name + b".toml")], b"set", files)


def put(path: bytes, content: bytes) -> None:
    """Writes a file and its folders."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as file:
        file.write(content)
