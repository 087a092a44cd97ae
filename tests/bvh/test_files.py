"""Files for other programs, read by foreign programs: `scripts/test_bvh` runs this.

KINEGRAD_BINARY is the binary. Every length is compared in metres.
"""

import os
import pathlib
import subprocess
import tempfile
import unittest

import numpy as np

import gltf
from readers import READERS, by_bvhio, by_pymotion

BINARY = pathlib.Path(os.environ["KINEGRAD_BINARY"]).resolve()
CENTIMETRES = 100
NAMES = """pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3
left_foot right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow
right_elbow left_wrist right_wrist""".split()
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
# Rest position of each bone of a person, in metres.
REST = np.array([
    [0, 0, 0], [.06, -.09, 0], [-.06, -.09, 0], [0, .12, -.03], [.04, -.38, 0], [-.04, -.38, 0],
    [0, .14, .02], [-.02, -.4, -.04], [.02, -.4, -.04], [0, .06, .02], [.03, -.06, .12],
    [-.03, -.06, .12], [0, .21, -.03], [.08, .12, -.02], [-.08, .12, -.02], [0, .09, .05],
    [.1, .04, -.01], [-.1, .04, -.01], [.26, -.01, -.02], [-.26, -.01, -.02], [.25, .01, 0],
    [-.25, .01, 0],
])
# The smallest model of clips, trained next to nothing.
TINY = """
[run]
name = "tiny"
device = "cpu"
[data]
kind = "synthetic_walks"
target_frames = 16
batch_size = 2
num_workers = 0
[data.synthetic]
phrases = 12
frames = 48
[model]
kind = "gmd_unet"
latent_dim = 16
dim_mults = [1.0, 1.0]
padded_frames = 16
[train]
recipe = "gmd_motion"
max_steps = 2
[sampling.sampler]
num_inference_steps = 4
"""


def body(frames=60):
    """A person [frames, 22, 3] who walks and turns, every bone by its own angles."""
    seconds = np.arange(frames) / 20
    places = np.zeros((frames, 22, 3))
    places[:, 0] = np.stack([0.4 * seconds, 0.95 + 0.03 * np.sin(5 * seconds), 0.7 * seconds], 1)
    half = 0.4 * seconds
    heading = gltf.matrices(np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], 1))
    for joint in range(1, 22):
        swing = [0.25 * np.sin(3 * seconds + joint + axis) for axis in range(3)]
        turn = np.stack([*swing, np.ones(frames)], 1)
        turn = gltf.matrices(turn / np.linalg.norm(turn, axis=1, keepdims=True))
        bone = np.einsum("tij,tjk,k->ti", heading, turn, REST[joint])
        places[:, joint] = places[:, PARENTS[joint]] + bone
    return places.astype(np.float32)


# A capture: name, parent, OFFSET in centimetres with z up, order of the angles.
CAPTURE = [("Hips", None, (0, 0, 0), "ZXY"), ("Spine", 0, (0, 1, 12), "XYZ"),
           ("LeftArm", 1, (18, 0, 20), "YXZ"), ("LeftHand", 2, (26, 0, -3), "ZYX"),
           ("Head", 1, (0, 2, 30), "XZY"), ("LeftFoot", 0, (9, 0, -90), "YZX")]


def capture(path, frames=40):
    """Writes a BVH file; its angles [frames, joints, 3] and places of the root [frames, 3]."""
    rng = np.random.default_rng(4)
    angles = np.cumsum(rng.normal(0, 9, (frames, len(CAPTURE), 3)), 0)
    places = np.cumsum(rng.normal(0, 2, (frames, 3)), 0) + [30, -40, 95]
    lines = ["HIERARCHY"]

    def joint(index):
        name, parent, offset, order = CAPTURE[index]
        lines.extend([("ROOT " if parent is None else "JOINT ") + name, "{"])
        lines.append("OFFSET %g %g %g" % offset)
        names = [f"{axis}position" for axis in "XYZ" if parent is None]
        names += [f"{axis}rotation" for axis in order]
        lines.append(f"CHANNELS {len(names)} " + " ".join(names))
        below = [child for child, other in enumerate(CAPTURE) if other[1] == index]
        for child in below:
            joint(child)
        if not below:
            lines.extend(["End Site", "{", "OFFSET 0 0 4", "}"])
        lines.append("}")

    joint(0)
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.05"]
    numbers = np.concatenate([places, angles.reshape(frames, -1)], 1)
    lines += [" ".join(f"{number:.6f}" for number in row) for row in numbers]
    path.write_text("\n".join(lines) + "\n")
    return angles, places


def turns(order, angles):
    """Rotation matrices [frames, 3, 3] of degrees [frames, 3] about the axes of `order`."""
    turned = np.tile(np.eye(3), (len(angles), 1, 1))
    for axis, degrees in zip(order, np.radians(angles).T):
        i = "XYZ".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        one = np.tile(np.eye(3), (len(angles), 1, 1))
        one[:, j, j] = one[:, k, k] = np.cos(degrees)
        one[:, k, j], one[:, j, k] = np.sin(degrees), -np.sin(degrees)
        turned = turned @ one
    return turned


def phrase(frames=150):
    """A phrase [frames, 25] that leans, and turns more than once around."""
    seconds = np.arange(frames) / 30
    values = np.zeros((frames, 25), np.float32)
    values[:, 0:3] = np.stack([np.sin(seconds), 0.95 + 0 * seconds, 0.3 * seconds], 1)
    turn = np.stack([np.cos(seconds), 0.2 * np.sin(3 * seconds), np.sin(seconds),
                     0.1 * np.cos(seconds)], 1)
    values[:, 9:13] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return values


class Files(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def kinegrad(self, *words):
        done = subprocess.run([BINARY, *words], cwd=self.folder, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    def written(self, motion):
        """Paths of the BVH and the GLB file of a motion."""
        np.save(self.folder / "motion.npy", motion)
        self.kinegrad("view", "motion.npy", "--bvh", "motion.bvh", "--glb", "motion.glb")
        return self.folder / "motion.bvh", self.folder / "motion.glb"

    def near(self, found, known, tolerance=1e-4):
        self.assertEqual(found.shape, known.shape)
        self.assertLess(np.abs(found - known).max(), tolerance)

    def test_joints_of_a_body_are_where_the_array_has_them(self):
        motion = body()
        bvh, glb = self.written(motion)
        for read in READERS:
            joints = read(bvh)
            for index, name in enumerate(NAMES):
                self.near(joints[name] / CENTIMETRES, motion[:, index])
        joints = gltf.positions(glb)
        for index, name in enumerate(NAMES):
            self.near(joints[name], motion[:, index], 1e-5)

    def test_a_glb_of_a_capture_keeps_its_hierarchy_angles_and_rest_pose(self):
        angles, places = capture(self.folder / "take.bvh")
        self.kinegrad("view", "take.bvh", "--units", "cm", "--up", "z", "--glb", "take.glb")
        glb = gltf.Animation(self.folder / "take.glb")
        nodes = {node.name: index for index, node in enumerate(glb.file.nodes)}
        # The take and its skin.
        self.assertEqual(len(glb.file.nodes), len(CAPTURE) + 2)
        z_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
        for index, (name, _, offset, order) in enumerate(CAPTURE):
            node = nodes[name]
            below = [CAPTURE[child][0] for child, other in enumerate(CAPTURE) if other[1] == index]
            children = glb.file.nodes[node].children or []
            self.assertEqual([glb.file.nodes[child].name for child in children], below)
            known = z_up @ turns(order, angles[:, index]) @ z_up.T
            self.near(gltf.matrices(glb.at(node, "rotation")), known, 1e-6)
            self.near(np.array(glb.at_rest(node, "translation")), z_up @ offset / CENTIMETRES, 1e-7)
            self.assertEqual(list(glb.at_rest(node, "rotation")), [0, 0, 0, 1])
        self.near(glb.at(nodes["Hips"], "translation"), places @ z_up.T / CENTIMETRES, 1e-6)
        # Joints as other readers of the BVH have them.
        joints = gltf.positions(self.folder / "take.glb")
        for name, known in by_bvhio(self.folder / "take.bvh").items():
            self.near(joints[name], known @ z_up.T / CENTIMETRES, 1e-5)

    def test_a_phrase_is_where_the_array_has_it(self):
        motion = phrase()
        bvh, glb = self.written(motion)
        for read in READERS:
            self.near(read(bvh)["root"] / CENTIMETRES, motion[:, 0:3])
        self.near(gltf.positions(glb)["root"], motion[:, 0:3], 1e-5)

    def test_samples_are_the_same_in_both_readers(self):
        (self.folder / "tiny.toml").write_text(TINY)
        self.kinegrad("train", "tiny.toml", "--name", "tiny")
        self.kinegrad("sample", "runs/tiny", "--frames", "16", "--out", "walk")
        one, other = (read(self.folder / "walk.bvh") for read in (by_bvhio, by_pymotion))
        self.assertEqual(set(one), set(other))
        self.assertTrue(set(NAMES) <= set(one))
        for name in one:
            self.near(one[name] / CENTIMETRES, other[name] / CENTIMETRES)
        # The bones of a model that has learnt little change their lengths, but its root is its root.
        motion = np.load(self.folder / "walk.npy")
        self.near(one["pelvis"] / CENTIMETRES, motion[:, 0])

    def test_new_motions_have_the_bones_of_their_example_in_both_readers(self):
        example, _ = self.written(body())
        for options in [], ["--heading", "--loop"], ["--preset", "paper"]:
            self.kinegrad("match", "motion.bvh", "--out", "new.bvh", "--overwrite", *options)
            one, other = (read(self.folder / "new.bvh") for read in (by_bvhio, by_pymotion))
            self.assertEqual(len(one["pelvis"]), 120)
            of_example = by_bvhio(example)
            self.assertEqual(list(one), list(of_example))
            bones = [(NAMES[joint], NAMES[PARENTS[joint]]) for joint in range(1, len(NAMES))]
            for name in one:
                self.near(one[name] / CENTIMETRES, other[name] / CENTIMETRES)
            for end, start in bones:
                lengths = [np.linalg.norm(joints[end] - joints[start], axis=1).mean()
                           for joints in (one, of_example)]
                self.assertAlmostEqual(*lengths, places=3)


if __name__ == "__main__":
    unittest.main()
