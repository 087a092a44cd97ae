"""A config for each recipe of the program that trains in a fraction of a second.

The recipes are those that the program names. A config is one of `configs` on synthetic data, made as
small as the program accepts.
"""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from program import Program, leaves, parsed

SMALL = [
    "run.device=cpu", "run.name=small", "run.seed=7", "data.target_frames=16", "data.batch_size=2",
    "data.num_workers=0", "data.synthetic.phrases=8", "data.synthetic.frames=48",
    "data.validation.fraction=0.25",
    "train.log_every_steps=1", "optim.warmup_steps=2", "ema.decay=0.9", "ema.update_every=1",
    "validation.draws=1", "sampling.sampler.num_inference_steps=3", "rollout.steps=2",
    "init.pretrain.diffusion_steps=3", "init.pretrain.decoder_steps=3",
]
"""Settings of the loop; a recipe ignores keys that it lacks."""
LENGTH = [
    "train.max_steps=12", "checkpoint.every_steps=2", "checkpoint.keep_last=2",
    "validation.every_steps=4", "sampling.count_at_end=1",
]
SHORTEST = [
    "train.max_steps=2", "checkpoint.every_steps=1", "checkpoint.keep_last=2",
    "validation.every_steps=1", "sampling.count_at_end=0",
]
SIZES = [8, 16, 32, 64]
"""Tried for each number of a network."""
NETWORKS = ("model.", "decoder.")
PARAMETERS = re.compile(r"model: ([\d,]+) parameters")
STEPS = 12


@dataclass
class Recipe:
    """A recipe with its small configs."""

    name: str
    config: Path
    """Of a run of `STEPS` steps with checkpoints."""
    shortest: Path
    """Of a run of two steps."""
    reference: Path
    """The finished run of `config`."""
    seconds: float
    """That it took."""
    shown: dict[str, object]
    generates: bool
    """True if its runs can be sampled; others can only be evaluated."""

    def use(self, run: object, out: str = "sample") -> list[str]:
        """The shortest command that uses the weights of a run; samples are called `out`."""
        if self.generates:
            options = ["--steps", "1", "--overwrite", "--allow-unusable"]
            return ["sample", str(run), "--out", out, *options]
        return ["eval", str(run)]


def recipes_of(program: Program, configs: Path, shared: Path) -> tuple[list[Recipe], list[str]]:
    """All recipes with their small configs, and those that none was found for."""
    empty = shared / "empty.toml"
    empty.write_text("")
    names = program.choices(empty, "train.recipe")
    kinds = [kind for kind in program.choices(empty, "data.kind") if kind.startswith("synthetic")]
    shipped = [path for path in sorted(configs.glob("*.toml")) if is_config(program, path, kinds)]
    done: list[Recipe] = []
    waiting = list(names)
    # A recipe that is initialised from another's run comes after it.
    while waiting:
        before = len(done)
        for name in list(waiting):
            if recipe := small_recipe(program, name, shipped, kinds, shared, done):
                done.append(recipe)
                waiting.remove(name)
        if len(done) == before:
            break
    return done, waiting


def is_config(program: Program, path: Path, kinds: list[str]) -> bool:
    """True if a file is a training config."""
    return any(program.show(path, [f"data.kind={kind}"]).code == 0 for kind in kinds)


def small_recipe(
    program: Program, name: str, shipped: list[Path], kinds: list[str], shared: Path,
    done: list[Recipe],
) -> Recipe | None:
    """The small configs of a recipe, from the smallest shipped config that can be trained with."""
    candidates = []
    for base in shipped:
        for kind in kinds:
            settings = [f"train.recipe={name}", f"data.kind={kind}"]
            shown = program.show(base, settings)
            if shown.code == 0:
                own = parsed(program.show(base, [f"data.kind={kind}"]).stdout or "")
                mine = own.get("train", {}).get("recipe") == name
                candidates.append((not mine, parameters(shown.stdout), base, settings))
    folder = shared / "recipes" / name
    folder.mkdir(parents=True, exist_ok=True)
    for _, _, base, settings in sorted(candidates, key=lambda item: item[:2]):
        for networks in (True, False):
            smaller = shrunk(program, base, settings, networks)
            for start in starts(program, base, smaller, done):
                config, shortest = folder / "config.toml", folder / "shortest.toml"
                for path, length in [(config, LENGTH), (shortest, SHORTEST)]:
                    accepted = with_accepted(program, base, [*smaller, *start], length)
                    path.write_text(program.show(base, accepted).stdout)
                if trained := trains(program, folder, config):
                    reference, seconds = trained
                    shown = parsed(shortest.read_text())
                    # Refused by recipes that generate nothing.
                    count = parsed(config.read_text()).get("sampling", {}).get("count_at_end", 0)
                    return Recipe(name, config, shortest, reference, seconds, shown, count > 0)
    return None


def parameters(shown: str) -> int:
    """Number of a network's parameters, from `config show`."""
    numbers = PARAMETERS.findall(shown)
    return sum(int(number.replace(",", "")) for number in numbers) if numbers else 1 << 60


def with_accepted(
    program: Program, base: Path, settings: list[str], more: list[str]
) -> list[str]:
    """The settings, with each of `more` that the program accepts in addition."""
    for setting in more:
        if program.show(base, [*settings, setting]).code == 0:
            settings = [*settings, setting]
    return settings


def shrunk(program: Program, base: Path, settings: list[str], networks: bool) -> list[str]:
    """The settings, with those that make the run small. With `networks`, each size of a network is
    the smallest that reduces the number of parameters."""
    settings = with_accepted(program, base, settings, SMALL)
    if not networks:
        return settings
    for _ in range(2):
        for key, value in list(leaves(parsed(program.show(base, settings).stdout))):
            if not key.startswith(NETWORKS):
                continue
            if isinstance(value, list) and len(value) > 2 and isinstance(value[0], (int, float)):
                tries = [value[:2]]
            elif isinstance(value, int) and not isinstance(value, bool) and value > SIZES[0]:
                tries = [size for size in SIZES if size < value]
            else:
                continue
            least = parameters(program.show(base, settings).stdout)
            for small in tries:
                shown = program.show(base, [*settings, f"{key}={small}"])
                if shown.code == 0 and parameters(shown.stdout) < least:
                    settings = [*settings, f"{key}={small}"]
                    break
    return settings


def starts(
    program: Program, base: Path, settings: list[str], done: list[Recipe]
) -> list[list[str]]:
    """The possible initialisations of a run: none, or the run of another recipe."""
    shown = parsed(program.show(base, settings).stdout)
    empty = [key for key, value in leaves(shown) if key.startswith("init.") and value == ""]
    others = [[f"{key}={recipe.reference}"] for key in empty for recipe in done]
    return [[], *others]


def trains(program: Program, folder: Path, config: Path) -> tuple[Path, float] | None:
    """The run of a config, and its seconds."""
    runs = folder / "runs"
    shutil.rmtree(runs, ignore_errors=True)
    # A run's nested runs contain its path, which must be that of the cases: `runs/small`.
    trainer = Program(program.binary, folder, program.environment)
    ended = trainer.run("train", config, "--runs-dir", "runs", watch=True)
    if ended.code != 0:
        return None
    program.address_space = max(program.address_space, trainer.address_space)
    program.resident = max(program.resident, trainer.resident)
    return next(path for path in runs.iterdir() if path.is_dir()), ended.seconds
