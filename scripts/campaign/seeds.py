"""Small valid files of the formats that the program does not write."""

import io
import math
import struct
import zipfile

BLOCK = 512


def bvh(frames: int, spine: bool = False) -> bytes:
    """A root that walks a circle, alone or with a figure above it."""
    joints = (
        " JOINT Spine\n {\n  OFFSET 0 10 0\n  CHANNELS 3 Zrotation Xrotation Yrotation\n"
        "  End Site\n  {\n   OFFSET 0 10 0\n  }\n }\n"
    )
    end = " End Site\n {\n  OFFSET 0 10 0\n }\n"
    text = (
        "HIERARCHY\nROOT Hips\n{\n OFFSET 0 90 0\n CHANNELS 6 Xposition Yposition Zposition "
        f"Zrotation Xrotation Yrotation\n{joints if spine else end}}}\nMOTION\nFrames: {frames}\n"
        "Frame Time: 0.0333333\n"
    )
    for frame in range(frames):
        turn = frame / 45
        row = [100 * math.cos(turn), 90.0, 100 * math.sin(turn), 0, 0, -math.degrees(turn)]
        row += [0, 5 * math.sin(turn), 0] if spine else []
        text += " ".join(f"{value:.4f}" for value in row) + "\n"
    return text.encode()


def c3d(kind: int, scale: float, frames: int, analog: int = 0) -> bytes:
    """Four markers of a pelvis; `kind` is the type of the processor: 84 Intel, 85 DEC, 86 MIPS."""
    labels = ["RFWT", "LFWT", "RBWT", "LBWT"]
    order = ">" if kind == 86 else "<"

    def number(value: float) -> bytes:
        if kind != 85:
            return struct.pack(order + "f", value)
        bits = struct.pack("<f", 4 * value)
        return bits[2:] + bits[:2]

    def word(value: int) -> bytes:
        return struct.pack(order + "H", value & 0xFFFF)

    def parameter(name: str, form: int, dimensions: list[int], content: bytes) -> bytes:
        body = struct.pack("bB", form, len(dimensions)) + bytes(dimensions) + content + b"\0"
        return struct.pack("bb", len(name), 1) + name.encode() + word(2 + len(body)) + body

    def section(start: int) -> bytes:
        names = "".join(f"{label:8}" for label in labels).encode()
        records = struct.pack("bb", 5, -1) + b"POINT" + word(3) + b"\0"
        records += parameter("USED", 2, [], word(len(labels)))
        records += parameter("DATA_START", 2, [], word(start))
        records += parameter("SCALE", 4, [], number(scale))
        records += parameter("RATE", 4, [], number(60))
        records += parameter("UNITS", -1, [2], b"mm")
        records += parameter("LABELS", -1, [8, len(labels)], names)
        content = bytes([1, 0x50, 0, kind]) + records + b"\0"
        return content + bytes(-len(content) % BLOCK)

    start = 2 + len(section(0)) // BLOCK
    header = bytes([2, 0x50]) + word(len(labels)) + word(analog) + word(1) + word(frames)
    header += word(10) + number(scale) + word(start) + word(1) + number(60)
    content = header + bytes(BLOCK - len(header)) + section(start)
    for frame in range(frames):
        for index in range(len(labels)):
            place = [100 * (index % 2) + frame, 150 * (index // 2), 900]
            for value in [*place, -1 if frame % 5 == 3 and index == 1 else 0]:
                content += number(value) if scale < 0 else word(round(value))
        content += bytes(analog * (4 if scale < 0 else 2))
    return content


def wav(rate: int, channels: int, width: int, seconds: float, floating: bool = False) -> bytes:
    """A tone with clicks; `width` is in bytes."""
    data = bytearray()
    for n in range(int(rate * seconds)):
        value = 0.3 * math.sin(0.05 * n) + 0.5 * math.exp(-(n % (rate // 4)) / 200)
        if floating:
            sample = struct.pack("<f" if width == 4 else "<d", value)
        elif width == 1:
            sample = bytes([int(128 + 100 * value)])
        else:
            top = (1 << 8 * width - 1) - 1
            sample = int(top * value).to_bytes(width, "little", signed=True)
        data += sample * channels
    block = channels * width
    form = struct.pack(
        "<HHIIHH", 3 if floating else 1, channels, rate, rate * block, block, 8 * width
    )
    return (
        b"RIFF" + struct.pack("<I", 36 + len(data)) + b"WAVEfmt " + struct.pack("<I", 16) + form
        + b"data" + struct.pack("<I", len(data)) + bytes(data)
    )


def npy(
    shape: tuple[int, ...], values: "object" = None, descr: str = "<f4", fortran: bool = False,
    version: int = 1,
) -> bytes:
    """An array; values are taken in turn, else all are a slow wave."""
    count = math.prod(shape)
    values = values or [0.1 * math.sin(0.01 * n) for n in range(count)]
    order = "True" if fortran else "False"
    axes = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    header = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({axes}), }}"
    head = 10 if version == 1 else 12
    header += " " * (-(head + len(header) + 1) % 64) + "\n"
    size = struct.pack("<H" if version == 1 else "<I", len(header))
    letter = {"<f4": "f", "<f8": "d", "<i4": "i"}[descr]
    numbers = (int(v) if letter == "i" else v for v in values)
    content = struct.pack(f"<{count}{letter}", *numbers)
    return b"\x93NUMPY" + bytes([version, 0]) + size + header.encode() + content


def phrase(frames: int) -> list[float]:
    """Motion at rest: the identity rotation, other channels zero."""
    row = [0.0] * 25
    row[1], row[9] = 1.0, 1.0
    return row * frames


def features(frames: int, packed: bool) -> bytes:
    """Audio features."""
    rows = {"mel": 128, "chroma": 12, "mfcc": 20}
    flat = ["rms", "spectral_centroid", "onset_strength"]
    file = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
    with zipfile.ZipFile(file, "w", kind) as archive:
        for name, count in rows.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), npy((count, frames)), kind)
        for name in flat:
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), npy((frames,)), kind)
    return file.getvalue()


PARTS = """[[part]]
name = "upper"
below = ["Spine"]
joints = ["Hips"]

[[part]]
name = "lower"
joints = ["Hips"]
root_trajectory = true
"""
POSES = """[[keyframe]]
time = 1.0
source_time = 0.5
reach = 0.3
part = "Spine"
"""
PLAN = """\
output = "set"
[phrases]
frames = 10
hop = 10
[split]
validation = ["two_*"]
[[take]]
name = "one"
motion = "motion.bvh"
audio = "none"
motion_start_seconds = 0.1
motion_end_seconds = 1.2
units = "cm"
up = "y"
beats = { start_seconds = 0.0, seconds_per_beat = 0.5, beats_per_bar = 4 }
"""

GOALS = [
    """\
frames = 16
margin = 0.1
[[keyframe]]
frame = 8
x = 0.1
z = 0.4
[[keyframe]]
frame = 15
x = 0.2
z = 0.9
[[obstacle]]
kind = "disc"
x = 1.0
z = 2.0
radius = 0.4
[[obstacle]]
kind = "polygon"
vertices = [[2.0, 0.0], [3.0, 0.0], [2.5, 1.0]]
[weights]
position = 1.0
obstacle = 5.0
""",
    """\
frames = 12
[trajectory]
first_frame = 0
points = [[0.0, 0.0], [0.0, 0.05], [0.01, 0.1]]
""",
]

DANCES_PLAN = """\
output = "set"
[phrases]
frames = 10
hop = 10
[[choreonet]]
choreography = "dances.json"
intervals = "intervals.csv"
captures = "."
music = "song.wav"
"""

DANCES = """\
[
  {
    "dance_type": "C",
    "dance_id": 1,
    "start_pos": 0,
    "end_pos": 40,
    "movements": ["START", "turn", "step"],
    "durations": [1, 1, 1]
  }
]
"""

INTERVALS = """\
c3d_file,movement_tag,start_frame,end_frame
motion,turn,0,40
motion,step,20,70
"""
