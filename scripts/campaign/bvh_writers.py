"""BVH files as exporters write them, with what they say."""

import random

from bvh_frames import FRAMES, HEADS, Deviation, Written, plain


def cut(r: random.Random, written: Written) -> None:
    """The text ends within its last number or line."""
    text = written.text.rstrip()
    written.text = text[:len(text) - r.randint(1, 12)]
    written.counts |= {len(written.rows) - 1, len(written.rows)}
    # What must be refused may be gone.
    written.must_read, written.may_read = False, True


def appended(text: str) -> Deviation:
    """More text at the end."""

    def edit(_: random.Random, written: Written) -> None:
        written.text += text

    return edit


def line_ends(end: str) -> Deviation:
    """Other ends of lines."""

    def edit(_: random.Random, written: Written) -> None:
        written.text = written.text.replace("\n", end)

    return edit


ENDS: dict[str, Deviation] = {
    "as is": lambda r, written: None, "cut": cut, "CR": line_ends("\r"), "CRLF": line_ends("\r\n"),
    "spaces before ends": line_ends(" \t\n"), "0x1A": appended("\x1a"), "NUL": appended("\0"),
    "block of NUL": appended("\0" * 500), "0x1A after a line": appended("\r\n\x1a"),
    "no last end": lambda r, written: setattr(written, "text", written.text.rstrip()),
    "blank end": appended("\n \n\t\n"), "form feed": appended("\f"),
}
"""Applied to the text."""
ENCODINGS = {
    "utf-8": "", "utf-8-sig": "", "utf-16": "", "utf-16-le": "\ufeff", "utf-16-be": "\ufeff",
    "latin-1": "",
}
"""With what is put before the text."""


def written_by(r: random.Random) -> tuple[str, Written]:
    """A file with one or two deviations, and their names."""
    written = plain(r)
    names = r.sample(list(HEADS), r.choice([0, 0, 1, 1, 2]))
    names += r.sample(list(FRAMES), r.choice([0, 0, 1]))
    for name in names:
        (HEADS | FRAMES)[name](r, written)
    lines = [" ".join(row) + "\n" for row in written.rows]
    written.text = written.hierarchy + written.head + "".join(lines)
    end = r.choice(["as is", *ENDS])
    ENDS[end](r, written)
    encoding = r.choice(["utf-8", "utf-8", *ENCODINGS])
    written.content = (ENCODINGS[encoding] + written.text).encode(encoding, errors="replace")
    return ", ".join([*names, end, encoding]), written
