"""Damage to bytes and to text."""

import random
import re
import struct

EXTREMES = [0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 32767, 32768, 65535, 65536]
WIDE = [2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1]
FLOATS = [0.0, -0.0, float("nan"), float("inf"), float("-inf"), 1e-40, 3e38, -3e38, 1e300]
NUMBERS = [
    "0", "-0", "1", "-1", "nan", "inf", "-inf", "NaN", "1e308", "-1e308", "1e-320", "1e400",
    "9223372036854775808", "18446744073709551616", "4294967296", "2147483648", "0.5", "1" + "0" * 400,
    "0." + "0" * 400 + "1", "0x10", "1e", "--1", "", "1,5", "1e999999999999",
]
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
TOKEN = re.compile(rb"[^\s]+")
MOST_BYTES = 1 << 20


def place_in(r: random.Random, content: bytes) -> int:
    """A position, often near the start or the end, where formats have their counts."""
    size = len(content)
    if size == 0:
        return 0
    where = r.random()
    if where < 0.45:
        return r.randrange(min(size, 600))
    if where < 0.6:
        return size - 1 - r.randrange(min(size, 300))
    return r.randrange(size)


def mutated(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Bytes with some damage; `others` are of the same format."""
    content = bytearray(content)
    for _ in range(r.choice([1, 1, 1, 2, 3, 8])):
        r.choice(BYTES)(r, content, others)
    return bytes(content[:MOST_BYTES])


def flip(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """One bit."""
    if content:
        content[place_in(r, content)] ^= 1 << r.randrange(8)


def set_byte(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """One byte at a boundary."""
    if content:
        content[place_in(r, content)] = r.choice([0, 1, 0x7F, 0x80, 0xFE, 0xFF, r.randrange(256)])


def set_field(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """A number of 2, 4 or 8 bytes in either order."""
    width = r.choice([2, 4, 4, 8])
    near = [len(content), len(content) - 1, len(content) + 1, len(content) // 4]
    value = r.choice([*EXTREMES, *WIDE, *near, -1, -2]) % (1 << 8 * width)
    place = place_in(r, content)
    if r.random() < 0.5:
        place -= place % width
    content[place:place + width] = value.to_bytes(width, r.choice(["little", "little", "big"]))


def set_float(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """A number of floating point at a boundary."""
    value, place = r.choice(FLOATS), place_in(r, content)
    if r.random() < 0.7 and abs(value) != 1e300:
        content[place - place % 4:place - place % 4 + 4] = struct.pack("<f", value)
    else:
        content[place - place % 8:place - place % 8 + 8] = struct.pack("<d", value)


def cut(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """The end is missing."""
    del content[place_in(r, content):]


def extend(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """More at the end."""
    size = r.choice([1, 3, 4, 100, 5000])
    content += r.choice([bytes(size), r.randbytes(size), bytes(content[:size]), b"\xff" * size])


def delete(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """A block is missing."""
    place = place_in(r, content)
    del content[place:place + r.choice([1, 2, 4, 8, 64, 512, 4096])]


def double(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """Repeats a block."""
    place = place_in(r, content)
    block = content[place:place + r.choice([1, 4, 16, 64, 512])]
    content[place:place] = block * r.choice([1, 1, 1, 2, 100, 2000])


def zero(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """A block of equal bytes."""
    place, size = place_in(r, content), r.choice([4, 16, 512])
    content[place:place + size] = r.choice([b"\0", b"\xff", b" "]) * size


def splice(r: random.Random, content: bytearray, others: list[bytes]) -> None:
    """Begins as one file and ends as another."""
    other = r.choice(others)
    content[place_in(r, content):] = other[place_in(r, other):]


def swap(r: random.Random, content: bytearray, _: list[bytes]) -> None:
    """Two blocks in each other's place."""
    size, one, other = r.choice([1, 4, 32]), place_in(r, content), place_in(r, content)
    a, b = content[one:one + size], content[other:other + size]
    content[one:one + size] = b
    content[other:other + size] = a


BYTES = [
    flip, flip, set_byte, set_byte, set_field, set_field, set_field, set_float, cut, extend, delete,
    double, zero, splice, swap,
]


def mutated_text(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Text with some damage, at times in its bytes."""
    if r.random() < 0.15:
        return mutated(r, content, others)
    for _ in range(r.choice([1, 1, 1, 2, 3])):
        content = r.choice(TEXTS)(r, content, others)
    return content[:MOST_BYTES]


def number(r: random.Random, content: bytes, _: list[bytes]) -> bytes:
    """A number at a boundary."""
    found = list(NUMBER.finditer(content))
    if not found:
        return content
    # Headers contain the sizes: favour the first numbers.
    one = r.choice(found[:12]) if r.random() < 0.4 else r.choice(found)
    return content[:one.start()] + r.choice(NUMBERS).encode() + content[one.end():]


def lines(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Lines removed, repeated, swapped, joined or from another file."""
    all_lines = content.split(b"\n")
    place = r.randrange(len(all_lines))
    kind = r.randrange(5)
    if kind == 0:
        del all_lines[place:place + r.choice([1, 1, 2, 10])]
    elif kind == 1:
        all_lines[place:place] = [all_lines[place]] * r.choice([1, 1, 2, 500])
    elif kind == 2:
        other = r.randrange(len(all_lines))
        all_lines[place], all_lines[other] = all_lines[other], all_lines[place]
    elif kind == 3:
        all_lines[place:place + 2] = [b" ".join(all_lines[place:place + 2])]
    else:
        all_lines.insert(place, r.choice(r.choice(others).split(b"\n")))
    return b"\n".join(all_lines)


def tokens(r: random.Random, content: bytes, _: list[bytes]) -> bytes:
    """Words swapped, removed, repeated or replaced by odd ones."""
    found = list(TOKEN.finditer(content))
    if len(found) < 2:
        return content
    one, other = sorted(r.sample(found, 2), key=lambda match: match.start())
    kind = r.randrange(4)
    if kind == 0:
        between = content[one.end():other.start()]
        return content[:one.start()] + other[0] + between + one[0] + content[other.end():]
    odd = {
        1: b"",
        2: (one[0] + b" ") * r.choice([2, 3000]),
        3: r.choice([b"{" * 5000, b"[" * 5000, b'"', b"\xff\xfe", b"\0", b"}", b"x" * 70000, b"#"]),
    }
    return content[:one.start()] + odd[kind] + content[one.end():]


def ends(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """Other ends of lines, a mark at the beginning, a cut, two files in one."""
    kind = r.randrange(5)
    return [
        lambda: content.replace(b"\n", r.choice([b"\r\n", b"\r", b"", b"\n\n"])),
        lambda: r.choice([b"\xef\xbb\xbf", b"\xff\xfe", b"\0"]) + content,
        lambda: content[:r.randrange(len(content) + 1)],
        lambda: content + r.choice(others),
        lambda: content.upper() if r.random() < 0.5 else content.lower(),
    ][kind]()


TEXTS = [number, number, number, number, lines, lines, tokens, tokens, ends]
