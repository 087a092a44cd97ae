"""The conditioning of both denoisers on timestep and text, and classifier-free guidance (GMD
appendix D)."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

TEXT_FEATURES = 512
"""Width of the text encoder's pooled output."""

Denoiser = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`(x_t [B, D, T], timesteps [B], text_features [B, 512])` to `[B, D, T]`."""


def sinusoid_rows(positions: Tensor, width: int) -> Tensor:
    """`sin(p f_i)` in column `2i` and `cos(p f_i)` in column `2i + 1`, with
    `f_i = 10000^(-2i / width)`: `[N]` to `[N, width]`, in float64."""
    even = torch.arange(0, width, 2, dtype=torch.float64, device=positions.device)
    angles = positions.double()[:, None] * torch.exp(-math.log(10000.0) / width * even)
    return torch.stack([angles.sin(), angles.cos()], dim=2).flatten(1)


class TimestepEmbedding(nn.Module):
    """The timestep's sinusoid through two linears."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width
        self.time_embed = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, timesteps: Tensor) -> Tensor:
        """`[B]` to `[B, width]`."""
        rows = sinusoid_rows(timesteps, self.width)
        return self.time_embed(rows.to(self.time_embed[0].weight.dtype))


def guided(
    denoiser: Denoiser, x_t: Tensor, timesteps: Tensor, text_features: Tensor, scale: Tensor
) -> Tensor:
    """`uncond + scale (cond - uncond)`, a `scale [B]` for each sample. Zero features mean no
    text."""
    cond = denoiser(x_t, timesteps, text_features)
    uncond = denoiser(x_t, timesteps, torch.zeros_like(text_features))
    return uncond + scale[:, None, None] * (cond - uncond)
