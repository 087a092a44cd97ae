"""Metrics of motion; docs/evaluation.md defines them. A metric is `None` if there are too few
frames or items, or if a value is not finite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _kinegrad

__all__ = [
    "beat_alignment",
    "diversity",
    "foot_skating",
    "foot_sliding",
    "frechet_distance",
    "jerk",
    "kinematic_beats",
    "trajectory_features",
]


def foot_skating(
    positions: ArrayLike, fps: float, feet: Sequence[int] | None = None
) -> float | None:
    """Share of the steps from frame to frame in which a toe below 5 cm moves faster than 0.5 m/s,
    and does so on average over five steps: the published measure.

    Args:
        positions: Joint positions `[T, J, 3]` in metres, +y up.
        fps: Frames per second.
        feet: Indices of the toes; by default those of the 22 or 21 joints of HumanML3D or KIT-ML.
    """
    toes = None if feet is None else list(feet)
    return _kinegrad.foot_skating(np.asarray(positions, dtype=np.float64), fps, toes)


def foot_sliding(
    positions: ArrayLike, fps: float, feet: Sequence[int] | None = None
) -> float | None:
    """Share of the steps from frame to frame in which a toe below 5 cm moves faster than 0.5 m/s.

    Args:
        positions: Joint positions `[T, J, 3]` in metres, +y up.
        fps: Frames per second.
        feet: Indices of the toes; by default those of the 22 or 21 joints of HumanML3D or KIT-ML.
    """
    toes = None if feet is None else list(feet)
    return _kinegrad.foot_sliding(np.asarray(positions, dtype=np.float64), fps, toes)


def jerk(positions: ArrayLike, fps: float) -> float | None:
    """Mean over joints and frames of the norm of the third derivative of position, m/s^3.

    Args:
        positions: Joint positions `[T, J, 3]` in metres.
        fps: Frames per second.
    """
    return _kinegrad.jerk(np.asarray(positions, dtype=np.float64), fps)


def trajectory_features(motion: ArrayLike, std: ArrayLike) -> NDArray[np.float64]:
    """Means, then deviations over the frames of position, velocity and acceleration, `[18]`.

    Args:
        motion: A phrase `[T, 25]`.
        std: Standard deviation of each channel of the training phrases, `[25]`.
    """
    deviations = np.asarray(std, dtype=np.float64).ravel().tolist()
    return _kinegrad.trajectory_features(np.asarray(motion, dtype=np.float32), deviations)


def diversity(features: ArrayLike, pairs: int = 300, seed: int = 0) -> float | None:
    """Mean Euclidean distance of pairs of feature vectors: of all pairs if there are at most
    `pairs`, else of `pairs` random pairs.

    Args:
        features: `[n, features]`.
        pairs: Largest number of pairs to compare.
        seed: Seed of the random pairs.
    """
    return _kinegrad.diversity(np.asarray(features, dtype=np.float64), pairs, seed)


def frechet_distance(a: ArrayLike, b: ArrayLike) -> float | None:
    """The squared Fréchet distance of the normal distributions fitted to two sets of features.

    Args:
        a: `[n, features]`, at least two vectors.
        b: `[m, features]`, at least two vectors.
    """
    left, right = (np.asarray(each, dtype=np.float64) for each in (a, b))
    return _kinegrad.frechet_distance(left, right)


def kinematic_beats(motion: ArrayLike) -> NDArray[np.float64]:
    """Times in seconds at which the root of a phrase `[T, 25]` is slowest."""
    return _kinegrad.kinematic_beats(np.asarray(motion, dtype=np.float32))


def beat_alignment(kinematic: ArrayLike, music: ArrayLike) -> float | None:
    """The beat alignment score of AIST++, from 0 to 1.

    Args:
        kinematic: Beats of the motion, in seconds.
        music: Beats of the music, in seconds.
    """
    beats = (np.asarray(each, dtype=np.float64).ravel().tolist() for each in (kinematic, music))
    return _kinegrad.beat_alignment(*beats)
