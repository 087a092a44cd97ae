"""Damage to the files of a run: detected, and never in the weights."""

import shutil
from pathlib import Path

from attack import TRAINING, RunAttack
from case import Case
from judge import INVALID, SUCCESS
from runs import last_differs

KINDS = ["bit", "bit", "bit", "cut", "zeros", "removed", "empty", "longer"]
NOT_NEEDED = [
    "metrics.jsonl", "loader.jsonl", "environment.jsonl", "events.out.tfevents.kinegrad", "best.json", "lock",
]
"""Files of a run that a resume does not need."""


class Flips(RunAttack):
    """One bit, a cut or a removal in one file of a finished or a half run."""

    name = "flips"
    weight = 2

    def attack(self, case: Case) -> None:
        """Damages a file, resumes, and compares the weights."""
        recipe = self.recipe(case)
        folder = case.folder / "runs/small"
        if case.random.random() < 0.5:
            folder.parent.mkdir()
            shutil.copytree(recipe.reference, folder)
        elif not self.half_run(case, recipe):
            return
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        kept = [path for path in files if "checkpoints" in path.parts]
        path = case.random.choice(kept if case.random.random() < 0.8 else files)
        kind = case.random.choice(KINDS)
        damage(case, path, kind)
        name = str(path.relative_to(folder))
        case.label = f"{recipe.name} {path.name} {kind}"
        case.history.append(f"# {name}: {kind}")

        sampled = case.run(*recipe.use("runs/small"))
        resumed = case.run(*self.training(case, recipe), limits=TRAINING)
        of_checkpoint = path.parent.name.startswith("step-")
        if resumed.code == SUCCESS:
            if wrong := last_differs(folder, recipe.reference):
                found = "; ".join(wrong[:4])
                expected = "the bytes of a run without damage, or exit code 2"
                case.wrong("wrong bytes", name, found, expected, resumed)
        elif path.name in NOT_NEEDED:
            found = f"exit code {resumed.code}: {resumed.stderr.strip()[:300]}"
            case.wrong("lost run", path.name, found, "the run goes on without the file", resumed)
        elif of_checkpoint and path.name not in resumed.stderr and "step-" not in resumed.stderr:
            case.wrong("no reason", path.name, resumed.stderr[:300], "the damage by name", resumed)
        elif of_checkpoint and resumed.code != INVALID:
            case.wrong("exit code", path.name, f"exit code {resumed.code}", "0 or 2", resumed)
        if sampled.code not in (SUCCESS, INVALID):
            found = f"exit code {sampled.code}: {sampled.stderr[:200]}"
            case.wrong("exit code", f"sample {path.name}", found, "0 or 2", sampled)


def damage(case: Case, path: Path, kind: str) -> None:
    """Damages a file."""
    content = bytearray(path.read_bytes())
    place = case.random.randrange(max(len(content), 1))
    if kind == "removed":
        path.unlink()
        return
    if kind == "bit" and content:
        content[place] ^= 1 << case.random.randrange(8)
    elif kind == "cut":
        del content[place:]
    elif kind == "zeros":
        content[place:place + 64] = bytes(len(content[place:place + 64]))
    elif kind == "empty":
        content.clear()
    else:
        content += case.random.randbytes(case.random.choice([1, 100]))
    path.write_bytes(content)
