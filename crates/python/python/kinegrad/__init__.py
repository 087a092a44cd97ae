"""Train motion-generation models, sample from them and measure the result.

    import kinegrad

    run = kinegrad.train("kinegrad.toml")
    for sample in run.sample(count=2):
        print(sample.motion.shape)

Motion is float32 NumPy arrays as in the files of the command line: phrases `[T, 25]` at 30 frames
per second, joint positions `[T, J, 3]` in metres with +y up, joint features `[T, 263]` or
`[T, 251]`. The arrays equal those of the command line byte for byte.
"""

from __future__ import annotations

from . import errors, metrics
from ._kinegrad import __version__
from .data import Batches, Dataset
from .errors import (
    CheckpointError,
    ConfigError,
    DataError,
    Error,
    NotFiniteError,
    StorageError,
    UsageError,
)
from .motion import Bvh, SongFeatures, audio_features, check, postprocess, read_bvh, write_bvh
from .runs import Run, Sample, StepReport, train

__all__ = [
    "Batches",
    "Bvh",
    "CheckpointError",
    "ConfigError",
    "DataError",
    "Dataset",
    "Error",
    "NotFiniteError",
    "Run",
    "Sample",
    "SongFeatures",
    "StepReport",
    "StorageError",
    "UsageError",
    "__version__",
    "audio_features",
    "check",
    "errors",
    "metrics",
    "postprocess",
    "read_bvh",
    "train",
    "write_bvh",
]
