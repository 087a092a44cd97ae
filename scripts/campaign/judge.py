"""Faults in the end of a process, for any input."""

import re
import signal
from dataclasses import dataclass

from process import WORKING, Ended
from texts import text_faults

SUCCESS, FAILED, INVALID, INTERRUPTED = 0, 1, 2, 130
DOCUMENTED = (SUCCESS, FAILED, INVALID, INTERRUPTED)
PANIC = re.compile(r"panicked at ([^\n]*?):?\n?(?:\n|$)")
ALLOCATION = re.compile(r"memory allocation of|capacity overflow")
LOCATION = re.compile(r"panicked at (\S+?\.rs:\d+)")


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong."""

    kind: str
    """panic, abort, crash, hang, memory, exit code, no sentence, wrong bytes, lost run, ..."""
    signature: str
    """Key that is equal for probably equal faults."""
    found: str
    expected: str


def judged(
    ended: Ended, label: str, allowed: tuple[int, ...], most_memory: int
) -> list[Fault]:
    """The faults of a process that may exit with the `allowed` codes; `label` describes its
    input."""
    faults = []
    name = f"{ended.arguments[0]}, {label}"
    lines = [line for line in ended.stderr.splitlines() if ALLOCATION.search(line)]
    if lines:
        faults.append(Fault("allocation", name, lines[0], "memory within bounds"))
    elif place := LOCATION.search(ended.stderr) or PANIC.search(ended.stderr):
        # A location in the standard library does not identify the fault.
        where = f"{place[1]}, {label}" if "/rustc/" in place[1] else place[1]
        faults.append(Fault("panic", where, f"a panic at {place[1]}", "no panic"))
    if ended.hang and ended.limits.much and ended.hang.startswith(WORKING):
        pass
    elif ended.hang:
        faults.append(Fault("hang", name, ended.hang, "an end"))
    elif not ended.killed and not faults:
        faults += faults_of_code(ended, allowed)
    if ended.peak > most_memory:
        found = f"a resident set of {ended.peak >> 20} MiB"
        faults.append(Fault("memory", name, found, f"at most {most_memory >> 20} MiB"))
    for kind, found in text_faults(ended):
        faults.append(Fault(kind, name, found, "plain text, of a bounded length"))
    return faults


def faults_of_code(ended: Ended, allowed: tuple[int, ...]) -> list[Fault]:
    """Faults of the exit code and of its message."""
    signed = " ".join(ended.arguments[:1]) + ": " + pattern(ended)
    expected = "exit code " + " or ".join(map(str, allowed))
    if ended.code < 0:
        number = signal.Signals(-ended.code).name
        kind = "abort" if ended.code == -signal.SIGABRT else "crash"
        if ended.code == -signal.SIGXFSZ and ended.limits.file_size_signal:
            return []
        return [Fault(kind, f"{number} {signed}", f"ended by {number}", expected)]
    if ended.code not in allowed:
        kind = "exit code" if ended.code in DOCUMENTED else "undocumented exit code"
        return [Fault(kind, f"{ended.code} {signed}", f"exit code {ended.code}", expected)]
    # `check` reports failures on standard output.
    silent = "error: " not in ended.stderr and (ended.code == INVALID or not ended.stdout.strip())
    if ended.code in (FAILED, INVALID) and silent:
        found = f"exit code {ended.code} without a sentence"
        return [Fault("no sentence", f"{ended.code} {signed}", found, "a reason on stderr")]
    return []


def last_line(text: str) -> str:
    """The last nonempty line."""
    lines = [line for line in text.strip().splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""


def pattern(ended: Ended) -> str:
    """The error's sentence without its names and numbers."""
    lines = [line for line in ended.stderr.splitlines() if line.startswith("error")]
    line = lines[-1] if lines else last_line(ended.stderr)
    line = re.sub(r"[`\"'][^`\"']*[`\"']", "_", line)
    line = re.sub(r"\S*/\S*", "_", line)
    return re.sub(r"-?\d[\w.+-]*", "N", line)[:160]
