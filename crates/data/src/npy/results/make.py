"""Writes the files of this folder with NumPy: results as the programs of MDM and FlowMDM save them."""
import pickle

import numpy as np


def save(name, value, protocol, numpy1=False):
    array = np.empty((), dtype=object)
    array[()] = value
    data = pickle.dumps(array, protocol=protocol)
    if numpy1:
        # The module names of NumPy before version 2; protocol 3 has them as lines.
        data = data.replace(b"cnumpy._core.", b"cnumpy.core.")
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }"
    header += b" " * (118 - 1 - len(header)) + b"\n"
    with open(name, "wb") as file:
        file.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data)


# Coordinate c of joint j in frame t of motion n is 100 n + 10 j + c + t / 8.
n, j, c, t = np.meshgrid(*map(np.arange, (2, 2, 3, 5)), indexing="ij")
motion = (100 * n + 10 * j + c + t / 8).astype("<f4")
texts = ["a person walks", "a person stands"]
mdm = dict(motion=motion, text=texts, lengths=np.array([5, 3]), num_samples=2, num_repetitions=1)
save("protocol3.npy", mdm, 3, numpy1=True)
np.save("protocol4.npy", mdm)
flipped = np.asfortranarray(motion.astype("<f8"))
save("protocol5.npy", dict(motion=flipped, text=texts, lengths=[5, 3]), 5)
