"""The transformer of the Human Motion Diffusion Model (<https://arxiv.org/abs/2209.14916>, section
3 and figure 2), GMD's baseline.

One token with timestep and text precedes the frames; its output is dropped. Layers are post-norm.
There is no dropout and no mask.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .conditioning import TEXT_FEATURES, TimestepEmbedding, sinusoid_rows


@dataclass(frozen=True)
class TransformerConfig:
    """Sizes of a network; the defaults are those of the published text-to-motion model."""

    motion_channels: int = 263
    latent_dim: int = 512
    heads: int = 4
    feed_forward: int = 1024
    layers: int = 8


class InputProcess(nn.Module):
    """A token from each frame."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.poseEmbedding = nn.Linear(config.motion_channels, config.latent_dim)

    def forward(self, x_t: Tensor) -> Tensor:
        """`[B, D, T]` to `[B, T, latent_dim]`."""
        return self.poseEmbedding(x_t.transpose(1, 2))


class OutputProcess(nn.Module):
    """A frame from each token."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.poseFinal = nn.Linear(config.latent_dim, config.motion_channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """`[B, T, latent_dim]` to `[B, D, T]`."""
        return self.poseFinal(tokens).transpose(1, 2)


class TransformerDenoiser(nn.Module):
    """The network; see the module's docstring."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.config = config
        self.input_process = InputProcess(config)
        self.embed_timestep = TimestepEmbedding(config.latent_dim)
        self.embed_text = nn.Linear(TEXT_FEATURES, config.latent_dim)
        layer = nn.TransformerEncoderLayer(
            config.latent_dim,
            config.heads,
            config.feed_forward,
            dropout=0.0,
            activation="gelu",
            batch_first=True,
        )
        self.seqTransEncoder = nn.TransformerEncoder(
            layer, config.layers, enable_nested_tensor=False
        )
        self.output_process = OutputProcess(config)

    def tokens(self, x_t: Tensor, timesteps: Tensor, text_features: Tensor) -> Tensor:
        """The input of the first layer: the condition, then the frames, plus positions from 0 on:
        `[B, 1 + T, latent_dim]`."""
        emb = self.embed_timestep(timesteps) + self.embed_text(text_features)
        tokens = torch.cat([emb[:, None], self.input_process(x_t)], dim=1)
        positions = torch.arange(tokens.shape[1], device=tokens.device)
        return tokens + sinusoid_rows(positions, self.config.latent_dim).to(tokens.dtype)

    def forward(self, x_t: Tensor, timesteps: Tensor, text_features: Tensor) -> Tensor:
        """`x_t [B, D, T]`, `timesteps [B]`, `text_features [B, 512]`; returns `[B, D, T]`."""
        tokens = self.seqTransEncoder(self.tokens(x_t, timesteps, text_features))
        return self.output_process(tokens[:, 1:])
