"""Shares the time among the attacks: each worker takes a case of the most delayed attack."""

import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable

from attack import Attack
from case import Case, Setting, Stopped
from process import end_all

AFTER = 5.0
"""Seconds for active cases at the end."""


class Progress:
    """The progress of an attack."""

    def __init__(self, attack: Attack) -> None:
        self.attack, self.total = attack, attack.total()
        self.started, self.done, self.faults = 0, 0, 0
        self.seconds = 0.0
        self.counts: Counter[str] = Counter()
        self.peak = 0
        self.slowest: tuple[float, str] = (0.0, "")

    @property
    def waiting(self) -> bool:
        """True if there are cases left."""
        return self.total is None or self.started < self.total

    def record(self) -> dict[str, object]:
        """For the report."""
        return {
            "attack": self.attack.name,
            "cases": self.done,
            "of": self.total,
            "faults": self.faults,
            "seconds": round(self.seconds, 1),
            "counts": dict(sorted(self.counts.items())),
            "peak_mib": self.peak >> 20,
            "slowest_cpu_seconds": round(self.slowest[0], 2),
            "slowest": self.slowest[1][:300],
        }


class Schedule:
    """All attacks, for a time on a number of workers."""

    def __init__(
        self, setting: Setting, attacks: list[Attack], jobs: int, say: Callable[[str], None]
    ) -> None:
        self.setting, self.jobs, self.say = setting, jobs, say
        self.progress = [Progress(attack) for attack in attacks]
        self.lock = threading.Lock()
        self.broken: list[str] = []
        self.end = 0.0

    def run(self, seconds: float) -> None:
        """Attacks until the time is up, or until nothing is left."""
        self.end = time.monotonic() + seconds
        workers = [threading.Thread(target=self._work, daemon=True) for _ in range(self.jobs)]
        for worker in workers:
            worker.start()
        try:
            self._watch(workers)
        finally:
            self.stop(workers)

    def _watch(self, workers: list[threading.Thread]) -> None:
        told = time.monotonic()
        while any(worker.is_alive() for worker in workers):
            for worker in workers:
                worker.join(0.5)
            now = time.monotonic()
            if now - told > 20:
                told = now
                self.say(self.line())
            if now > self.end + AFTER:
                self.stop(workers)

    def stop(self, workers: list[threading.Thread]) -> None:
        """Ends active cases."""
        Case.over.set()
        end_all()
        for worker in workers:
            worker.join(AFTER)

    def _work(self) -> None:
        while not Case.over.is_set() and (taken := self._next()):
            progress, number = taken
            started = time.monotonic()
            attack = progress.attack
            case = Case(self.setting, attack.name, number, attack.on_disk)
            finished = False
            try:
                with case:
                    attack.attack(case)
                finished = True
            except Stopped:
                pass
            except Exception:
                if Case.over.is_set():
                    continue
                with self.lock:
                    self.broken.append(f"{case.attack}/{number}:\n{traceback.format_exc()}")
                self.say(f"BROKEN {case.attack}/{number}: {traceback.format_exc()}")
            self._done(progress, case, time.monotonic() - started, finished)

    def _next(self) -> tuple[Progress, int] | None:
        with self.lock:
            waiting = [progress for progress in self.progress if progress.waiting]
            if not waiting or time.monotonic() > self.end:
                return None
            behind = min(waiting, key=lambda p: p.seconds / p.attack.weight)
            behind.started += 1
            # So that another worker does not take the same before this case counts.
            behind.seconds += 0.01
            return behind, behind.started - 1

    def _done(self, progress: Progress, case: Case, seconds: float, finished: bool) -> None:
        with self.lock:
            progress.done += finished
            progress.seconds += seconds
            progress.faults += case.faults
            progress.counts += case.counts
            progress.peak = max(progress.peak, case.peak)
            progress.slowest = max(progress.slowest, case.slowest)

    def line(self) -> str:
        """The progress of the campaign."""
        parts = [
            f"{p.attack.name} {p.done}" + (f" of {p.total}" if p.total is not None else "")
            for p in self.progress
        ]
        return f"{', '.join(parts)}; {sum(p.faults for p in self.progress)} faults"
