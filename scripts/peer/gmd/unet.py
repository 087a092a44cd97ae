"""The 1D UNet with adaptive group normalisation (GMD appendix D, table D.1, figures D.1 and D.2).

Uses the names of the published checkpoints. Kernels: 5 in blocks, 1 in shortcuts and at the end, 3
for downsampling, 4 for upsampling. The last level's skip is concatenated right after the middle,
and the first level's is not used.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

GROUPS = 8


@dataclass(frozen=True)
class UNetConfig:
    """Sizes of a network; the defaults are those of the published motion model."""

    motion_channels: int = 263
    width: int = 512
    """Width of the conditioning inside the network; levels are multiples of it."""
    multipliers: tuple[float, ...] = (2, 2, 2, 2)
    cond_dim: int = 512
    """Width of the input conditioning."""
    adagn: bool = True
    """Scale and shift from the conditioning after the first norm; without, a shift after the first
    activation."""
    zero_init: bool = True
    """AdaGN linears, second convolutions and the very last convolution start at zero, so that the
    network's first answer is zero."""

    @property
    def channels(self) -> list[int]:
        """Of each level, the finest first."""
        return [int(self.width * multiplier) for multiplier in self.multipliers]


def conv_norm(in_channels: int, out_channels: int) -> list[nn.Module]:
    """Convolution and norm; the identity keeps the names."""
    return [
        nn.Conv1d(in_channels, out_channels, 5, padding=2),
        nn.Identity(),
        nn.GroupNorm(GROUPS, out_channels),
    ]


class ConvBlock(nn.Module):
    """Convolution, norm, Mish."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.block = nn.Sequential(*conv_norm(in_channels, out_channels), nn.Mish())

    def forward(self, x: Tensor) -> Tensor:
        return self.block(x)


class AdaptiveConvBlock(nn.Module):
    """Convolution, norm, scale and shift, Mish."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.block1 = nn.Sequential(*conv_norm(in_channels, out_channels))
        self.block2 = nn.Mish()

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        return self.block2(self.block1(x) * (1 + scale) + shift)


class ResBlock(nn.Module):
    """Two convolutions, the first one conditioned; nothing follows the addition."""

    def __init__(self, config: UNetConfig, in_channels: int, out_channels: int) -> None:
        super().__init__()
        first = AdaptiveConvBlock if config.adagn else ConvBlock
        self.adagn = config.adagn
        self.blocks = nn.ModuleList(
            [first(in_channels, out_channels), ConvBlock(out_channels, out_channels)]
        )
        conditioned = 2 * out_channels if config.adagn else out_channels
        self.time_mlp = nn.Sequential(nn.Mish(), nn.Linear(config.width, conditioned))
        if in_channels != out_channels:
            self.residual_conv = nn.Conv1d(in_channels, out_channels, 1)
        else:
            self.residual_conv = nn.Identity()
        if config.zero_init:
            if config.adagn:
                set_zero(self.time_mlp[1])
            set_zero(self.blocks[1].block[0])

    def forward(self, x: Tensor, cond: Tensor) -> Tensor:
        """`x [B, in, T]`, `cond [B, width]`; returns `[B, out, T]`."""
        cond = self.time_mlp(cond)[:, :, None]
        if self.adagn:
            scale, shift = cond.chunk(2, dim=1)
            h = self.blocks[0](x, scale, shift)
        else:
            h = self.blocks[0](x) + cond
        return self.blocks[1](h) + self.residual_conv(x)


class Resample(nn.Module):
    """A convolution that halves or doubles the length."""

    def __init__(self, conv: nn.Module) -> None:
        super().__init__()
        self.conv = conv

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(x)


def level(
    config: UNetConfig, in_channels: int, out_channels: int, resample: nn.Module
) -> nn.Module:
    """Two residual blocks and the change of length; the identity is in place of attention."""
    return nn.ModuleList(
        [
            ResBlock(config, in_channels, out_channels),
            ResBlock(config, out_channels, out_channels),
            nn.Identity(),
            resample,
        ]
    )


class UNet(nn.Module):
    """The network; see the module's docstring."""

    def __init__(self, config: UNetConfig) -> None:
        super().__init__()
        self.config = config
        channels = config.channels
        self.time_mlp = nn.Sequential(
            nn.Linear(config.cond_dim, 4 * config.width),
            nn.Mish(),
            nn.Linear(4 * config.width, config.width),
        )
        inputs = [config.motion_channels, *channels[:-1]]
        halve = [Resample(nn.Conv1d(c, c, 3, stride=2, padding=1)) for c in channels[:-1]]
        self.downs = nn.ModuleList(
            level(config, *sizes)
            for sizes in zip(inputs, channels, [*halve, nn.Identity()], strict=True)
        )
        self.mid_block1 = ResBlock(config, channels[-1], channels[-1])
        self.mid_block2 = ResBlock(config, channels[-1], channels[-1])
        self.ups = nn.ModuleList(
            level(config, 2 * c, finer, Resample(nn.ConvTranspose1d(finer, finer, 4, 2, padding=1)))
            for finer, c in reversed(list(zip(channels[:-1], channels[1:], strict=True)))
        )
        self.final_conv = nn.Sequential(
            ConvBlock(channels[0], channels[0]),
            nn.Conv1d(channels[0], config.motion_channels, 1),
        )
        if config.zero_init:
            set_zero(self.final_conv[1])

    def forward(self, x: Tensor, cond: Tensor) -> Tensor:
        """`x [B, motion_channels, T]`, `cond [B, cond_dim]`; returns the shape of `x`.

        T is a multiple of 2 to the number of levels less one.
        """
        cond = self.time_mlp(cond)
        skips = []
        for first, second, _, halve in self.downs:
            x = second(first(x, cond), cond)
            skips.append(x)
            x = halve(x)
        x = self.mid_block2(self.mid_block1(x, cond), cond)
        for first, second, _, double in self.ups:
            x = torch.cat([x, skips.pop()], dim=1)
            x = double(second(first(x, cond), cond))
        return self.final_conv(x)


def set_zero(layer: nn.Module) -> None:
    """Weight and bias."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
