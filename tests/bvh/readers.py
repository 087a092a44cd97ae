"""Joint positions of a BVH file, by two independent foreign readers.

Each returns a dictionary of joint names to arrays [frames, 3] in the file's units, +y up.
"""

import bvhio
import numpy as np
from pymotion.io.bvh import BVH
from pymotion.ops.skeleton import fk


def by_bvhio(path):
    root = bvhio.readAsHierarchy(str(path))
    joints = [joint for joint, _, _ in root.layout()]
    first, last = root.getKeyframeRange()
    found = {joint.Name: [] for joint in joints}
    for frame in range(first, last + 1):
        root.loadPose(frame)
        for joint in joints:
            found[joint.Name].append([*joint.PositionWorld])
    return {name: np.array(places) for name, places in found.items()}


def by_pymotion(path):
    bvh = BVH()
    bvh.load(str(path))
    rotations, positions, parents, offsets, _, _ = bvh.get_data()
    found, _ = fk(rotations, positions[:, 0, :], offsets, parents)
    return {name: found[:, index] for index, name in enumerate(bvh.data["names"])}


READERS = [by_bvhio, by_pymotion]
