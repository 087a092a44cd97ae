"""WAV files as recorders write them, with what they say."""

import math
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

LOUD, QUIET = 0.4, 0.1
"""Amplitudes of the tone in the first and in the second half, in every channel."""
TONE = 440
Chunk = tuple[bytes, bytes]
"""Name and content."""


@dataclass
class Written:
    """A file, and what it says."""

    rate: int
    channels: int
    frames: int
    form: str
    """How a sample is stored."""
    fmt: bytes = b""
    data: bytes = b""
    before: list[Chunk] = field(default_factory=list)
    after: list[Chunk] = field(default_factory=list)
    riff: bytes = b"RIFF"
    riff_size: int | None = None
    """None for the right one."""
    data_size: int | None = None
    pads: bool = True
    """True if odd chunks are padded."""
    must_read: bool = True

    def content(self) -> bytes:
        """The file."""
        if self.data_size is not None:
            # Nothing after the samples could be found.
            self.after = []
        size = len(self.data) if self.data_size is None else self.data_size
        parts = [self.chunk(*chunk) for chunk in [*self.before[:1], (b"fmt ", self.fmt), *self.before[1:]]]
        parts += [b"data" + struct.pack("<I", size) + self.data]
        parts += [bytes(len(self.data) % 2 if self.pads and self.data_size is None else 0)]
        parts += [self.chunk(*chunk) for chunk in self.after]
        body = b"WAVE" + b"".join(parts)
        right = len(body) if self.riff_size is None else self.riff_size
        return self.riff + struct.pack("<I", right & 0xFFFFFFFF) + body

    def chunk(self, name: bytes, content: bytes) -> bytes:
        """A chunk, padded if this writer pads."""
        pad = bytes(len(content) % 2 if self.pads else 0)
        return name + struct.pack("<I", len(content)) + content + pad


Deviation = Callable[[random.Random, Written], None]


def sample(form: str, value: float) -> bytes:
    """A sample between -1 and 1."""
    match form:
        case "u8":
            return bytes([round(128 + 127 * value)])
        case "s16":
            return struct.pack("<h", round(32767 * value))
        case "s24":
            return round(8388607 * value).to_bytes(3, "little", signed=True)
        case "s24 in 32":
            return struct.pack("<i", round(8388607 * value) << 8)
        case "s32":
            return struct.pack("<i", round(2147483647 * value))
        case "f32":
            return struct.pack("<f", value)
        case _:
            return struct.pack("<d", value)


BITS = {"u8": 8, "s16": 16, "s24": 24, "s24 in 32": 24, "s32": 32, "f32": 32, "f64": 64}


def plain(r: random.Random) -> Written:
    """A file without deviations."""
    rate, channels = r.choice([8000, 11025, 22050, 44100]), r.choice([1, 1, 2, 2, 3, 6])
    written = Written(rate, channels, int(rate * r.uniform(0.6, 1.1)), r.choice(list(BITS)))
    loud = [LOUD if 2 * n < written.frames else QUIET for n in range(written.frames)]
    tone = [size * math.sin(2 * math.pi * TONE * n / rate) for n, size in enumerate(loud)]
    written.data = b"".join(sample(written.form, value) * channels for value in tone)
    tag = 3 if written.form.startswith("f") else 1
    block, bits = len(sample(written.form, 0.0)) * channels, BITS[written.form]
    written.fmt = struct.pack("<HHIIHH", tag, channels, rate, rate * block, block, bits)
    if written.form == "s24 in 32" or r.random() < 0.3:
        extensible(r, written)
    return written


def extensible(r: random.Random, written: Written) -> None:
    """The longer format with a mask of channels, known or not."""
    if len(written.fmt) > 16:
        return
    tag = written.fmt[:2]
    mask = r.choice([0, 3, 4, 63, 0xFFFFFFFF, 0x80000000, 1, 0x40000])
    bits = BITS[written.form]
    container = 32 if written.form == "s24 in 32" else bits
    more = struct.pack("<HHI", 22, bits, mask) + tag + bytes.fromhex("000000001000800000aa00389b71")
    written.fmt = b"\xfe\xff" + written.fmt[2:14] + struct.pack("<H", container) + more


def longer(more: bytes) -> Deviation:
    """A longer `fmt `."""

    def edit(_: random.Random, written: Written) -> None:
        if len(written.fmt) == 16:
            written.fmt += more

    return edit


def sized(riff: int | None = None, data: int | None = None) -> Deviation:
    """Sizes that are not those of the file."""

    def edit(_: random.Random, written: Written) -> None:
        written.riff_size = written.riff_size if riff is None else riff
        written.data_size = written.data_size if data is None else data

    return edit


def chunks(before: list[Chunk] = (), after: list[Chunk] = ()) -> Deviation:
    """More chunks."""

    def edit(_: random.Random, written: Written) -> None:
        written.before += before
        written.after += after

    return edit


def unpadded(r: random.Random, written: Written) -> None:
    """Odd chunks without a pad byte, which not every reader finds."""
    written.pads = written.must_read = False
    odd = r.choice([ODD_LIST, (b"bext", bytes(603)), (b"fact", bytes(5)), (b"iXML", b"<a/> ")])
    written.before.append(odd)


def rf64(_: random.Random, written: Written) -> None:
    """64-bit sizes."""
    written.riff, written.riff_size, written.data_size = b"RF64", 0xFFFFFFFF, 0xFFFFFFFF
    sizes = struct.pack("<QQQI", len(written.data) + 100, len(written.data), written.frames, 0)
    written.before.insert(0, (b"ds64", sizes))


def rates(r: random.Random, written: Written) -> None:
    """A wrong number of bytes per second."""
    wrong = r.choice([0, 1, 0xFFFFFFFF, 2 * written.rate])
    written.fmt = written.fmt[:8] + struct.pack("<I", wrong) + written.fmt[12:]


def cut_off(r: random.Random, written: Written) -> None:
    """The file ends before its samples do."""
    block = len(written.data) // written.frames
    stated = len(written.data)
    written.frames -= written.frames // 8
    written.data = written.data[:block * written.frames + r.randrange(block)]
    written.data_size = stated


LIST: Chunk = (b"LIST", b"INFOISFT\x0e\0\0\0Lavf60.16.100\0")
LONG_LIST: Chunk = (b"LIST", b"INFO" + bytes(20_000))
ODD_LIST: Chunk = (b"LIST", b"INFOISFT\x05\0\0\0abcd\0")
DEVIATIONS: dict[str, Deviation] = {
    "RIFF size 0": sized(0), "RIFF size of no end": sized(0xFFFFFFFF), "RIFF size 8 short": sized(36),
    "RIFF size large": sized(0x7FFFFFFF), "RIFF size 1": sized(1),
    "sizes never written": sized(0, 0), "sizes of a pipe": sized(0xFFFFFFFF, 0xFFFFFFFF),
    "sizes of sox": sized(0x7FFFFFFF + 37, 0x7FFFFFFF - 36 + 37), "data of a pipe": sized(None, 0xFFFFFFFF),
    "data 0x7fffffff": sized(0, 0x7FFFFFFF),
    "fmt 18": longer(b"\0\0"), "fmt 20": longer(b"\2\0\0\0"), "fmt 40": longer(bytes(24)),
    "fmt 28": longer(b"\0\0" + b"\xff" * 10), "extensible": extensible,
    "LIST before": chunks([LIST]), "LIST behind": chunks(after=[LIST]),
    "long LIST before": chunks([LONG_LIST]), "long LIST behind": chunks(after=[LONG_LIST]),
    "JUNK": chunks([(b"JUNK", bytes(28))]), "fact": chunks([(b"fact", bytes(4)), (b"PEAK", bytes(16))]),
    "tag behind": chunks(after=[(b"id3 ", b"ID3\3\0\0\0\0\1\0" + bytes(5000))]),
    "odd chunk": chunks([ODD_LIST], [ODD_LIST]), "odd chunk without pad": unpadded, "RF64": rf64,
    "bytes per second": rates, "empty chunk": chunks([(b"junk", b"")]),
    "unknown chunk": chunks([(b"abcd", bytes(10))], [(b"\0\0\0\0", bytes(3000))]), "cut off": cut_off,
}


def written_by(r: random.Random) -> tuple[str, Written]:
    """A file with some deviations, and their names."""
    written = plain(r)
    names = r.sample(list(DEVIATIONS), r.choice([0, 1, 1, 1, 2, 3]))
    # Two of these contradict one another.
    for group in (("RF64", "RIFF", "size", "data", "cut"), ("fmt", "extensible")):
        of_group = [name for name in names if any(word in name for word in group)]
        names = [name for name in names if name not in of_group[1:]]
    for name in names:
        DEVIATIONS[name](r, written)
    return ", ".join([*names, written.form, f"{written.channels} channels"]), written
