"""Generative motion matching in PyTorch, from the formulas in docs/sources/genmm.md.

Like the published program: patches and means of patches are convolutions with one-hot kernels (the
package `unfoldNd`), and distances are products of matrices.
Motions are tensors [frames, channels].
"""

import torch
from torch.nn.functional import interpolate
from unfoldNd import foldNd, unfoldNd


def lengths(frames: int, ratio: float, factor: float) -> list[int]:
    """Frames of each level, the coarsest first."""
    found = [round(frames * ratio)]
    while found[-1] < frames:
        longer = round(found[-1] / factor)
        found.append(longer if longer > found[-1] else found[-1] + 1)
    found[-1] = frames
    return found


def resampled(motion: torch.Tensor, frames: int, aligned: bool = False) -> torch.Tensor:
    """The motion at another number of frames."""
    image = motion.T[None]
    return interpolate(image, size=frames, mode="linear", align_corners=aligned)[0].T


def patches(motion: torch.Tensor, size: int) -> torch.Tensor:
    """All stretches of `size` frames, [patches, channels * size]."""
    return unfoldNd(motion.T[None], kernel_size=size)[0].T


def voted(chosen: torch.Tensor, channels: int, size: int) -> torch.Tensor:
    """The motion in which patch i begins at frame i."""
    frames = (chosen.shape[0] + size - 1,)
    total = foldNd(chosen.T[None], output_size=frames, kernel_size=size)
    ones = unfoldNd(torch.ones(1, channels, *frames), kernel_size=size)
    return (total / foldNd(ones, output_size=frames, kernel_size=size))[0].T


def distances(current: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Mean squared differences of all pairs of patches."""
    squares = current.square().sum(1)[:, None] + known.square().sum(1)[None]
    return (squares - 2 * current @ known.T) / current.shape[1]


def step(motion: torch.Tensor, known: torch.Tensor, size: int, alpha: float | None) -> torch.Tensor:
    """One step of matching and voting with the patches `known` of the example."""
    current = patches(motion, size)
    scale = 1.0
    if alpha is not None:
        parts = known.split(AT_A_TIME)
        scale = alpha + torch.cat([distances(current, part).min(0).values for part in parts])
    parts = current.split(AT_A_TIME)
    nearest = torch.cat([(distances(part, known) / scale).argmin(1) for part in parts])
    return voted(known[nearest], motion.shape[1], size)


PATCH_SIZE, FACTOR = 11, 0.75
AT_A_TIME = 1024
"""Patches whose distances are in memory at a time; with completeness all are computed twice."""


def first_length(example: int, frames: int, patches_coarse: float = 5) -> int:
    """Frames of the coarsest level of a motion of `frames` frames, of an example of `example`."""
    return lengths(frames, patches_coarse * PATCH_SIZE / example, FACTOR)[0]


def synthesized(
    example: torch.Tensor,
    frames: int,
    noise: torch.Tensor,
    *,
    patch_size: int = PATCH_SIZE,
    patches_coarse: float = 5,
    factor: float = FACTOR,
    alpha: float | None = 0.01,
    sigma: float = 10,
    steps: int = 3,
) -> torch.Tensor:
    """A new motion of one example, from standard normal noise as long as the coarsest level."""
    ratio = patches_coarse * patch_size / example.shape[0]
    of_example = lengths(example.shape[0], ratio, factor)
    of_motion = lengths(frames, ratio, factor)
    motion = resampled(resampled(example, of_example[0]), of_motion[0], aligned=True)
    motion = motion + sigma * noise
    motion = torch.fmod(motion, 1.0) if sigma > 0 else motion
    for known, new in zip(of_example, of_motion, strict=False):
        level = patches(resampled(example, known), patch_size)
        motion = resampled(motion, new)
        for _ in range(steps):
            motion = step(motion, level, patch_size, alpha)
    return motion
