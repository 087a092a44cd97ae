"""Damage inside archives, tensors and checksums that stay valid around it."""

import io
import json
import random
import struct
import warnings
import zipfile

from mutate import mutated, mutated_text

# Archives with two members of one name are meant.
warnings.filterwarnings("ignore", "Duplicate name")

HOSTILE = [
    b"../../outside", b"/outside", b"", b"x" * 60000, "ü".encode() * 100, b"mel.npy", b"data.pkl",
]


def mutated_archive(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A zip archive with a damaged member and right checksums, or with damage of its own."""
    if r.random() < 0.4:
        return mutated(r, content, others)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    place = r.randrange(len(members))
    # The pickle is first and describes the rest.
    if r.random() < 0.4:
        named = [n for n, (name, _) in enumerate(members) if name.endswith((".pkl", "version"))]
        place = r.choice(named or [place])
    name, member = members[place]
    kind = r.randrange(10)
    if kind < 6:
        rest = [other for _, other in members]
        members[place] = (name, mutated(r, member, rest))
    elif kind == 6:
        del members[place]
    elif kind == 7:
        members.insert(place, (name, member))
    elif kind == 8:
        members[place] = (r.choice(HOSTILE).decode() or "_", member)
    else:
        members[place] = (name, bytes(r.choice([0, 1 << 20])))
    packing = zipfile.ZIP_DEFLATED if r.random() < 0.3 else zipfile.ZIP_STORED
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", packing) as archive:
        for name, member in members:
            archive.writestr(zipfile.ZipInfo(name), member, compress_type=packing)
    return file.getvalue()


def mutated_tensors(r: random.Random, content: bytes, others: list[bytes]) -> bytes:
    """A safetensors file with a damaged header of the right length, or other damage."""
    if r.random() < 0.35:
        return mutated(r, content, others)
    size = struct.unpack("<Q", content[:8])[0]
    header, data = content[8:8 + size], content[8 + size:]
    kind = r.randrange(3)
    if kind == 0:
        header = mutated_text(r, header, [header])
    elif kind == 1:
        header = reshaped(r, header)
    else:
        data = mutated(r, data, [data])
    return struct.pack("<Q", len(header)) + header + data


def reshaped(r: random.Random, header: bytes) -> bytes:
    """A header with another name, type, shape or place of one tensor."""
    try:
        tensors = json.loads(header)
    except ValueError:
        return header
    names = [name for name in tensors if name != "__metadata__"]
    if not names:
        return header
    name = r.choice(names)
    tensor = tensors[name]
    kind = r.randrange(6)
    if kind == 0:
        tensor["dtype"] = r.choice(["F64", "F16", "BF16", "I64", "U8", "BOOL", "F8_E4M3", "Z"])
    elif kind == 1:
        tensor["shape"] = r.choice([[], [0], [2**62, 4], [2**32, 2**32], [1] * 500, [-1], [0.5]])
    elif kind == 2:
        tensor["shape"] = tensor["shape"][::-1]
    elif kind == 3:
        end = r.choice([0, 1, 2**63, 2**64 - 1, tensor["data_offsets"][1] + 1])
        tensor["data_offsets"] = r.choice([[end, 0], [0, end], [end, end]])
    elif kind == 4:
        del tensors[name]
    else:
        tensors[r.choice(["x", "", name + ".weight", "__metadata__"])] = tensors.pop(name)
    return json.dumps(tensors, separators=(",", ":")).encode()
