"""The motion decoder: from a latent to a motion in physical units, frame by frame
(CC-MotionGen, section 3.3; docs/sources.md, section 1.6)."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .unet1d import MOTION_CHANNELS

MAX_SPEED = 20.0


class FeedForward(nn.Module):
    """`h + Linear(GELU(Linear(LayerNorm(h))))`, four times as wide inside."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(hidden),
            nn.Linear(hidden, 4 * hidden),
            nn.GELU(),
            nn.Identity(),  # where CC-MotionGen has its dropout; keeps the state-dict names
            nn.Linear(4 * hidden, hidden),
        )

    def forward(self, h: Tensor) -> Tensor:
        return h + self.layers(h)


class MotionDecoder(nn.Module):
    """Residual blocks and one head for each quantity of a frame."""

    def __init__(self, hidden: int = 256, blocks: int = 3) -> None:
        super().__init__()
        self.input_proj = nn.Linear(MOTION_CHANNELS, hidden)
        self.blocks = nn.ModuleList(FeedForward(hidden) for _ in range(blocks))
        self.position_head = nn.Linear(hidden, 3)
        self.velocity_head = nn.Linear(hidden, 3)
        self.acceleration_head = nn.Linear(hidden, 3)
        self.quaternion_head = nn.Linear(hidden, 4)
        self.angular_velocity_head = nn.Linear(hidden, 3)
        self.phase_head = nn.Linear(hidden, 1)
        self.style_head = nn.Linear(hidden, 8)

    def forward(self, x: Tensor) -> Tensor:
        """`x [B, T, 25]`; returns `[B, T, 25]` in the order of the channels."""
        h = self.input_proj(x)
        for block in self.blocks:
            h = block(h)
        return torch.cat(
            [
                self.position_head(h),
                MAX_SPEED * torch.tanh(self.velocity_head(h)),
                self.acceleration_head(h),
                F.normalize(self.quaternion_head(h), dim=-1, eps=1e-12),
                self.angular_velocity_head(h),
                torch.sigmoid(self.phase_head(h)),
                self.style_head(h),
            ],
            dim=-1,
        )
