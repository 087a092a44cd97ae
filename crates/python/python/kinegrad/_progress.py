"""Progress bars on standard error."""

from __future__ import annotations

import sys
import time
from typing import Literal, Union

from ._settings import Progress

ProgressArgument = Union[Progress, Literal[False], None]


class Bar:
    """A bar that is redrawn in place, and removed at the end."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._started = time.monotonic()
        self._drawn = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if now - self._drawn < 0.1 and done < total:
            return
        self._drawn = now
        filled = 24 * done // max(total, 1)
        bar = "█" * filled + "░" * (24 - filled)
        text = f"{stage}  " if stage else ""
        seconds = now - self._started
        sys.stderr.write(f"\r\x1b[K{text}{bar} {done}/{total} {self._unit}  {seconds:.0f}s")
        sys.stderr.flush()

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._drawn:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


class _Reporting:
    """A callable as a context."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress

    def __enter__(self) -> Progress | None:
        return self._progress

    def __exit__(self, *_: object) -> None:
        pass


def reporting(progress: ProgressArgument, unit: str) -> Bar | _Reporting:
    """A context with the callable to report to: `progress` itself; for `None` a bar if standard
    error is a terminal; for `False` none."""
    if progress is False:
        return _Reporting(None)
    if progress is None:
        terminal = sys.stderr is not None and sys.stderr.isatty()
        return Bar(unit) if terminal else _Reporting(None)
    return _Reporting(progress)
