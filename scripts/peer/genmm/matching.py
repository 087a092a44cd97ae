"""Generative motion matching in PyTorch, from the formulas in docs/sources/genmm.md.

As the published program does it: every patch is formed, distances are one product of matrices, and
frames are the means of the patches that cover them. Motions are tensors [frames, channels].
"""

import torch
from torch.nn.functional import interpolate


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
    return motion.unfold(0, size, 1).flatten(1)


def voted(chosen: torch.Tensor, channels: int, size: int) -> torch.Tensor:
    """The motion in which patch i begins at frame i."""
    count = chosen.shape[0]
    parts = chosen.view(count, channels, size)
    total = torch.zeros(count + size - 1, channels)
    weight = torch.zeros(count + size - 1, 1)
    for place in range(size):
        total[place : place + count] += parts[:, :, place]
        weight[place : place + count] += 1
    return total / weight


def step(motion: torch.Tensor, example: torch.Tensor, size: int, alpha: float | None) -> torch.Tensor:
    """One step of matching and voting."""
    current, known = patches(motion, size), patches(example, size)
    squares = current.square().sum(1)[:, None] + known.square().sum(1)[None]
    distances = (squares - 2 * current @ known.T).clamp(min=0) / current.shape[1]
    if alpha is not None:
        distances = distances / (alpha + distances.min(0).values)
    return voted(known[distances.argmin(1)], motion.shape[1], size)


def synthesized(
    example: torch.Tensor,
    frames: int,
    *,
    patch_size: int = 11,
    patches_coarse: float = 5,
    factor: float = 0.75,
    alpha: float | None = 0.01,
    sigma: float = 10,
    steps: int = 3,
    seed: int = 0,
) -> torch.Tensor:
    """A new motion of one example, from noise of the seed."""
    ratio = patches_coarse * patch_size / example.shape[0]
    of_example = lengths(example.shape[0], ratio, factor)
    of_motion = lengths(frames, ratio, factor)
    noise = torch.Generator().manual_seed(seed)
    motion = resampled(resampled(example, of_example[0]), of_motion[0], aligned=True)
    motion = motion + sigma * torch.randn(motion.shape, generator=noise)
    motion = torch.fmod(motion, 1.0) if sigma > 0 else motion
    for known, new in zip(of_example, of_motion, strict=False):
        level = resampled(example, known)
        motion = resampled(motion, new)
        for _ in range(steps):
            motion = step(motion, level, patch_size, alpha)
    return motion
