"""The load of the machine by other work, which makes times useless."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

TICKS_PER_SECOND = os.sysconf("SC_CLK_TCK")
TOLERABLE = 0.1
"""Limit of the share of other work during a round."""


@dataclass(frozen=True)
class Load:
    """Seconds since a fixed time."""

    wall: float
    all_processes: float
    """CPU time of all processes, including time stolen by a host."""
    ours: float
    """CPU time of the measured processes."""

    def elsewhere_since(self, earlier: "Load") -> float:
        """The share of other work since then."""
        everything = self.all_processes - earlier.all_processes
        others = everything - (self.ours - earlier.ours)
        capacity = (self.wall - earlier.wall) * (os.cpu_count() or 1)
        return max(others / capacity, 0.0)


def load_now(processes: Iterable[int]) -> Load | None:
    """The load, if the system has `/proc`."""
    try:
        first = Path("/proc/stat").read_text().splitlines()[0]
        # user, nice, system, idle, iowait, irq, softirq, steal; the rest is part of user.
        values = [int(value) for value in first.split()[1:9]]
        ours = 0
        for process in processes:
            # The name may contain spaces; utime and stime are the 12th and 13th field after it.
            fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
            ours += int(fields[11]) + int(fields[12])
    except OSError:
        return None
    busy = sum(values) - values[3] - values[4]
    return Load(monotonic(), busy / TICKS_PER_SECOND, ours / TICKS_PER_SECOND)
