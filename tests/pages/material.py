"""Motions and songs for the pages, and their contents, computed without kinegrad; pictures."""

import array
import ast
import math
import struct
import wave
import zlib


def write_npy(path, shape, values):
    """Writes float32 `values`, an array.array('f'), as an array of `shape`."""
    header = str({"descr": "<f4", "fortran_order": False, "shape": tuple(shape)})
    header += " " * (-(len(header) + 11) % 64) + "\n"
    path.write_bytes(
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + values.tobytes()
    )


def read_npy(path):
    """Shape and float32 values of an array."""
    data = path.read_bytes()
    assert data[:6] == b"\x93NUMPY"
    size, start = (struct.unpack("<H", data[8:10])[0], 10) if data[6] == 1 else (
        struct.unpack("<I", data[8:12])[0], 12)
    header = ast.literal_eval(data[start:start + size].decode())
    assert header["descr"] == "<f4" and not header["fortran_order"]
    values = array.array("f")
    values.frombytes(data[start + size:])
    return header["shape"], values


def write_song(path, seconds, tempo=120):
    """A WAV file of clicks."""
    rate = 8000
    beat = 60 / tempo
    samples = array.array("h")
    for n in range(int(seconds * rate)):
        since = (n / rate) % beat
        samples.append(int(20000 * math.exp(-60 * since) * math.sin(2 * math.pi * 440 * since)))
    with wave.open(str(path), "wb") as song:
        song.setnchannels(1)
        song.setsampwidth(2)
        song.setframerate(rate)
        song.writeframes(samples.tobytes())


def decoded(png):
    """Width, height and RGB rows of an 8-bit PNG without interlacing."""
    at, data, header = 8, b"", None
    while at < len(png):
        size, kind = int.from_bytes(png[at:at + 4], "big"), png[at + 4:at + 8]
        body = png[at + 8:at + 8 + size]
        header = body if kind == b"IHDR" else header
        data += body if kind == b"IDAT" else b""
        at += 12 + size
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    bytes_per_pixel = {2: 3, 6: 4}[header[9]]
    raw, stride = zlib.decompress(data), width * bytes_per_pixel
    rows, before = [], bytearray(stride)
    for y in range(height):
        kind = raw[y * (stride + 1)]
        row = bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for x in range(stride):
            left = row[x - bytes_per_pixel] if x >= bytes_per_pixel else 0
            up = before[x]
            corner = before[x - bytes_per_pixel] if x >= bytes_per_pixel else 0
            if kind == 1:
                row[x] = (row[x] + left) & 255
            elif kind == 2:
                row[x] = (row[x] + up) & 255
            elif kind == 3:
                row[x] = (row[x] + (left + up) // 2) & 255
            elif kind == 4:
                guess = left + up - corner
                nearest = min((left, up, corner), key=lambda value: abs(guess - value))
                row[x] = (row[x] + nearest) & 255
        rows.append(row)
        before = row
    return width, height, [[tuple(row[x * bytes_per_pixel:x * bytes_per_pixel + 3])
                            for x in range(width)] for row in rows]


def walk(frames, joints=22, seed=0):
    """Joints of a walking body `[frames, joints, 3]`, chains of the HumanML3D skeleton."""
    chains = [[0, 2, 5, 8, 11], [0, 1, 4, 7, 10], [0, 3, 6, 9, 12, 15],
              [9, 14, 17, 19, 21], [9, 13, 16, 18, 20]]
    rest = {2: (-.09, -.07, 0), 5: (0, -.4, 0), 8: (0, -.4, 0), 11: (0, -.05, .13),
            1: (.09, -.07, 0), 4: (0, -.4, 0), 7: (0, -.4, 0), 10: (0, -.05, .13),
            3: (0, .12, 0), 6: (0, .13, 0), 9: (0, .06, 0), 12: (0, .2, 0), 15: (0, .1, .04),
            14: (-.08, .1, 0), 17: (-.11, .02, 0), 19: (-.05, -.25, 0), 21: (-.02, -.24, .05),
            13: (.08, .1, 0), 16: (.11, .02, 0), 18: (.05, -.25, 0), 20: (.02, -.24, .05)}
    values = array.array("f")
    for t in range(frames):
        phase = t / 20 * 2 * math.pi + seed
        place = [None] * joints
        place[0] = (2.5 * math.cos(t / 200 + seed), .93 + .02 * math.sin(2 * phase), 2.5 * math.sin(t / 200 + seed))
        for chain in chains:
            for a, b in zip(chain, chain[1:]):
                x, y, z = rest[b]
                swing = .5 * math.sin(phase + (math.pi if b in (4, 7, 10, 14, 17, 19, 21) else 0))
                if y > -.2:
                    swing *= .1
                cos, sin = math.cos(swing), math.sin(swing)
                px, py, pz = place[a]
                place[b] = (px + x, py + y * cos - z * sin, pz + y * sin + z * cos)
        for point in place:
            values.extend(point)
    return values


class Capture:
    """A BVH file of 66 joints whose every joint turns, with mixed channel orders."""

    ORDERS = ["ZXY", "XYZ", "YXZ"]

    def __init__(self, frames=40):
        self.joints = [("Hips", None, (0.0, 0.0, 0.0), "ZXY")]
        self.chain("Spine", 0, 4, (0, 14, 0))
        self.chain("Head", 4, 2, (0, 11, 0))
        for side, sign in (("Left", 1), ("Right", -1)):
            hip = self.chain(side + "UpLeg", 0, 1, (9 * sign, -4, 0))
            self.chain(side + "Foot", hip, 3, (0, -28, 2))
            arm = self.chain(side + "Arm", 4, 3, (14 * sign, -3, 0))
            for finger in range(5):
                self.chain(f"{side}Finger{finger}", arm, 4, (3 * sign, -1, finger - 2))
        self.frames = [self.frame(t) for t in range(frames)]

    def chain(self, name, parent, count, offset):
        for index in range(count):
            order = self.ORDERS[len(self.joints) % 3]
            self.joints.append((f"{name}{index}", parent, tuple(map(float, offset)), order))
            parent = len(self.joints) - 1
        return parent

    def frame(self, t):
        """Root position in centimetres and degrees of each joint."""
        root = (40 * math.sin(t / 9), 95 + 2 * math.sin(t / 3), 4.0 * t)
        angles = [[12 * math.sin(t / 7 + j + axis) for axis in range(3)] for j in range(len(self.joints))]
        return root, angles

    def write(self, path):
        children = [[] for _ in self.joints]
        for index, (_, parent, _, _) in enumerate(self.joints):
            if parent is not None:
                children[parent].append(index)
        lines, order = ["HIERARCHY"], []

        def joint(index, indent):
            name, parent, offset, turns = self.joints[index]
            order.append(index)
            pad = "  " * indent
            lines.append(f"{pad}{'ROOT' if parent is None else 'JOINT'} {name}")
            lines.append(pad + "{")
            lines.append(f"{pad}  OFFSET {offset[0]} {offset[1]} {offset[2]}")
            places = "Xposition Yposition Zposition " if parent is None else ""
            channels = places + " ".join(f"{axis}rotation" for axis in turns)
            lines.append(f"{pad}  CHANNELS {len(channels.split())} {channels}")
            for child in children[index]:
                joint(child, indent + 1)
            if not children[index]:
                lines.append(f"{pad}  End Site\n{pad}  {{\n{pad}    OFFSET 0 2 0\n{pad}  }}")
            lines.append(pad + "}")

        joint(0, 0)
        lines += ["MOTION", f"Frames: {len(self.frames)}", "Frame Time: 0.0166667"]
        for root, angles in self.frames:
            numbers = list(root) + [value for index in order for value in angles[index]]
            lines.append(" ".join(f"{value:.6f}" for value in numbers))
        path.write_text("\n".join(lines) + "\n")
        self.order = order

    def positions(self, t):
        """Joint positions of a frame in metres, in the order of the file."""
        root, angles = self.frames[t]
        world = {}
        for index, (_, parent, offset, turns) in enumerate(self.joints):
            turn = identity()
            for axis, degrees in zip(turns, angles[index]):
                turn = product(turn, about(axis, math.radians(degrees)))
            if parent is None:
                world[index] = (root, turn)
            else:
                place, above = world[parent]
                arm = [sum(above[i][k] * offset[k] for k in range(3)) for i in range(3)]
                world[index] = (tuple(place[i] + arm[i] for i in range(3)), product(above, turn))
        return [[value / 100 for value in world[index][0]] for index in self.order]


def identity():
    return [[float(i == j) for j in range(3)] for i in range(3)]


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def about(axis, angle):
    i = "XYZ".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    turn = identity()
    turn[j][j] = turn[k][k] = math.cos(angle)
    turn[k][j] = math.sin(angle)
    turn[j][k] = -math.sin(angle)
    return turn
