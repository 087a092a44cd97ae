"""Aligned audio conditioning: each level of the denoiser is conditioned on its own frames.

The counterpart of kinegrad's `model.audio_conditioning = "aligned"`, with its state-dict names, for
batches without padding.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

GROUPS = 32
KERNEL = 5


class AudioLevel(nn.Module):
    """Halves the length below the first level, then a residual convolution."""

    def __init__(self, inputs: int, width: int, *, first: bool) -> None:
        super().__init__()
        self.down = None if first else nn.Conv1d(inputs, width, 3, stride=2, padding=1)
        self.norm = nn.GroupNorm(GROUPS, width)
        self.conv = nn.Conv1d(width, width, KERNEL, padding=KERNEL // 2)

    def forward(self, h: Tensor) -> Tensor:
        if self.down is not None:
            h = self.down(h)
        return h + self.conv(F.silu(self.norm(h)))


class AudioEncoder(nn.Module):
    """Features `[B, inputs, T]` to the condition of each level, `[B, width, ceil(T / 2^level)]`."""

    def __init__(self, inputs: int, widths: list[int]) -> None:
        super().__init__()
        self.stem = nn.Conv1d(inputs, widths[0], KERNEL, padding=KERNEL // 2)
        self.levels = nn.ModuleList(
            AudioLevel(widths[max(i - 1, 0)], width, first=i == 0) for i, width in enumerate(widths)
        )

    def forward(self, features: Tensor) -> list[Tensor]:
        h = self.stem(features)
        heard = []
        for level in self.levels:
            h = level(h)
            heard.append(h)
        return heard


def rotate(x: Tensor, heads: int) -> Tensor:
    """Rotary positions on the two halves of each head's channels: `[B, C, T]`."""
    batch, channels, length = x.shape
    half = channels // heads // 2
    frequencies = 10000.0 ** (-torch.arange(half, dtype=torch.float64, device=x.device) / half)
    angles = frequencies[:, None] * torch.arange(length, dtype=torch.float64, device=x.device)
    cos, sin = angles.cos().to(x.dtype), angles.sin().to(x.dtype)
    a, b = x.reshape(batch, heads, 2, half, length).unbind(2)
    turned = torch.stack([a * cos - b * sin, a * sin + b * cos], dim=2)
    return turned.reshape(batch, channels, length)
