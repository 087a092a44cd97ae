"""BVH hierarchies and frames as exporters write them, with what they say."""

import math
import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field

FRAME_TIME = 0.0333333
UNDEFINED = ["nan", "NaN", "-nan", "-nan(ind)", "nan(snan)", "-1.#IND", "1.#QNAN", "1.#INF", "inf", "1.#J"]


@dataclass
class Written:
    """A file, and the ways in which it may be read."""

    rows: list[list[str]]
    """The numbers of each frame: three of the root's place, then angles."""
    hierarchy: str
    head: str
    """From `MOTION` to the first frame."""
    places: list[tuple[float, float, float]] = field(default_factory=list)
    """The root's place in each frame."""
    counts: set[int] = field(default_factory=set)
    """Numbers of frames that a reader may find."""
    must_read: bool = True
    """False if it may be refused."""
    may_read: bool = True
    """False if it must be refused."""
    frame_time: float = FRAME_TIME
    text: str = ""
    content: bytes = b""


Deviation = Callable[[random.Random, Written], None]


def plain(r: random.Random) -> Written:
    """A file without deviations: a root that walks, and a joint above it."""
    frames = r.randint(4, 12)
    places = [(100 * math.cos(t / 9), 90 + t / 7, 100 * math.sin(t / 9)) for t in range(frames)]
    rows = [[f"{value:.5f}" for value in (*place, 0, 0, -4.0 * t, 0, 3.0 * t, 0)]
            for t, place in enumerate(places)]
    hierarchy = (
        "HIERARCHY\nROOT Hips\n{\n\tOFFSET 0.0 90.0 0.0\n\tCHANNELS 6 Xposition Yposition Zposition "
        "Zrotation Xrotation Yrotation\n\tJOINT Spine\n\t{\n\t\tOFFSET 0.0 10.0 0.0\n\t\tCHANNELS 3 "
        "Zrotation Xrotation Yrotation\n\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 10.0 0.0\n\t\t}\n\t}\n}\n"
    )
    head = f"MOTION\nFrames: {frames}\nFrame Time: {FRAME_TIME}\n"
    return Written(rows, hierarchy, head, places, {frames})


def replaced(name: str, old: str, new: str) -> Deviation:
    """Another spelling in the hierarchy or the head."""

    def edit(_: random.Random, written: Written) -> None:
        setattr(written, name, getattr(written, name).replace(old, new))

    return edit


def declared(more: int) -> Deviation:
    """`Frames:` differs from the number of lines."""

    def edit(_: random.Random, written: Written) -> None:
        count = len(written.rows)
        written.head = written.head.replace(f"Frames: {count}", f"Frames: {count + more}")
        written.counts.add(count + more)
        written.must_read &= more == -1

    return edit


def undefined(r: random.Random, written: Written) -> None:
    """An undefined number of some run-time library."""
    r.choice(written.rows)[r.randrange(9)] = r.choice(UNDEFINED)
    written.must_read = written.may_read = False


def spelled(r: random.Random, written: Written) -> None:
    """Numbers with a sign, an exponent, without a zero, with many digits."""
    row = r.choice(written.rows)
    row[3] = r.choice(["+0.0", "-0", "0e0", ".0", "0.", "1e-300", "-1.5E-05", "0" * 60 + ".0"])


def commas(_: random.Random, written: Written) -> None:
    """Decimals with a comma."""
    written.rows = [[number.replace(".", ",") for number in row] for row in written.rows]
    written.must_read = written.may_read = False


def wrapped(r: random.Random, written: Written) -> None:
    """A frame on two lines, or two frames on one."""
    at = r.randrange(len(written.rows) - 1)
    if r.random() < 0.5:
        written.rows[at:at + 2] = [written.rows[at] + written.rows[at + 1]]
    else:
        written.rows[at:at + 1] = [written.rows[at][:4], written.rows[at][4:]]
    written.must_read = False


def columns(r: random.Random, written: Written) -> None:
    """A number too many or too few in every frame."""
    more = r.random() < 0.5
    written.rows = [[*row, "0.0"] if more else row[:-1] for row in written.rows]
    written.must_read = written.may_read = False


def milliseconds(_: random.Random, written: Written) -> None:
    """The frame time in milliseconds."""
    written.head = written.head.replace(f"{FRAME_TIME}", f"{1000 * FRAME_TIME}")


def no_frames(_: random.Random, written: Written) -> None:
    """A file without frames."""
    written.head = re.sub(r"Frames: \d+", "Frames: 0", written.head)
    written.rows = []
    written.must_read = written.may_read = False


def optional(deviation: Deviation) -> Deviation:
    """A deviation that may be refused."""

    def edit(r: random.Random, written: Written) -> None:
        deviation(r, written)
        written.must_read = False

    return edit


END = "\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.0 10.0 0.0\n\t\t}\n"
FRAMES: dict[str, Deviation] = {
    "one line more": declared(-1), "two lines more": declared(-2), "lines missing": declared(3),
    "undefined number": undefined, "spelled": spelled, "commas": commas, "wrapped": wrapped,
    "columns": columns, "no frames": no_frames,
}
"""Of the frames: one at most."""
HEADS: dict[str, Deviation] = {
    "milliseconds": milliseconds,
    "frame time, no space": replaced("head", "Frame Time: ", "Frame Time:"),
    "frame time, tab": replaced("head", "Frame Time: ", "Frame Time:\t"),
    "frame time, case": replaced("head", "Frame Time", "FRAME TIME"),
    "frame time, space": replaced("head", "Frame Time:", "Frame  Time :"),
    "frames, no space": replaced("head", "Frames: ", "Frames:"),
    "frames, case": replaced("head", "Frames", "FRAMES"),
    "blank lines": replaced("head", "\n", "\n\n"),
    "end site, case": replaced("hierarchy", "End Site", "END SITE"),
    "end site, lower case": replaced("hierarchy", "End Site", "End site"),
    "end site, brace": replaced("hierarchy", "End Site\n\t\t{", "End Site {"),
    "end site, name": replaced("hierarchy", "End Site", "End Site Head_end"),
    "end site, one word": optional(replaced("hierarchy", "End Site", "EndSite")),
    "end site, no offset": optional(replaced("hierarchy", "\t\t\tOFFSET 0.0 10.0 0.0\n\t\t}", "\t\t}")),
    "end site, none": replaced("hierarchy", END, ""), "end sites": replaced("hierarchy", END, 2 * END),
    "braces on the line": replaced("hierarchy", "\n\t{", " {"),
    "channels, case": replaced("hierarchy", "rotation", "ROTATION"),
    "channels before offset": replaced(
        "hierarchy", "OFFSET 0.0 10.0 0.0\n\t\tCHANNELS 3 Zrotation Xrotation Yrotation\n",
        "CHANNELS 3 Zrotation Xrotation Yrotation\n\t\tOFFSET 0.0 10.0 0.0\n"),
    "name with a prefix": replaced("hierarchy", "Spine", "mixamorig:Spine"),
    "name with spaces": replaced("hierarchy", "Spine", "Bip01 Spine 1"),
    "name with letters": replaced("hierarchy", "Spine", "R\u00fccken\u0142"),
    "comment": optional(replaced("hierarchy", "HIERARCHY\n", "# exported\nHIERARCHY\n")),
    "spaces": replaced("hierarchy", " ", "  "), "tabs": replaced("hierarchy", "\t", "        "),
}
"""Of the hierarchy and of the lines before the frames."""
