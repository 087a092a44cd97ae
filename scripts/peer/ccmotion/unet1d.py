"""The denoiser: a UNet over time, conditioned on the timestep and on audio features.

Follows the diagrams of CC-MotionGen, sections 3.1.1 to 3.1.4 (docs/sources.md, section 1.5), and
uses its state-dict names. There is no dropout: the peer is compared with dropout off.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ccmotion.aligned import AudioEncoder, rotate

MOTION_CHANNELS = 25
AUDIO_CHANNELS = 163
GROUPS = 32
HEADS = 8


@dataclass(frozen=True)
class UNetConfig:
    """Sizes of a network; the defaults are kinegrad's `small`, 16,342,361 parameters."""

    base: int = 64
    mult: tuple[int, ...] = (1, 2, 4, 8)
    time_dim: int = 256
    ctx_dim: int = 256
    aligned: bool = False
    """True if each level is conditioned on its own frames, instead of the set of all."""

    def heard(self, level: int) -> int:
        """Channels of a level's audio condition."""
        return min(self.base * self.mult[level], self.ctx_dim) if self.aligned else self.ctx_dim


def sinusoidal(timesteps: Tensor, dim: int) -> Tensor:
    """`[cos(t f_i) | sin(t f_i)]` with `f_i = 10000^(-i / (dim / 2))`: `[B]` to `[B, dim]`."""
    half = dim // 2
    exponents = torch.arange(half, dtype=torch.float64, device=timesteps.device) / half
    angles = timesteps.double()[:, None] * torch.exp(-math.log(10000.0) * exponents)
    return torch.cat([angles.cos(), angles.sin()], dim=1)


class ResBlock(nn.Module):
    """Two convolutions with FiLM from the time embedding between them."""

    def __init__(self, in_channels: int, out_channels: int, time_dim: int) -> None:
        super().__init__()
        self.norm1 = nn.GroupNorm(GROUPS, in_channels)
        self.conv1 = nn.Conv1d(in_channels, out_channels, 3, padding=1)
        self.time_mlp = nn.Sequential(nn.SiLU(), nn.Linear(time_dim, 2 * out_channels))
        self.norm2 = nn.GroupNorm(GROUPS, out_channels)
        self.conv2 = nn.Conv1d(out_channels, out_channels, 3, padding=1)
        if in_channels != out_channels:
            self.skip_conv = nn.Conv1d(in_channels, out_channels, 1)
        else:
            self.skip_conv = None

    def forward(self, x: Tensor, time_emb: Tensor) -> Tensor:
        """`x [B, in, T]`, `time_emb [B, time_dim]`; returns `[B, out, T]`."""
        h = self.conv1(F.silu(self.norm1(x)))
        scale, shift = self.time_mlp(time_emb)[:, :, None].chunk(2, dim=1)
        h = self.norm2(h) * (1 + scale) + shift
        h = self.conv2(F.silu(h))
        return h + (x if self.skip_conv is None else self.skip_conv(x))


class AttentionBlock(nn.Module):
    """Self-attention over frames, then cross-attention to the audio context, both residual."""

    def __init__(self, channels: int, ctx_dim: int, *, positions: bool) -> None:
        super().__init__()
        self.positions = positions
        self.norm = nn.GroupNorm(GROUPS, channels)
        self.qkv = nn.Conv1d(channels, 3 * channels, 1)
        self.proj = nn.Conv1d(channels, channels, 1)
        self.cross_norm = nn.GroupNorm(GROUPS, channels)
        self.q_cross = nn.Conv1d(channels, channels, 1)
        self.kv_cross = nn.Conv1d(ctx_dim, 2 * channels, 1)
        self.proj_cross = nn.Conv1d(channels, channels, 1)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """`x [B, C, T]`, `context [B, ctx_dim, S]`; returns `[B, C, T]`."""
        query, key, value = self.qkv(self.norm(x)).chunk(3, dim=1)
        x = x + self.proj(attention(query, key, value))
        query = self.q_cross(self.cross_norm(x))
        key, value = self.kv_cross(context).chunk(2, dim=1)
        if self.positions:
            query, key = rotate(query, HEADS), rotate(key, HEADS)
        return x + self.proj_cross(attention(query, key, value))


def attention(query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    """Softmax attention in 8 heads: `query [B, C, T]`, `key` and `value [B, C, S]`.

    The fused CPU kernel wants the channels of a head next to each other in memory; with a
    transposed view PyTorch would fall back to its unfused form.
    """

    def heads(x: Tensor) -> Tensor:
        batch, channels, length = x.shape
        return x.reshape(batch, HEADS, channels // HEADS, length).transpose(2, 3).contiguous()

    mixed = F.scaled_dot_product_attention(heads(query), heads(key), heads(value))
    return mixed.transpose(2, 3).reshape(query.shape)


class EncoderLevel(nn.Module):
    """Two residual blocks, attention below the first level, and a strided convolution."""

    def __init__(
        self, config: UNetConfig, level: int, in_channels: int, channels: int, *, last: bool
    ) -> None:
        super().__init__()
        self.res = nn.ModuleList(
            [
                ResBlock(in_channels, channels, config.time_dim),
                ResBlock(channels, channels, config.time_dim),
            ]
        )
        self.audio = nn.Conv1d(config.heard(level), in_channels, 1) if config.aligned else None
        self.attn = (
            None
            if level == 0
            else AttentionBlock(channels, config.heard(level), positions=config.aligned)
        )
        self.down = None if last else nn.Conv1d(channels, channels, 3, stride=2, padding=1)

    def forward(self, h: Tensor, time_emb: Tensor, context: Tensor) -> Tensor:
        """The level's skip; `down` is applied by the network."""
        for block in self.res:
            h = block(h, time_emb)
        return h if self.attn is None else self.attn(h, context)


class Bottleneck(nn.Module):
    """Residual block, attention, residual block."""

    def __init__(self, config: UNetConfig, channels: int) -> None:
        super().__init__()
        self.res1 = ResBlock(channels, channels, config.time_dim)
        heard = config.heard(len(config.mult) - 1)
        self.attn = AttentionBlock(channels, heard, positions=config.aligned)
        self.res2 = ResBlock(channels, channels, config.time_dim)

    def forward(self, h: Tensor, time_emb: Tensor, context: Tensor) -> Tensor:
        return self.res2(self.attn(self.res1(h, time_emb), context), time_emb)


class DecoderLevel(nn.Module):
    """Concatenation with a skip, then two residual blocks (first and last level) or one with
    attention; then nearest-neighbour upsampling to the next skip and a convolution."""

    def __init__(
        self, config: UNetConfig, level: int, in_channels: int, channels: int, *, last: bool
    ) -> None:
        super().__init__()
        first = level == 0
        self.res = nn.ModuleList([ResBlock(in_channels, channels, config.time_dim)])
        if first or last:
            self.res.append(ResBlock(channels, channels, config.time_dim))
            self.attn = None
        else:
            heard = config.heard(level)
            self.attn = AttentionBlock(channels, heard, positions=config.aligned)
        joins = config.aligned and not last
        self.audio = nn.Conv1d(config.heard(level), in_channels // 2, 1) if joins else None
        self.up = None if first else nn.Conv1d(channels, channels, 3, padding=1)

    def forward(
        self, h: Tensor, skip: Tensor, next_length: int, time_emb: Tensor, context: Tensor
    ) -> Tensor:
        h = torch.cat([h, skip], dim=1)
        for block in self.res:
            h = block(h, time_emb)
        if self.attn is not None:
            h = self.attn(h, context)
        if self.up is not None:
            h = self.up(F.interpolate(h, size=next_length, mode="nearest"))
        return h


class UNet1d(nn.Module):
    """The network; see the module's docstring."""

    def __init__(self, config: UNetConfig) -> None:
        super().__init__()
        self.config = config
        widths = [config.base * m for m in config.mult]
        last = len(widths) - 1
        self.time_embed = nn.Sequential(
            nn.Linear(config.time_dim, config.time_dim),
            nn.SiLU(),
            nn.Linear(config.time_dim, config.time_dim),
        )
        if config.aligned:
            heard = [config.heard(level) for level in range(len(widths))]
            self.audio_proj, self.audio = None, AudioEncoder(AUDIO_CHANNELS, heard)
        else:
            self.audio_proj, self.audio = nn.Linear(AUDIO_CHANNELS, config.ctx_dim), None
        self.input_conv = nn.Conv1d(MOTION_CHANNELS, widths[0], 3, padding=1)
        self.enc = nn.ModuleList(
            EncoderLevel(config, i, widths[max(i - 1, 0)], width, last=i == last)
            for i, width in enumerate(widths)
        )
        self.mid = Bottleneck(config, widths[-1])
        # Level i receives the width of level i + 1's output, which is widths[i].
        self.dec = nn.ModuleList(
            DecoderLevel(config, i, 2 * width, widths[max(i - 1, 0)], last=i == last)
            for i, width in enumerate(widths)
        )
        self.output_conv = nn.Conv1d(widths[0], MOTION_CHANNELS, 3, padding=1)

    def forward(self, x: Tensor, timesteps: Tensor, cond: Tensor) -> Tensor:
        """`x [B, 25, T]`, `timesteps [B]`, `cond [B, 163, T]`; returns `[B, 25, T]`."""
        time_emb = self.time_embed(sinusoidal(timesteps, self.config.time_dim).to(x.dtype))
        if self.audio is None:
            context = self.audio_proj(cond.transpose(1, 2)).transpose(1, 2)
            heard = [context] * len(self.enc)
        else:
            heard = self.audio(cond)
        h = self.input_conv(x)
        skips = []
        for i, level in enumerate(self.enc):
            if level.audio is not None:
                h = h + level.audio(heard[i])
            h = level(h, time_emb, heard[i])
            skips.append(h)
            if level.down is not None:
                h = level.down(h)
        h = self.mid(h, time_emb, heard[-1])
        for i in reversed(range(len(self.dec))):
            next_length = skips[max(i - 1, 0)].shape[-1]
            h = self.dec[i](h, skips[i], next_length, time_emb, heard[i])
            if i > 0 and self.dec[i - 1].audio is not None:
                h = h + self.dec[i - 1].audio(heard[i - 1])
        return self.output_conv(h)
