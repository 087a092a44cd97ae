"""Faults in the text that a process prints, and in the tables that it writes."""

import csv
import os
import re
from collections.abc import Iterator
from pathlib import Path

from process import Ended

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that move the cursor, change a terminal or reverse text: all but newline and tab."""
LONGEST_LINE = 5000
"""Characters of a line of a message; messages have 4,000 and a hint."""
LONGEST_MESSAGE = 12_000
"""Characters from the error to the end."""
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""Beginnings of a cell that a spreadsheet calculates."""
LARGEST_TABLE = 16 << 20
MARKUP = re.compile(rb"<img src=x")
"""In a page or picture: a name that is not escaped."""
RAW = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
"""What neither XML nor JSON may contain."""
TEXTS = (b".html", b".svg", b".json", b".jsonl", b".toml", b".bvh", b".csv", b".txt")
PAGES = (b".html", b".svg")

Words = tuple[str, str]
"""Kind of a fault, and what was found."""


def text_faults(ended: Ended) -> Iterator[Words]:
    """Faults of standard output and standard error, neither of which is a terminal."""
    for name, text, is_text in [
        ("stdout", ended.stdout, ended.is_text[0]), ("stderr", ended.stderr, ended.is_text[1])
    ]:
        if not is_text:
            yield "not text", f"{name} is not UTF-8"
        if found := CONTROL.search(text):
            around = text[max(found.start() - 40, 0):found.end() + 40]
            yield "control characters", f"{name} contains {around!r}"
    longest = max(map(len, ended.stderr.split("\n")))
    if longest > LONGEST_LINE:
        yield "long message", f"a line of {longest} characters on stderr"
    error = ended.stderr.rfind("error: ")
    if error >= 0 and len(ended.stderr) - error > LONGEST_MESSAGE:
        yield "long message", f"an error of {len(ended.stderr) - error} characters"


def table_faults(folder: Path, since: int) -> Iterator[Words]:
    """Faults of the CSV files in a folder that were written after a time in nanoseconds."""
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            if not name.endswith(".csv") or path.is_symlink():
                continue
            status = path.stat()
            if status.st_mtime_ns < since or status.st_size > LARGEST_TABLE:
                continue
            if cell := formula(path.read_text(errors="replace")):
                yield "formula", f"a cell of {name} is {cell[:80]!r}"


def formula(table: str) -> str | None:
    """The first cell of a CSV text that a spreadsheet would calculate."""
    for row in csv.reader(table.splitlines(keepends=True)):
        for cell in row:
            if cell.startswith(FORMULA) and not is_number(cell):
                return cell
    return None


def is_number(cell: str) -> bool:
    """True for the text of a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def text_files(top: bytes) -> list[bytes]:
    """Text files below a folder."""
    return [
        os.path.join(place, name)
        for place, _, names in os.walk(top) for name in names if name.endswith(TEXTS)
    ]


def raw_text(path: bytes) -> bytes | None:
    """What is around a control character in a file, or around a tag that is a name."""
    with open(path, "rb") as file:
        content = file.read()
    found = RAW.search(content)
    if not found and path.endswith(PAGES):
        found = MARKUP.search(content)
    return content[max(found.start() - 60, 0):found.end() + 40] if found else None
