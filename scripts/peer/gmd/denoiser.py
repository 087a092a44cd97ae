"""The complete model around the UNet: timestep, text, and padding to a fixed length (GMD appendix
D)."""

from torch import Tensor, nn
from torch.nn import functional as F

from .conditioning import TEXT_FEATURES, TimestepEmbedding
from .unet import UNet, UNetConfig

PADDED_FRAMES = 224


class UNetDenoiser(nn.Module):
    """The UNet conditioned on the sum of embedded timestep and embedded text."""

    def __init__(self, config: UNetConfig, padded_frames: int = PADDED_FRAMES) -> None:
        super().__init__()
        self.padded_frames = padded_frames
        self.embed_timestep = TimestepEmbedding(config.cond_dim)
        self.embed_text = nn.Linear(TEXT_FEATURES, config.cond_dim)
        self.unet = UNet(config)

    def forward(self, x_t: Tensor, timesteps: Tensor, text_features: Tensor) -> Tensor:
        """`x_t [B, D, T]`, `timesteps [B]`, `text_features [B, 512]`; returns `[B, D, T]`.

        Frames beyond T are zeros to the network, which sees no mask.
        """
        emb = self.embed_timestep(timesteps) + self.embed_text(text_features)
        frames = x_t.shape[2]
        padded = F.pad(x_t, (0, self.padded_frames - frames))
        return self.unet(padded, emb)[:, :, :frames]
