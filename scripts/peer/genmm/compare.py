#!/usr/bin/env python3
"""Times kinegrad's synthesis beside the published algorithm in PyTorch, in turn on the same cores.

    scripts/peer/genmm/compare.py [--rounds N] MATCHING_TIME EXAMPLE.bvh

MATCHING_TIME is the program of
`cargo build --release -p kinegrad-matching --example matching_time`. Both times are of the synthesis
alone, from matrix to matrix; the peer makes a motion of as many frames and channels of smooth noise,
as its time does not depend on the values. Needs torch.
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
    parser.add_argument("program", metavar="MATCHING_TIME")
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
    print(f"{frames} frames, {channels} channels, to twice as many, {cores} cores, {len(own)} rounds")
    median = lambda seconds: sorted(seconds)[len(seconds) // 2]
    for name, of in ("median", median), ("least", min):
        ours, theirs = of(own), of(peer)
        print(f"{name}: kinegrad {ours:.3f} s, PyTorch {theirs:.3f} s, ratio {theirs / ours:.1f}")
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
    command = [program, "--rounds", "1", example]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(result.stdout.rsplit("synthesis", 1)[1].split()[0])


if __name__ == "__main__":
    sys.exit(main())
