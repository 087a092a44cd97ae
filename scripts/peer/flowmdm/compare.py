#!/usr/bin/env python3
"""Times a guided prediction of a long composed motion in kinegrad and PyTorch, in turn on the same
cores, and compares memory beyond the weights.

    scripts/peer/flowmdm/compare.py [--rounds N] [--frames T] COMPOSE_SPEED

COMPOSE_SPEED is the program of `cargo build --release -p kinegrad-bpe-transformer --example compose_speed`. Needs
torch.
"""

import argparse
import os
import resource
import subprocess
import sys
import time

SEGMENT = 100


def peer(frames: int, steps: int) -> None:
    """Prints the program's output."""
    import torch
    from network import Network

    network = Network().eval()
    texts = torch.randn(-(-frames // SEGMENT), 512)
    segments = torch.arange(frames) // SEGMENT
    x = torch.randn(1, frames, 263)
    before = resident()
    seconds = []
    with torch.no_grad():
        for number in range(steps + 1):
            begin = time.perf_counter()
            t, relative = (990.0, False) if number % 2 == 1 else (500.0, True)
            cond = network(x, t, texts, segments, relative)
            uncond = network(x, t, torch.zeros_like(texts), segments, relative)
            assert (uncond + 2.5 * (cond - uncond)).sum().isfinite()
            seconds.append(time.perf_counter() - begin)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{sorted(seconds[1:])[steps // 2]:.4f} {peak - before:.1f}")


def resident() -> float:
    """MiB of this process."""
    with open("/proc/self/status", encoding="ascii") as file:
        line = next(line for line in file if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def main() -> int:
    """Both in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("program", metavar="COMPOSE_SPEED")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=10)
    arguments = parser.parse_args()
    if arguments.program == "peer":
        peer(arguments.frames, arguments.steps)
        return 0
    sizes = ["--frames", str(arguments.frames), "--steps", str(arguments.steps)]
    own, other = [], []
    for _ in range(arguments.rounds):
        command = [arguments.program, str(arguments.frames), str(arguments.steps)]
        seconds, _ = measured(command)
        _, mebibytes = measured(command, RETURN_FREED="1", MALLOC_MMAP_THRESHOLD_="65536")
        own.append((seconds, mebibytes))
        other.append(measured([sys.executable, __file__, "peer", *sizes]))
    for name, index, unit in (("time", 0, "s"), ("memory", 1, "MiB")):
        ratios = sorted(a[index] / b[index] for a, b in zip(own, other))
        median = lambda all: sorted(pair[index] for pair in all)[len(all) // 2]
        print(
            f"{name}: kinegrad {median(own):.3f} {unit}, PyTorch {median(other):.3f} {unit}, ratio "
            f"{ratios[len(ratios) // 2]:.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"
        )
    return 0


def measured(command: list[str], **variables: str) -> tuple[float, float]:
    """Seconds and MiB of a program."""
    environment = os.environ | variables
    ran = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    said = ran.stdout.split()
    return float(said[0]), float(said[1])


if __name__ == "__main__":
    raise SystemExit(main())
