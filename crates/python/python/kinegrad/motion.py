"""Motion and music: files, checks, audio features."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _kinegrad
from ._kinegrad import SongFeatures
from ._settings import Path as PathArgument

__all__ = ["Bvh", "SongFeatures", "audio_features", "check", "read_bvh", "write_bvh"]


class Bvh(NamedTuple):
    """The motion of a BVH file."""

    positions: NDArray[np.float64]
    """Joint positions `[T, J, 3]` in metres, in the file's axes."""
    names: list[str]
    """Name of each joint."""
    parents: list[int]
    """Index of each joint's parent, smaller than its own; -1 for the root."""
    fps: float
    """Frames per second."""


def read_bvh(path: PathArgument, units_per_metre: float = 100.0) -> Bvh:
    """Reads a BVH file and computes its joint positions.

    Args:
        path: The file.
        units_per_metre: Units of the file in a metre: 100 for centimetres, 1 for metres.

    Raises:
        DataError, UsageError: For an invalid file; names the line.
        StorageError: For a file that cannot be read.
    """
    return Bvh(*_kinegrad.read_bvh(path, units_per_metre))


def write_bvh(path: PathArgument, positions: ArrayLike, units_per_metre: float = 100.0) -> None:
    """Writes joint positions as a BVH file, as `kinegrad sample` does.

    Args:
        path: The file to write.
        positions: `[T, 22, 3]` of HumanML3D's joints or `[T, 21, 3]` of KIT-ML's, in metres.
        units_per_metre: Units of the file in a metre.

    Raises:
        UsageError: For another number of joints.
        DataError: For positions that are not finite.
    """
    positions = np.asarray(positions, dtype=np.float64)
    _kinegrad.write_bvh(path, positions, units_per_metre)


def check(
    motion: ArrayLike | PathArgument,
    profile: Literal["ccmotion", "strict"] = "strict",
    run: PathArgument | None = None,
    thresholds: dict[str, float] | None = None,
) -> dict[str, Any]:
    """Checks motion for physical sanity, as `kinegrad check` does.

    Args:
        motion: A phrase `[T, 25]`, joint features `[T, 263]` or `[T, 251]`, joint positions
            `[T, J, 3]` in metres, or the path of a `.npy` file of one.
        profile: `"strict"` checks the movement of positions and rotations, with bounds from the
            training motion of `run`, or from captured people; `"ccmotion"` checks the channels of
            phrases.
        run: Run or checkpoint whose training statistics `"strict"` uses.
        thresholds: Bounds of `"ccmotion"`, by the keys of the table `evaluation.thresholds`.

    Returns:
        `passed`, and `checks`: for each its `name`, `passed`, `value`, `threshold` and `message`.

    Raises:
        UsageError: For an array of an unknown representation.
    """
    if isinstance(motion, (str, Path)):
        motion = np.load(motion)
    array = np.asarray(motion, dtype=np.float32)
    report: dict[str, Any] = json.loads(
        _kinegrad.check(array, profile, run, None if thresholds is None else json.dumps(thresholds))
    )
    return report


def postprocess(
    motion: ArrayLike | PathArgument,
    profile: Literal["default", "ccmotion", "none"] = "default",
    run: PathArgument | None = None,
    settings: dict[str, Any] | None = None,
) -> NDArray[np.float32]:
    """Post-processes a phrase, as `kinegrad sample --postprocess`.

    Args:
        motion: A phrase `[T, 25]`, or the path of its `.npy` file.
        profile: `"default"`, `"ccmotion"` (exactly CC-MotionGen's) or `"none"`.
        run: Run or checkpoint whose training statistics widen the limits and scale the fit of
            coherent motion. Without a run nothing is fitted.
        settings: Keys of the table `evaluation.postprocess` that differ from the profile's, such as
            `{"apply_smoothing": True}`.

    Returns:
        The phrase, `[T, 25]`.

    Raises:
        UsageError: For another array, or an unknown key.
    """
    if isinstance(motion, (str, Path)):
        motion = np.load(motion)
    array = np.asarray(motion, dtype=np.float32)
    return _kinegrad.postprocess(array, profile, json.dumps(settings or {}), run)


def audio_features(song: PathArgument) -> SongFeatures:
    """Computes the audio features of a song (mp3, wav, flac, ogg), as `kinegrad audio features`.

    Returns:
        An object with `features` `[163, T]` float32 at `fps` frames per second, the names of its
        `channels`, `tempo` in beats per minute, `beat_times` in seconds, the length of the song
        in `seconds`, and `save(path)`, which writes the same `features.npz` as the command line.

    Raises:
        DataError: For a song that cannot be decoded.
    """
    return _kinegrad.audio_features(song)
