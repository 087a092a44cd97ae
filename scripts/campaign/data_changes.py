"""A dataset that changes between stop and resume: refused, or the same run."""

import shutil
import struct
from pathlib import Path

from attack import TRAINING, RunAttack
from case import Case, Setting
from judge import SUCCESS
from program import Program
from recipes import Recipe
from runs import last_differs

LAYOUTS = [[], ["--walks"]]
"""Of `kinegrad data synth`."""
CHANGES = ["number", "bit", "cut", "removed", "added", "rewritten", "empty", "swapped"]


class DataChanges(RunAttack):
    """Files of the dataset are changed, cut, removed, added or written again."""

    name = "data"
    weight = 2

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.datasets: list[tuple[Recipe, Path]] = []
        program = Program(setting.binary, setting.out, setting.environment())
        folders = []
        for index, options in enumerate(LAYOUTS):
            folder = setting.shared / "datasets" / str(index)
            shutil.rmtree(folder, ignore_errors=True)
            made = program.run(
                "data", "synth", "--out", folder, "--phrases", 8, "--frames", 48, *options
            )
            folders += [folder] if made.code == SUCCESS else []
        for recipe in setting.recipes:
            self.prepare(program, recipe, folders)

    def prepare(self, program: Program, recipe: Recipe, folders: list[Path]) -> None:
        """Finds the kind of data and the dataset that a recipe trains on from files."""
        kinds = program.choices(recipe.config, "data.kind")
        for kind in [kind for kind in kinds if not kind.startswith("synthetic")]:
            for folder in folders:
                place = self.setting.shared / "from_files" / recipe.name
                shutil.rmtree(place, ignore_errors=True)
                place.mkdir(parents=True)
                settings = [f"data.kind={kind}", "data.source=data"]
                shown = program.show(recipe.config, settings)
                (place / "config.toml").write_text(shown.stdout)
                shutil.copytree(folder, place / "data")
                trainer = Program(program.binary, place, program.environment)
                ended = trainer.run("train", "config.toml")
                if ended.code == SUCCESS:
                    self.datasets.append((recipe, place))
                    return

    def training(self, case: Case, recipe: Recipe) -> list[str]:
        """The command on files."""
        resume = ["--resume"] if (case.folder / "runs/small").exists() else []
        config = f"shared/from_files/{recipe.name}/config.toml"
        return ["train", config, "--runs-dir", "runs", *resume]

    def attack(self, case: Case) -> None:
        """Stops, changes a file, resumes; puts it back, and resumes again."""
        recipe, place = self.datasets[case.number % len(self.datasets)]
        reference = place / "runs/small"
        data, kept = case.folder / "data", place / "data"
        shutil.copytree(kept, data)
        case.label = recipe.name
        if not self.half_run(case, recipe):
            return
        change = case.random.choice(CHANGES)
        files = [path for path in sorted(data.rglob("*")) if path.is_file()]
        path = case.random.choice(files)
        case.label += f" {change} {path.suffix[1:]}"
        case.history.append(f"# {path.relative_to(data)}: {change}")
        changed(case, data, path, change)
        resumed = case.run(*self.training(case, recipe), limits=TRAINING)
        run = case.folder / "runs/small"
        if resumed.code == SUCCESS and (wrong := last_differs(run, reference)):
            found = f"{path.relative_to(data)} ({change}): " + "; ".join(wrong[:3])
            expected = "refused, or the bytes of the run on the first data"
            case.wrong("wrong bytes", change, found, expected, resumed)
            return
        case.counts["refused"] += resumed.code != SUCCESS
        shutil.rmtree(data)
        shutil.copytree(kept, data)
        again = case.run(*self.training(case, recipe), limits=TRAINING)
        if again.code != SUCCESS:
            self.lost(case, again)
        elif wrong := last_differs(run, reference):
            found = "; ".join(wrong[:3])
            case.wrong("wrong bytes", "put back", found, "the bytes of the run", again)

    def total(self) -> int | None:
        """None at all if no recipe trains from files."""
        return None if self.datasets else 0


def changed(case: Case, data: Path, path: Path, change: str) -> None:
    """Makes a change to a file of a dataset."""
    content = bytearray(path.read_bytes())
    place = case.random.randrange(max(len(content), 1))
    if change == "number" and len(content) > 200:
        place = len(content) - 4 * case.random.randint(1, 25)
        content[place:place + 4] = struct.pack("<f", case.random.gauss(0, 1))
    elif change in ("number", "bit") and content:
        content[place] ^= 1 << case.random.randrange(8)
    elif change == "cut":
        del content[place:]
    elif change == "empty":
        content.clear()
    elif change == "removed":
        path.unlink()
        return
    elif change == "added":
        added(data, path)
        return
    elif change == "swapped":
        others = sorted(other for other in data.rglob(f"*{path.suffix}") if other.is_file())
        content = bytearray(case.random.choice(others).read_bytes())
    path.write_bytes(content)


def added(data: Path, path: Path) -> None:
    """Adds a copy of an item: every path with its name, under another name."""
    named = path.stem if path.parent.parent == data else path.parent.name
    for other in sorted(data.rglob(f"{named}*")):
        target = other.with_name(other.name.replace(named, f"{named}9"))
        if other.is_dir():
            shutil.copytree(other, target)
        else:
            shutil.copyfile(other, target)
    for listed in data.glob("*.txt"):
        listed.write_text(listed.read_text().rstrip("\n") + f"\n{named}9\n")
