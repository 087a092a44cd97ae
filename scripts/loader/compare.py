#!/usr/bin/env python3
"""Samples per second of kinegrad's loader and of PyTorch's DataLoader on the same files.

    scripts/loader/run [--rounds N] [--seconds S] [--phrases N] [--workers 0,1,2,4]

Both processes of a row stay open and are measured in turn. The sums of an epoch must agree.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
TOLERANCE = 1e-5
FRAMES = 120
WARM_UP_EPOCHS_PER_WORKER = 5
"""Each process of PyTorch must have met each phrase before its cache is full."""


@dataclass
class Side:
    """A process that loads."""

    process: subprocess.Popen[str]
    sums: dict[str, float] = field(default_factory=dict)
    speeds: list[float] = field(default_factory=list)

    @classmethod
    def start(cls, command: list[str]) -> "Side":
        """Starts it and waits for its sums."""
        pipe = subprocess.PIPE
        side = cls(subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True))
        side.sums = side.answer()
        return side

    def answer(self) -> Any:
        """The next line."""
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"loader: `{self.process.args[0]}` ended without an answer")
        return json.loads(line)

    def measure(self, seconds: float) -> float:
        """Samples per second, now."""
        self.process.stdin.write(f"{seconds}\n")
        self.process.stdin.flush()
        return self.answer()

    def end(self) -> None:
        """Ends it."""
        self.process.stdin.close()
        self.process.wait()


def shown(speeds: list[float]) -> str:
    """Median, with the least and the greatest."""
    return f"{statistics.median(speeds):,.0f} ({min(speeds):,.0f} to {max(speeds):,.0f})"


def deflate(folder: Path) -> None:
    """Writes the archives of a dataset anew, as `np.savez_compressed` does."""
    for path in folder.glob("audio_features/*/features.npz"):
        with np.load(path) as archive:
            arrays = dict(archive)
        np.savez_compressed(path, **arrays)


def row(args: argparse.Namespace, folder: str, kind: str, workers: int, cached: bool) -> float:
    """Prints a row; returns its ratio."""
    memory = "1024" if cached else "0"
    epochs = str(WARM_UP_EPOCHS_PER_WORKER * max(workers, 1) if cached else 1)
    ours = [args.worker, "measure", folder, str(workers), memory, epochs]
    script = str(HERE / "torch_loader.py")
    theirs = [sys.executable, script, folder, str(workers), str(int(cached)), epochs]
    sides = [Side.start(ours), Side.start(theirs)]
    for key, sum_of_ours in sides[0].sums.items():
        sum_of_theirs = sides[1].sums[key]
        if abs(sum_of_ours - sum_of_theirs) > TOLERANCE * abs(sum_of_theirs):
            sys.exit(f"loader: sums of {key} differ: {sum_of_ours} and {sum_of_theirs}")
    for side in sides:
        side.measure(args.seconds)
    for _ in range(args.rounds):
        for side in sides:
            side.speeds.append(side.measure(args.seconds))
    for side in sides:
        side.end()
    ratio = statistics.median(sides[0].speeds) / statistics.median(sides[1].speeds)
    texts = [shown(side.speeds) for side in sides]
    print(f"| {kind} | {workers} | {texts[0]} | {texts[1]} | {ratio:.1f} |", flush=True)
    return ratio


def main() -> None:
    """Measures all rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("worker", help=argparse.SUPPRESS)
    parser.add_argument("--rounds", type=int, default=5, metavar="N")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="of each round")
    parser.add_argument("--phrases", type=int, default=256, metavar="N")
    parser.add_argument("--workers", default="0,1,2,4", metavar="N,...")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    ratios = []
    with tempfile.TemporaryDirectory(prefix="kinegrad_loader_") as folder:
        write = [args.worker, "write", folder, str(args.phrases), str(FRAMES)]
        subprocess.run(write, check=True)
        print("| phrases | workers | kinegrad, samples/s | PyTorch, samples/s | ratio |")
        print("|---|---|---|---|---|")
        for kind in ["read, stored", "read, deflated", "kept in memory"]:
            if kind == "read, deflated":
                deflate(Path(folder))
            for workers in map(int, args.workers.split(",")):
                ratios.append(row(args, folder, kind, workers, kind == "kept in memory"))
    print(
        f"\nMedian (least to greatest) of {args.rounds} rounds of {args.seconds:g} s, in turn;\n"
        f"{args.phrases} phrases of {FRAMES} frames in batches of 32; {os.cpu_count()} cores,\n"
        f"load {load:.1f} before and {os.getloadavg()[0]:.1f} after. Least ratio {min(ratios):.1f}."
    )


if __name__ == "__main__":
    main()
