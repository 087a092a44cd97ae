#!/usr/bin/env python3
"""Coverage and diversity of the published algorithm in PyTorch, over many seeds.

    scripts/peer/genmm/figures.py [--seeds N] [--joints Hips,Spine] EXAMPLE.bvh

prints mean and standard deviation for K 5 and E 3, K 4 and E 5, and alpha 10. Measures are those of
docs/sources/genmm.md, on the rotations of the named joints, by default of all. `--first-place`
keeps the position of frame 1 in frame 0, as the published program does. Needs torch.
"""

import argparse
import sys

import numpy as np
import torch
from matching import first_length, synthesized

SETTINGS = {
    "K 5, E 3": {},
    "K 4, E 5": {"patches_coarse": 4, "steps": 5},
    "alpha 10": {"alpha": 10.0},
}
# Frames of a window of coverage and of local diversity, and the distance below which one is covered.
COVERED, LOCAL, THRESHOLD = 30, 15, 2.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("example", metavar="EXAMPLE.bvh")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--joints", default="")
    parser.add_argument("--first-place", action="store_true")
    arguments = parser.parse_args()
    motion, names = read(arguments.example, arguments.first_place)
    wanted = [name for name in arguments.joints.split(",") if name] or names
    columns = [6 * names.index(name) + k for name in wanted for k in range(6)]
    example = torch.tensor(motion, dtype=torch.float32)
    print(f"{len(motion)} frames, {motion.shape[1]} channels, {len(wanted)} joints, {arguments.seeds} seeds")
    for name, setting in SETTINGS.items():
        rows = []
        for seed in range(arguments.seeds):
            frames = 2 * len(example)
            first = first_length(len(example), frames, setting.get("patches_coarse", 5))
            generator = torch.Generator().manual_seed(seed)
            noise = torch.randn(first, motion.shape[1], generator=generator)
            new = synthesized(example, frames, noise, **setting).numpy()
            rows.append(measures(new[:, columns], motion[:, columns]))
        columns_of = zip(*rows)
        cells = [f"{np.mean(column):.3f} ({np.std(column, ddof=1):.3f})" for column in columns_of]
        print(f"{name}: coverage {cells[0]}, window cost {cells[1]}, local {cells[2]}, global {cells[3]}", flush=True)
    return 0


def read(path: str, first_place: bool) -> tuple[np.ndarray, list[str]]:
    """The motion as a matrix [frames, 6 joints + 3], and the joints' names without prefixes."""
    with open(path, encoding="utf-8", errors="replace") as file:
        words = file.read().split()
    names, channels, largest = [], [], 0.0
    for place, word in enumerate(words[: words.index("MOTION")]):
        if word in ("ROOT", "JOINT"):
            names.append(words[place + 1].rsplit(":", 1)[-1])
        elif word == "OFFSET":
            largest = max(largest, *(abs(float(value)) for value in words[place + 1 : place + 4]))
        elif word == "CHANNELS":
            count = int(words[place + 1])
            channels.append(words[place + 2 : place + 2 + count])
    place = words.index("MOTION")
    frames, seconds = int(words[place + 2]), float(words[place + 5])
    values = np.array(words[place + 6 :], dtype=np.float64).reshape(frames, -1)
    while seconds < 0.017:
        values, seconds = values[::2], 2 * seconds
    root, columns, at = np.zeros((len(values), 3)), [], 0
    for joint, own in enumerate(channels):
        turn = np.broadcast_to(np.eye(3), (len(values), 3, 3))
        for channel in own:
            axis, numbers = "XYZ".index(channel[0]), values[:, at]
            at += 1
            if channel.endswith("rotation"):
                turn = turn @ about(axis, np.radians(numbers))
            elif joint == 0:
                root[:, axis] = numbers
        columns.append(turn[:, :2].reshape(len(values), 6))
    root /= np.ceil(largest)
    way = np.diff(root, axis=0, prepend=root[:1])
    way[:, 1] = root[:, 1]
    if first_place:
        way[0, [0, 2]] = root[1, [0, 2]]
    else:
        way[0, [0, 2]] = root[1, [0, 2]] - root[0, [0, 2]]
    return np.concatenate([*columns, way], axis=1), names


def about(axis: int, angles: np.ndarray) -> np.ndarray:
    """Turns about an axis, [angles, 3, 3]."""
    turns = np.zeros((len(angles), 3, 3))
    one, two = (axis + 1) % 3, (axis + 2) % 3
    turns[:, axis, axis] = 1
    turns[:, one, one] = turns[:, two, two] = np.cos(angles)
    turns[:, two, one] = np.sin(angles)
    turns[:, one, two] = -turns[:, two, one]
    return turns


def measures(new: np.ndarray, example: np.ndarray) -> tuple[float, float, float, float]:
    """Coverage, its mean cost, local and global diversity."""
    apart = np.sqrt(np.maximum(((new[:, None] - example[None]) ** 2).sum(2), 0))
    covered = windows(apart, COVERED).min(0)[:-1]
    local = windows(apart, LOCAL).min(1)[:-1]
    return (covered < THRESHOLD).mean(), covered.mean(), local.mean(), segmented(apart)


def windows(apart: np.ndarray, size: int) -> np.ndarray:
    """Mean distances of windows, [windows of the new motion, windows of the example]."""
    rows, columns = (count + 1 - size for count in apart.shape)
    total = sum(apart[k : k + rows, k : k + columns] for k in range(size))
    return total / size


def segmented(apart: np.ndarray) -> float:
    """The least cost per frame of segments that each follow a stretch of the example."""
    frames = len(apart)
    # sums[k][e]: the cheapest stretch of k frames that ends before frame e.
    sums = {}
    for size in range(COVERED, 2 * COVERED):
        sums[size] = size * windows(apart, size).min(1)
    total = np.full(frames + 1, np.inf)
    total[0] = 0
    for end in range(COVERED, frames + 1):
        for size, costs in sums.items():
            if size <= end:
                total[end] = min(total[end], total[end - size] + costs[end - size])
    return total[frames] / frames


if __name__ == "__main__":
    sys.exit(main())
