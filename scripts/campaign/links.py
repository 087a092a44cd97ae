"""Folders from elsewhere with links that lead out of them, or in circles."""

import shutil
from collections.abc import Callable
from pathlib import Path

import seeds
from attack import Attack
from case import Case, Setting
from outside import all_files, guarded, link, outside_of, put_outside
from program import Program
from recipes import Recipe
from runs import checkpoints

WRITTEN = [
    "report.html", "report.html.partial", "metrics.jsonl.partial", "config.toml.partial", "reports",
    "samples", "lock", "loader.jsonl", "environment.jsonl", "checkpoints/best.json.partial",
    "checkpoints/latest", "events.out.tfevents.kinegrad",
]
"""Names in a run that a program may write to."""
FAN = 24
"""Folders of which each has two links to the next: 2^24 ways."""


class Links(Attack):
    """Links in runs, datasets and outputs to files outside, and links in circles."""

    name = "links"
    weight = 5

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.sets = setting.shared / "linked"
        shutil.rmtree(self.sets, ignore_errors=True)
        self.sets.mkdir(parents=True)
        program = Program(setting.binary, self.sets, setting.environment())
        for name, options in [("phrases", []), ("walks", ["--walks"])]:
            program.run("data", "synth", "--out", name, "--phrases", 4, "--frames", 48, *options)
        (self.sets / "plan.toml").write_text(seeds.PLAN)
        (self.sets / "motion.bvh").write_bytes(seeds.bvh(40, spine=True))
        program.run("data", "prepare", "plan.toml")
        self.scenes: list[Callable[[Case], None]] = [
            self.run_folder, self.second_time, self.dataset, self.prepared, self.outputs, self.circles,
        ]

    def attack(self, case: Case) -> None:
        """One of the scenes."""
        put_outside(case)
        self.scenes[case.number % len(self.scenes)](case)

    def recipe(self, case: Case) -> Recipe:
        """A recipe, whose finished run becomes `runs/small`."""
        recipe = case.random.choice(self.setting.recipes)
        shutil.copytree(recipe.reference, case.folder / "runs/small")
        return recipe

    def run_folder(self, case: Case) -> None:
        """A file or folder of a run is a link, or a link waits where something is written."""
        recipe = self.recipe(case)
        run = case.folder / "runs/small"
        if case.random.random() < 0.5:
            # So that the run goes on.
            for checkpoint in checkpoints(run)[1:]:
                shutil.rmtree(checkpoint)
        paths = sorted(path for path in run.rglob("*"))
        for _ in range(case.random.choice([1, 1, 2])):
            if case.random.random() < 0.3:
                path = run / case.random.choice(WRITTEN)
            else:
                folders = [path for path in paths if path.is_dir()]
                path = case.random.choice(folders if folders and case.random.random() < 0.4 else paths)
            # An earlier link may have replaced its folder.
            if path.parent.is_dir() and not path.parent.resolve().is_relative_to(outside_of(case)):
                link(case, path)
        case.label = f"run, {path.name}"
        for command in case.random.sample(commands(recipe), 3):
            guarded(case, command)

    def second_time(self, case: Case) -> None:
        """A file that a command has written is a link when the command runs again."""
        recipe = self.recipe(case)
        command = case.random.choice(commands(recipe))
        before = all_files(case)
        guarded(case, command)
        made = sorted(all_files(case) - before)
        if not made:
            return
        path = case.folder / case.random.choice(made)
        link(case, path)
        case.label = f"second time, {path.name}"
        guarded(case, command)

    def dataset(self, case: Case) -> None:
        """A file or folder of a dataset is a link."""
        name = case.random.choice(["phrases", "walks"])
        shutil.copytree(self.sets / name, case.folder / "set")
        path = case.random.choice(sorted((case.folder / "set").rglob("*")))
        link(case, path)
        case.label = f"{name}, {path.name}"
        for command in [["data", "inspect", "set"], ["check", "set"],
                        ["view", "set", "--out", "out.html"]]:
            guarded(case, command)

    def prepared(self, case: Case) -> None:
        """A prepared dataset, which is prepared again, contains a link."""
        for name in ("plan.toml", "motion.bvh"):
            shutil.copy(self.sets / name, case.folder)
        shutil.copytree(self.sets / "set", case.folder / "set")
        path = case.random.choice(sorted((case.folder / "set").rglob("*")))
        link(case, path)
        case.label = f"prepared, {path.name}"
        again = case.random.choice([[], ["--again"], ["--again", "--prune"]])
        guarded(case, ["data", "prepare", "plan.toml", *again])
        guarded(case, ["data", "inspect", "set"])

    def outputs(self, case: Case) -> None:
        """An output is a link."""
        (case.folder / "motion.bvh").write_bytes(seeds.bvh(30, spine=True))
        (case.folder / "song.wav").write_bytes(seeds.wav(22050, 1, 2, 0.4))
        name, *command = case.random.choice([
            ["new.bvh", "match", "motion.bvh", "--out", "new.bvh"],
            ["new.svg", "match", "motion.bvh", "--out", "new.bvh", "--svg", "new.svg"],
            ["new.html", "view", "motion.bvh", "--out", "new.html"],
            ["motion.html", "view", "motion.bvh"],
            ["new.gif", "view", "motion.bvh", "--gif", "new.gif"],
            ["new.glb", "view", "motion.bvh", "--glb", "new.glb"],
            ["new.svg", "plot", "motion.bvh", "--out", "new.svg"],
            ["song/features.npz", "audio", "features", "song.wav", "--out", "."],
        ])
        path = case.folder / (name + case.random.choice(["", "", "", ".partial", ".tmp"]))
        path.parent.mkdir(exist_ok=True)
        link(case, path)
        case.label = f"output, {path.name}"
        guarded(case, [*command, *case.random.choice([[], ["--overwrite"]])])

    def circles(self, case: Case) -> None:
        """Folders that contain themselves, one another, or many ways to one place."""
        top = case.folder / "top"
        kind = case.random.choice(["self", "parent", "two", "fan", "root"])
        case.label = f"circle, {kind}"
        (top / "a").mkdir(parents=True)
        (top / "a/motion.bvh").write_bytes(seeds.bvh(20, spine=True))
        if kind == "fan":
            for level in range(FAN):
                (top / f"{level}").mkdir()
                for name in ("x", "y"):
                    (top / f"{level}/{name}").symlink_to(f"../{level + 1}")
            (top / f"{FAN}").symlink_to("a")
        elif kind == "two":
            (top / "one").symlink_to("two")
            (top / "two").symlink_to("one")
        else:
            target = {"self": "self", "parent": "..", "root": "/"}[kind]
            (top / kind).symlink_to(target)
        for command in [
            ["view", "top", "--out", "out.html"], ["check", "top"], ["runs", "top"],
            ["data", "inspect", "top"], ["plot", "top", "--out", "out.svg"], ["report", "top"],
        ]:
            guarded(case, command)


def commands(recipe: Recipe) -> list[list[str]]:
    """Commands that read or write the run `runs/small`."""
    train = ["train", f"shared/recipes/{recipe.name}/config.toml", "--runs-dir", "runs"]
    return [
        [*train, "--resume"], train, recipe.use("runs/small"), ["eval", "runs/small"],
        ["report", "runs/small"], ["plot", "runs/small", "--out", "out.svg", "--overwrite"],
        ["check", "runs/small"], ["view", "runs/small", "--out", "out.html", "--overwrite"],
        ["runs", "runs"], ["merge", "runs/small", "--out", "merged"],
    ]
