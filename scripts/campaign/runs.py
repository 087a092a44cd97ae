"""Runs on disk: integrity of their checkpoints, and equality of two runs."""

import hashlib
import json
from pathlib import Path

CLOCK = ("time", "elapsed_seconds", "steps_per_second")
"""Time values in metrics (docs/training.md)."""
OF_THE_CLOCK = ("environment.jsonl", "loader.jsonl", "lock")
"""Files that contain times, or nothing."""
SEAL = ',\n  "state_sha256": "'
UNFINISHED = ".writing-"


def checkpoints(run: Path) -> list[Path]:
    """Checkpoints under their final names, oldest first."""
    return sorted((run / "checkpoints").glob("step-*"))


def damage(checkpoint: Path) -> str | None:
    """The faults of a checkpoint; none if it is valid."""
    try:
        text = (checkpoint / "state.json").read_text()
        body = text[:text.rfind(SEAL)]
        if text != sealed(body):
            return "state.json does not match its checksum"
        for name, digest in json.loads(body + "\n}")["checksums"].items():
            if hashlib.sha256((checkpoint / name).read_bytes()).hexdigest() != digest:
                return f"{name} does not match its checksum"
    except (OSError, ValueError, KeyError) as error:
        return str(error)
    return None


def sealed(body: str) -> str:
    """The text of `state.json` with the checksum of its body."""
    return f'{body}{SEAL}{hashlib.sha256(body.encode()).hexdigest()}"\n}}\n'


def resealed(checkpoint: Path, body: str | None = None) -> None:
    """Writes the checksums of a checkpoint's files, and of its state, anew."""
    path = checkpoint / "state.json"
    if body is None:
        text = path.read_text()
        state = json.loads(text[:text.rfind(SEAL)] + "\n}")
        for name in state["checksums"]:
            content = (checkpoint / name).read_bytes()
            state["checksums"][name] = hashlib.sha256(content).hexdigest()
        body = json.dumps(state, indent=2, ensure_ascii=False).removesuffix("\n}")
    path.write_text(sealed(body))


def damaged_checkpoints(runs: Path) -> list[str]:
    """Invalid checkpoints under a final name in all runs of a folder."""
    faults = []
    for state in sorted(runs.rglob("checkpoints/step-*")):
        if state.is_dir() and (reason := damage(state)):
            faults.append(f"{state.relative_to(runs)}: {reason}")
    return faults


def leftovers(runs: Path) -> list[str]:
    """Partial files."""
    return [str(path.relative_to(runs)) for path in sorted(runs.rglob(f"{UNFINISHED}*"))]


def contents(run: Path) -> dict[str, bytes]:
    """Every file of a run that the clock does not write into."""
    files = {}
    for path in sorted(run.rglob("*")):
        name = str(path.relative_to(run))
        # Evaluations between two starts leave reports.
        is_other = path.name in OF_THE_CLOCK or "tfevents" in path.name or name.startswith("reports/")
        if not path.is_file() or is_other:
            continue
        content = path.read_bytes()
        files[name] = without_clock(content) if path.name == "metrics.jsonl" else content
    return files


def without_clock(metrics: bytes) -> bytes:
    """Metrics without times."""
    lines = []
    for line in metrics.splitlines():
        try:
            values = json.loads(line)
            lines.append(json.dumps({k: v for k, v in values.items() if k not in CLOCK}).encode())
        except (ValueError, AttributeError):
            lines.append(line)
    return b"\n".join(lines)


def differences(run: Path, reference: dict[str, bytes]) -> list[str]:
    """The differences of a run from the contents of another."""
    mine = contents(run)
    missing = [f"{name} is missing" for name in reference if name not in mine]
    more = [f"{name} should not be there" for name in mine if name not in reference]
    other = [f"{name} differs" for name in mine if mine[name] != reference.get(name, mine[name])]
    return missing + more + other


def last_differs(run: Path, reference: Path) -> list[str]:
    """The differences of the last checkpoint of a run from that of another."""
    mine, others = checkpoints(run), checkpoints(reference)
    if not mine or mine[-1].name != others[-1].name:
        return [f"the last checkpoint is {mine[-1].name if mine else 'missing'}"]
    return [f"{mine[-1].name}/{text}" for text in differences(mine[-1], contents(others[-1]))]


def steps_logged(run: Path) -> int:
    """Number of lines of metrics."""
    try:
        return (run / "metrics.jsonl").read_bytes().count(b"\n")
    except OSError:
        return 0
