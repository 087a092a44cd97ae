"""Joint positions of a GLB file, from its nodes and its animation alone."""

import numpy as np
import pygltflib

COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def positions(path):
    """A dictionary of node names to arrays [frames, 3]; of nodes of one name the last."""
    file = pygltflib.GLTF2().load(str(path))
    blob = file.binary_blob()

    def numbers(index):
        accessor = file.accessors[index]
        view = file.bufferViews[accessor.bufferView]
        assert accessor.componentType == pygltflib.FLOAT and view.byteOffset % 4 == 0
        width = COMPONENTS[accessor.type]
        start = view.byteOffset + (accessor.byteOffset or 0)
        flat = np.frombuffer(blob, "<f4", accessor.count * width, start)
        return flat.reshape(-1, width).astype(np.float64)

    tracks, frames = {}, 1
    for animation in file.animations:
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            values = numbers(sampler.output)
            frames = max(frames, len(values))
            tracks[channel.target.node, channel.target.path] = values

    def at(node, path, default):
        values = tracks.get((node, path))
        if values is None:
            values = np.array([getattr(file.nodes[node], path) or default], dtype=np.float64)
        return np.concatenate([values, np.repeat(values[-1:], frames - len(values), 0)])

    found = {}
    waiting = [(node, np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)))
               for node in file.scenes[file.scene].nodes]
    while waiting:
        node, place, turn = waiting.pop()
        place = place + np.einsum("tij,tj->ti", turn, at(node, "translation", [0, 0, 0]))
        turn = turn @ matrices(at(node, "rotation", [0, 0, 0, 1]))
        found[file.nodes[node].name] = place
        waiting += [(child, place, turn) for child in file.nodes[node].children or []]
    return found


def matrices(quaternions):
    """Rotation matrices [frames, 3, 3] of quaternions (x, y, z, w)."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
