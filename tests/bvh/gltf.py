"""Joint positions of a GLB file, from its nodes and its animation alone."""

import numpy as np
import pygltflib

COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
DEFAULTS = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}


class Animation:
    """The nodes of a file and their motion within their parents."""

    def __init__(self, path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.blob = self.file.binary_blob()
        self.tracks, self.frames = {}, 1
        for animation in self.file.animations:
            for channel in animation.channels:
                values = self.numbers(animation.samplers[channel.sampler].output)
                self.frames = max(self.frames, len(values))
                self.tracks[channel.target.node, channel.target.path] = values

    def numbers(self, index):
        accessor = self.file.accessors[index]
        view = self.file.bufferViews[accessor.bufferView]
        assert accessor.componentType == pygltflib.FLOAT and view.byteOffset % 4 == 0
        width = COMPONENTS[accessor.type]
        start = view.byteOffset + (accessor.byteOffset or 0)
        flat = np.frombuffer(self.blob, "<f4", accessor.count * width, start)
        return flat.reshape(-1, width).astype(np.float64)

    def at_rest(self, node, path):
        return getattr(self.file.nodes[node], path) or DEFAULTS[path]

    def at(self, node, path):
        """Values [frames, 3 or 4] of the translation or the rotation of a node."""
        values = self.tracks.get((node, path))
        if values is None:
            values = np.array([self.at_rest(node, path)], dtype=np.float64)
        return np.concatenate([values, np.repeat(values[-1:], self.frames - len(values), 0)])


def positions(path):
    """A dictionary of node names to arrays [frames, 3]; of nodes of one name the last."""
    animation = Animation(path)
    file, frames = animation.file, animation.frames
    found = {}
    waiting = [(node, np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)))
               for node in file.scenes[file.scene].nodes]
    while waiting:
        node, place, turn = waiting.pop()
        place = place + np.einsum("tij,tj->ti", turn, animation.at(node, "translation"))
        turn = turn @ matrices(animation.at(node, "rotation"))
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
