"""A limit on concurrent processes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Turns:
    """Slots of concurrent processes."""

    def __init__(self, count: int) -> None:
        self.count, self.free = count, count
        self.changed = threading.Condition()

    @contextmanager
    def taken(self, wanted: int = 1) -> Iterator[None]:
        """Acquires a number of slots, at most all."""
        wanted = min(wanted, self.count)
        with self.changed:
            self.changed.wait_for(lambda: self.free >= wanted)
            self.free -= wanted
        try:
            yield
        finally:
            with self.changed:
                self.free += wanted
                self.changed.notify_all()
