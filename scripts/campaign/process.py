"""One child process: started in its own group, watched, limited, and always ended."""

import codecs
import contextlib
import os
import resource
import select
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

TICK = 0.25
"""Seconds between two looks at a process that runs."""
STARVED = 10.0
"""A process that gets no turn on a busy machine has this many times its time."""
WORKING = "still working"
READS = 16
"""Of a pipe at a time."""
MOST_OUTPUT = 1 << 20
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")

alive: set[int] = set()
"""Groups of all running processes, for the end of the campaign."""
_alive_lock = threading.Lock()


@dataclass(frozen=True)
class Limits:
    """Limits of a process."""

    cpu: float = 20.0
    """Seconds of work after which it hangs."""
    wall: float = 20.0
    """Seconds that it may sleep, all threads together, after which it hangs."""
    much: bool = False
    """True if the request is so large that running until the limit is no fault."""
    memory: int | None = None
    """Bytes of address space."""
    file_size: int | None = None
    """Bytes of the largest file it may write."""
    file_size_signal: bool = False
    """True if a write beyond that kills it; otherwise the write fails."""

    def command(self) -> list[str]:
        """The launcher of a program under these limits, which apply from its first instruction."""
        given = {"as": self.memory, "fsize": self.file_size, "core": 0}
        options = [f"--{name}={size}" for name, size in given.items() if size is not None]
        return ["prlimit", *options, "--"]


@dataclass
class Ended:
    """The end of a process."""

    arguments: list[str]
    code: int
    """Exit code, negative for a signal."""
    stdout: str
    stderr: str
    seconds: float
    cpu: float
    peak: int
    """Peak resident set, bytes."""
    hang: str | None
    """Why it was ended for hanging."""
    killed: bool
    """True if the campaign sent it a signal."""
    is_text: tuple[bool, bool] = (True, True)
    """True if stdout and stderr are UTF-8."""
    limits: Limits = field(default_factory=Limits)
    peak_address_space: int = 0


class Process:
    """A process that runs. `wait` must be called."""

    def __init__(
        self,
        binary: Path,
        arguments: list[str],
        folder: Path,
        environment: dict[str, str],
        limits: Limits,
    ) -> None:
        self.arguments, self.limits = arguments, limits
        self.killed, self.hang = False, None
        self.output = {}
        self.peak_address_space = 0
        self._status = None
        self._cpu = 0.0
        self.started = time.monotonic()
        # Python ignores SIGXFSZ; so does the child if signals are not restored.
        child = subprocess.Popen(
            [*limits.command(), str(binary), *arguments],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            restore_signals=limits.file_size_signal,
        )
        self.pid = child.pid
        self._child = child
        with _alive_lock:
            alive.add(self.pid)
        for pipe in (child.stdout, child.stderr):
            os.set_blocking(pipe.fileno(), False)
            self.output[pipe.fileno()] = bytearray()

    def send(self, number: int) -> None:
        """Sends a signal to the process alone."""
        if not self.ended():
            self.killed = True
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def end(self) -> None:
        """Ends the process group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def ended(self) -> bool:
        """True if it has ended."""
        if self._status is None:
            # Looks first: until it is waited for, its number is no other group's.
            if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                self.end()
                self._finish(*os.wait4(self.pid, 0)[1:])
        return self._status is not None

    def wait(
        self,
        watch_memory: bool = False,
        enough: Callable[[float], bool] | None = None,
        tick: float = TICK,
    ) -> Ended:
        """Waits until it ends or hangs, or until `enough`, called every `tick` with its seconds of
        work, returns True."""
        poll = select.poll()
        handle = os.pidfd_open(self.pid) if self._status is None else None
        if handle is not None:
            poll.register(handle, select.POLLIN)
        open_pipes = set(self.output)
        for number in open_pipes:
            poll.register(number, select.POLLIN)
        looked, asleep, last_cpu = time.monotonic(), 0.0, -1.0
        tick = 0.004 if watch_memory else tick
        while not self.ended():
            for number, events in poll.poll(1000 * tick):
                if number in open_pipes and not self._drain(number) and events & select.POLLHUP:
                    poll.unregister(number)
                    open_pipes.discard(number)
            if watch_memory:
                self._look_at_memory()
            now, (states, cpu) = time.monotonic(), self._states_and_cpu()
            # Only what this loop has seen counts: on a machine that stands still, so does it. A
            # thread that waits for a turn or for the disk is not asleep.
            if cpu == last_cpu and not states & {"R", "D"}:
                asleep += min(now - looked, 2 * tick)
            looked, last_cpu = now, cpu
            if self.hang is None and (why := self._hangs(now, cpu, asleep)):
                self.hang = why
                self.end()
            if enough and not self.killed and enough(cpu) and not self.ended():
                self.killed = True
                self.end()
        if handle is not None:
            os.close(handle)
        for number in self.output:
            self._drain(number)
        out, err = (bytes(text).decode(errors="replace") for text in self.output.values())
        self._child.stdout.close()
        self._child.stderr.close()
        status, usage = self._status
        return Ended(
            arguments=self.arguments,
            code=os.waitstatus_to_exitcode(status),
            stdout=out,
            stderr=err,
            seconds=self.stopped - self.started,
            cpu=usage.ru_utime + usage.ru_stime,
            peak=1024 * usage.ru_maxrss,
            hang=self.hang,
            killed=self.killed,
            is_text=tuple(map(is_utf8, self.output.values())),
            limits=self.limits,
            peak_address_space=self.peak_address_space,
        )

    def _finish(self, status: int, usage: resource.struct_rusage) -> None:
        self._status = (status, usage)
        self._child.returncode = os.waitstatus_to_exitcode(status)
        self.stopped = time.monotonic()
        with _alive_lock:
            alive.discard(self.pid)

    def _hangs(self, now: float, cpu: float, asleep: float) -> str | None:
        seconds = now - self.started
        if cpu > self.limits.cpu:
            return f"{WORKING} after {cpu:.0f} s of work"
        if asleep > self.limits.wall:
            return f"asleep for {asleep:.0f} of {seconds:.0f} s"
        if seconds > STARVED * self.limits.wall:
            return f"not ended after {seconds:.0f} s"
        return None

    def _states_and_cpu(self) -> tuple[set[str], float]:
        """The states of its threads, and the seconds that all of them worked."""
        process = Path(f"/proc/{self.pid}")
        try:
            fields = [
                (thread / "stat").read_text().rpartition(")")[2].split()
                for thread in (process / "task").iterdir()
            ]
            own = (process / "stat").read_text().rpartition(")")[2].split()
            cpu = (int(own[11]) + int(own[12])) / CLOCK_TICKS
            self._cpu = cpu
            return {thread[0] for thread in fields}, cpu
        except (OSError, IndexError):
            # It, or one of its threads, is about to end.
            return {"R"}, self._cpu

    def _look_at_memory(self) -> None:
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self.pid}/status").read_text().splitlines():
                if line.startswith("VmPeak:"):
                    self.peak_address_space = 1024 * int(line.split()[1])

    def _drain(self, number: int) -> bool:
        """Reads a pipe; returns True if it had data."""
        some = False
        try:
            # A program that writes without an end must not keep its watcher.
            for _ in range(READS):
                part = os.read(number, 65536)
                if not part:
                    break
                some = True
                room = MOST_OUTPUT - len(self.output[number])
                self.output[number] += part[:max(room, 0)]
        except (BlockingIOError, OSError):
            pass
        return some


def is_utf8(text: bytes) -> bool:
    """True for UTF-8, whose last character may be cut off."""
    try:
        codecs.getincrementaldecoder("utf-8")().decode(text)
    except UnicodeDecodeError:
        return False
    return True


def end_all() -> None:
    """Ends every process that still runs."""
    with _alive_lock:
        for group in list(alive):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(group, signal.SIGKILL)
