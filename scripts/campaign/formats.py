"""Every format that the program reads: valid files of it, and the cheapest commands that read it."""

import io
import random
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import seeds
from case import Setting
from containers import mutated_archive, mutated_tensors
from mutate import mutated, mutated_text
from program import Program
from runs import SEAL, checkpoints, resealed, sealed

Damage = Callable[[random.Random, bytes, list[bytes]], bytes]

ONE_STEP = ["--steps", "1", "--out", "out", "--overwrite", "--allow-unusable"]
RUN = "{run}"
"""Placeholder for the run of a recipe, in a command that is tried with each."""


@dataclass
class Format:
    """One kind of file, at the path where the program reads it."""

    name: str
    file: str
    """In the folder of a case."""
    seeds: list[bytes]
    damage: Damage
    commands: list[list[str]]
    staged: Path | None = None
    """Files that must be next to it, copied into the folder."""
    sealed: Callable[[Path], None] | None = None
    """Restores valid checksums."""

    def stage(self, folder: Path) -> None:
        """Fills the folder of a case, but for the file."""
        if self.staged:
            shutil.copytree(self.staged, folder, dirs_exist_ok=True, symlinks=True)
        (folder / self.file).parent.mkdir(parents=True, exist_ok=True)

    def put(self, folder: Path, content: bytes) -> None:
        """Writes the file."""
        (folder / self.file).write_bytes(content)
        if self.sealed:
            self.sealed(folder)


WRITES = {"sample": "out*.npy", "plot": "out.svg", "import": "out", "audio": "out", "merge": "out",
          "match": "out.bvh"}
"""Output files of each command with exit code 0."""


class Formats:
    """All formats, with those commands that take their valid files."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.program = Program(setting.binary, setting.out, setting.environment())
        self.fixtures = setting.root / "data_fixtures"
        self.staging = setting.shared / "staged"
        self.missing: list[str] = []

    def all(self) -> list[Format]:
        """Formats that can be attacked; the others are reported."""
        kept = []
        for form in [*self.captures(), *self.songs(), *self.arrays(), *self.weights(),
                     *self.datasets(), *self.of_runs(), *self.settings()]:
            self.keep_seeds(form)
            form.commands = [command for command in self.expanded(form) if self.takes(form, command)]
            if form.commands and form.seeds:
                kept.append(form)
            else:
                self.missing.append(form.name)
                self.setting.say(f"NOT ATTACKED: no command takes a valid file of `{form.name}`")
        return kept

    def expanded(self, form: Format) -> Iterator[list[str]]:
        """The commands, those on a run once for each recipe."""
        for command in form.commands:
            if not any(RUN in word for word in command):
                yield command
                continue
            for recipe in self.setting.recipes:
                run = f"shared/recipes/{recipe.name}/runs/small"
                yield [word.replace(RUN, run) for word in command]

    def keep_seeds(self, form: Format) -> None:
        """Keeps the seeds for `options` and for replays."""
        folder = self.setting.shared / "seeds" / form.name
        folder.mkdir(parents=True, exist_ok=True)
        for index, content in enumerate(form.seeds):
            (folder / f"{index}{Path(form.file).suffix}").write_bytes(content)

    def takes(self, form: Format, command: list[str]) -> bool:
        """True if the program accepts one of the valid files."""
        for content in form.seeds:
            folder = self.setting.memory / "valid"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            (folder / "shared").symlink_to(self.setting.shared)
            form.stage(folder)
            form.put(folder, content)
            program = Program(self.setting.binary, folder, self.setting.environment())
            ended = program.run(*command, watch=True)
            self.setting.address_space = max(self.setting.address_space, program.address_space)
            self.setting.resident = max(self.setting.resident, program.resident)
            if ended.code == 0 or (ended.code == 1 and command[0] == "check"):
                shutil.rmtree(folder)
                return True
        return False

    def staged(self, name: str, files: dict[str, bytes]) -> Path:
        """A folder of files that accompany a damaged one."""
        folder = self.staging / name
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        return folder

    def captures(self) -> Iterator[Format]:
        """Inputs of `data prepare`."""
        prepare = [["data", "prepare", "plan.toml"]]
        markers = [seeds.c3d(kind, scale, 72, analog) for kind, scale, analog in [
            (84, -0.1, 0), (84, 0.1, 3), (85, -0.1, 0), (86, -0.1, 0), (86, 0.1, 2)]]
        phrase = seeds.phrase(40)
        position = seeds.npy((40, 3))
        turn = seeds.npy((40, 4), [1.0, 0, 0, 0] * 40)
        for name, damage, files in [
            ("bvh", mutated_text, [seeds.bvh(40), seeds.bvh(40, spine=True)]),
            ("c3d", mutated, markers),
            ("npy", mutated, [seeds.npy((40, 25), phrase), seeds.npy((40, 7), [0.0, 1, 0, 1, 0, 0, 0] * 40)]),
            ("npz", mutated_archive, [archive({"position": position, "quaternion": turn})]),
        ]:
            plan = seeds.PLAN.replace("motion.bvh", f"motion.{name}")
            if name != "bvh":
                plan = plan.replace('units = "cm"\nup = "y"\n', "")
            staged = self.staged(f"capture {name}", {"plan.toml": plan.encode()})
            yield Format(f"capture {name}", f"motion.{name}", files, damage, prepare, staged)
        matching = ["match", "motion.bvh", "--out", "out.bvh"]
        yield Format("match", "motion.bvh", [seeds.bvh(40), seeds.bvh(60, spine=True)], mutated_text,
                     [matching, [*matching, "--heading", "--loop", "--parts", "auto"]])
        staged = self.staged("match", {"motion.bvh": seeds.bvh(40, spine=True)})
        yield Format("match parts", "parts.toml", [seeds.PARTS.encode()], mutated_text,
                     [[*matching, "--parts", "parts.toml"]], staged)
        yield Format("match keyframes", "poses.toml", [seeds.POSES.encode()], mutated_text,
                     [[*matching, "--keyframes", "poses.toml"]], staged)
        bvh = self.staged("plan", {"motion.bvh": seeds.bvh(40)})
        yield Format("plan", "plan.toml", [seeds.PLAN.encode()], mutated_text, prepare, bvh)

        dances = {
            "plan.toml": seeds.DANCES_PLAN, "dances.json": seeds.DANCES,
            "intervals.csv": seeds.INTERVALS,
        }
        files = {name: text.encode() for name, text in dances.items()}
        beside = {"motion.c3d": markers[0], "song.wav": seeds.wav(22050, 1, 2, 2.0)}
        staged = self.staged("dances", {**files, **beside})
        for name, content in files.items():
            yield Format(f"dances {name}", name, [content], mutated_text, prepare, staged)

    def songs(self) -> Iterator[Format]:
        """Inputs of `audio features`."""
        tones = self.fixtures / "audio"
        golden = self.fixtures / "golden/audio"
        waves = [seeds.wav(*form) for form in [
            (22050, 1, 2, 0.4), (44100, 2, 2, 0.2), (8000, 1, 1, 0.6), (48000, 1, 3, 0.2),
            (22050, 1, 4, 0.3, True), (16000, 6, 2, 0.1)]]
        files = {
            "wav": waves,
            "mp3": [(tones / "tones.mp3").read_bytes()],
            "flac": [(tones / "tones.flac").read_bytes(), (golden / "edge_silence.flac").read_bytes()],
            "ogg": [(tones / "tones.ogg").read_bytes()],
        }
        for name, songs in files.items():
            command = ["audio", "features", f"song.{name}", "--out", "out"]
            yield Format(name, f"song.{name}", songs, mutated, [command])

    def arrays(self) -> Iterator[Format]:
        """Motion, statistics and features that are named on the command line."""
        motions = [
            seeds.npy((30, 25), seeds.phrase(30)), seeds.npy((30, 22, 3)), seeds.npy((12, 263)),
            seeds.npy((12, 251), version=2), seeds.npy((12, 25), descr="<f8", fortran=True),
            seeds.npy((3, 25), descr="<i4"),
        ]
        commands = [
            ["check", "motion.npy"], ["plot", "motion.npy", "--out", "out.svg"],
            ["check", "motion.npy", "--profile", "strict", "--run", RUN],
        ]
        yield Format("motion npy", "motion.npy", motions, mutated, commands)
        features = [seeds.features(24, False), seeds.features(24, True)]
        command = ["sample", RUN, "--audio-features", "cond.npz", *ONE_STEP]
        yield Format("features npz", "cond.npz", features, mutated_archive, [command])

    def weights(self) -> Iterator[Format]:
        """Inputs of `import`, and text embeddings."""
        files = [path.read_bytes() for path in sorted((self.fixtures / "gmd").glob("*.pt"))]
        ones = seeds.npy((263,), [1.0] * 263)
        staged = self.staged("import", {"m.npy": ones, "s.npy": ones})
        arch = ["--arch", "gmd_trajectory", "--mean", "m.npy", "--std", "s.npy", "--out", "out"]
        yield Format("pt", "weights.pt", files[::-1], mutated_archive,
                     [["import", "weights.pt", *arch]], staged)
        beside = self.staged("statistics", {"s.npy": ones, "weights.pt": files[-1]})
        double = seeds.npy((263,), [1.0] * 263, "<f8")
        yield Format("statistics npy", "m.npy", [ones, double], mutated,
                     [["import", "weights.pt", *arch]], beside)
        rows = seeds.npy((512,), [0.01] * 512)[-2048:]
        head = b'{"text":{"dtype":"F32","shape":[512],"data_offsets":[0,2048]}}'
        embedding = len(head).to_bytes(8, "little") + head + rows
        command = ["sample", RUN, "--text-embedding", "text.safetensors#text", *ONE_STEP]
        yield Format("embedding", "text.safetensors", [embedding], mutated_tensors, [command])

    def datasets(self) -> Iterator[Format]:
        """Files of datasets in both layouts."""
        made = self.staging / "made"
        made.mkdir(parents=True, exist_ok=True)
        for name, options in [("phrases", []), ("walks", ["--walks"])]:
            shutil.rmtree(made / name, ignore_errors=True)
            self.program.run("data", "synth", "--out", made / name, "--phrases", 3, "--frames", 44,
                             *options)
        inspect = [["data", "inspect", "set"]]
        listed = [["data", "inspect", "set"], ["data", "inspect", "set", "--humanml3d"]]
        for name, pattern, damage, commands in [
            ("phrases", "motion/*/*.npy", mutated, inspect),
            ("phrases", "audio_features/*/*.npz", mutated_archive, inspect),
            ("walks", "train.txt", mutated_text, listed),
            ("walks", "texts/*.txt", mutated_text, listed),
            ("walks", "new_joint_vecs/*.npy", mutated, listed),
            ("walks", "text_embeddings.safetensors", mutated_tensors, listed),
        ]:
            files = sorted((made / name).glob(pattern))
            if not files:
                self.missing.append(f"{name} {pattern}")
                continue
            staged = self.staging / f"{name} {files[0].name}"
            shutil.copytree(made / name, staged / "set", dirs_exist_ok=True)
            file = f"set/{files[0].relative_to(made / name)}"
            contents = [path.read_bytes() for path in files]
            yield Format(f"{name} {files[0].name}", file, contents, damage, commands, staged)
        yield from self.prepared()
        yield from self.statistics_of_walks(made / "walks", listed)

    def statistics_of_walks(self, walks: Path, listed: list[list[str]]) -> Iterator[Format]:
        """Statistics of a dataset."""
        ones = seeds.npy((263,), [1.0] * 263)
        staged = self.staging / "walks Mean"
        shutil.copytree(walks, staged / "set", dirs_exist_ok=True)
        (staged / "set/Std_abs_3d.npy").write_bytes(ones)
        yield Format("walks Mean_abs_3d.npy", "set/Mean_abs_3d.npy", [ones], mutated, listed, staged)

    def prepared(self) -> Iterator[Format]:
        """The manifest and the notes of a prepared dataset."""
        staged = self.staged("prepared", {
            "plan.toml": seeds.PLAN.encode(), "motion.bvh": seeds.bvh(40)})
        Program(self.setting.binary, staged, self.setting.environment()).run(
            "data", "prepare", "plan.toml")
        queries = [
            ["data", "inspect", "set", "--where", "frames > 1"], ["data", "inspect", "set"],
            ["data", "inspect", "set", "--plot", "out.svg"],
        ]
        again = [["data", "prepare", "plan.toml"]]
        places = [("set/manifest.parquet", mutated, queries)]
        notes = sorted((staged / "set/prepare").rglob("*")) if staged.exists() else []
        texts = [path for path in notes if path.is_file()]
        places += [(str(path.relative_to(staged)), mutated_text, again) for path in texts[:3]]
        for file, damage, commands in places:
            path = staged / file
            if not path.is_file():
                self.missing.append(file)
                continue
            yield Format(path.name, file, [path.read_bytes()], damage, commands, staged)

    def of_runs(self) -> Iterator[Format]:
        """Files of runs, and checkpoints whose checksums are right."""
        recipe = min(self.setting.recipes, key=lambda recipe: tree_bytes(recipe.reference))
        staged = self.staging / "run"
        shutil.copytree(recipe.reference, staged / "runs/small", dirs_exist_ok=True)
        last = checkpoints(staged / "runs/small")[-1].relative_to(staged)
        for other in checkpoints(staged / "runs/small")[:-1]:
            shutil.rmtree(other)
        train = ["train", f"shared/recipes/{recipe.name}/config.toml", "--resume"]
        # A damaged config may ask for billions of steps.
        train += ["--set", "train.max_steps=12"]
        sample = recipe.use("runs/small", "out")
        plot = ["plot", "runs/small", "--out", "out.svg"]
        for name, damage, commands in [
            ("metrics.jsonl", mutated_text, [plot, train]),
            ("config.toml", mutated_text, [train, sample]),
            ("checkpoints/best.json", mutated_text, [sample, train]),
            ("loader.jsonl", mutated_text, [train]),
        ]:
            path = staged / "runs/small" / name
            if not path.is_file():
                self.missing.append(name)
                self.setting.say(f"NOT ATTACKED: the run of {recipe.name} has no `{name}`")
                continue
            content = path.read_bytes()
            yield Format(name, f"runs/small/{name}", [content], damage, commands, staged)
        alone = recipe.use(last, "out")
        trained = [*alone, "--no-ema"]
        text = (staged / last / "state.json").read_text()
        state = text[:text.rfind(SEAL)].encode()
        yield Format(
            "state.json", f"{last}/state.json", [state], mutated_text, [alone, train], staged,
            lambda folder: seal_state(folder / last),
        )
        yield Format("state.json unsealed", f"{last}/state.json", [text.encode()], mutated_text,
                     [alone, train], staged)
        for name, commands in [
            ("ema", [alone]), ("model", [trained, ["merge", str(last), "--out", "out"], train]),
            ("optimizer", [train]),
        ]:
            content = (staged / last / f"{name}.safetensors").read_bytes()
            yield Format(
                f"checkpoint {name}", f"{last}/{name}.safetensors", [content], mutated_tensors,
                commands, staged, lambda folder: seal_files(folder / last),
            )

    def settings(self) -> Iterator[Format]:
        """Configs, goals and lists."""
        configs = [path.read_bytes() for path in sorted((self.setting.root / "configs").glob("*.toml"))]
        small = [recipe.shortest.read_bytes() for recipe in self.setting.recipes]
        show = ["config", "show", "config.toml"]
        yield Format("config", "config.toml", [*small, *configs], mutated_text, [show])
        goals = [goal.encode() for goal in seeds.GOALS]
        command = ["sample", RUN, "--goal", "goal.toml", *ONE_STEP]
        yield Format("goal", "goal.toml", goals, mutated_text, [command])
        ids = b"synthetic_00000\nsynthetic_00001\nsynthetic_*3\n"
        commands = [
            ["train", f"shared/recipes/{recipe.name}/shortest.toml", "--set",
             "data.validation.ids_file=ids.txt"]
            for recipe in self.setting.recipes
        ]
        yield Format("ids", "ids.txt", [ids], mutated_text, commands)


def archive(arrays: dict[str, bytes]) -> bytes:
    """An npz of arrays."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zipped:
        for name, content in arrays.items():
            zipped.writestr(zipfile.ZipInfo(f"{name}.npy"), content)
    return file.getvalue()


def seal_state(checkpoint: Path) -> None:
    """Updates the checksums of `state.json`."""
    body = (checkpoint / "state.json").read_bytes().decode(errors="replace")
    (checkpoint / "state.json").write_text(sealed(body))


def seal_files(checkpoint: Path) -> None:
    """Writes the checksums of damaged tensors."""
    resealed(checkpoint)


def tree_bytes(folder: Path) -> int:
    """The size of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
