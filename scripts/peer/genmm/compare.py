#!/usr/bin/env python3
"""Times kinegrad's synthesis beside the published algorithm in PyTorch, in turn on the same cores.

    scripts/peer/genmm/compare.py [--rounds N] MATCHING_TABLE EXAMPLE.bvh

MATCHING_TABLE is the program of
`cargo build --release -p kinegrad-matching --example matching_table`; its time has the file's
conversion to a matrix and back in it. The peer makes a motion of as many frames and channels of
smooth noise: its time does not depend on the values. Needs torch.
"""

import argparse
import os
import subprocess
import sys
import time

import torch
from matching import synthesized


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("program", metavar="MATCHING_TABLE")
    parser.add_argument("example", metavar="EXAMPLE.bvh")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    torch.set_num_threads(cores)
    frames, channels = size(arguments.example)
    example = torch.cumsum(torch.randn(frames, channels), 0) / frames**0.5
    own, peer = [], []
    for seed in range(arguments.rounds):
        own.append(measured(arguments.program, arguments.example))
        start = time.perf_counter()
        synthesized(example, 2 * frames, seed=seed)
        peer.append(time.perf_counter() - start)
    ours, theirs = sorted(own)[len(own) // 2], sorted(peer)[len(peer) // 2]
    print(f"{frames} frames, {channels} channels, to twice as many, {cores} cores, medians of {len(own)}")
    print(f"kinegrad {ours:.3f} s, PyTorch {theirs:.3f} s, ratio {theirs / ours:.1f}")
    return 0


def size(path: str) -> tuple[int, int]:
    """Frames at about 30 a second, and channels, of a BVH file."""
    with open(path, encoding="utf-8", errors="replace") as file:
        words = file.read().split()
    joints = words.count("JOINT") + words.count("ROOT")
    place = words.index("MOTION")
    frames, seconds = int(words[place + 2]), float(words[place + 5])
    while seconds < 0.017:
        frames, seconds = (frames + 1) // 2, 2 * seconds
    return frames, 6 * joints + 3


def measured(program: str, example: str) -> float:
    """Seconds of one synthesis, as the program says."""
    command = [program, "--presets", "--seeds", "1", example]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    row = next(line for line in result.stdout.splitlines() if line.startswith("published"))
    return float(row.split()[-1])


if __name__ == "__main__":
    sys.exit(main())
