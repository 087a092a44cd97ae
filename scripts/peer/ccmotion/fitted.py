"""A small denoiser fitted for a few seconds, whose samples can be compared.

With random weights, a sampler that clips is chaotic: float32 and float64 diverge within 20 steps.
With a network that has learned to predict noise, they agree.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from .diffusion import NoiseSchedule
from .reference import config
from .unet1d import AUDIO_CHANNELS, MOTION_CHANNELS, UNet1d

SIZES = {
    "base": 32,
    "mult": [1, 1],
    "nres": 2,
    "attn_levels": [1],
    "heads": 8,
    "cond_dim": AUDIO_CHANNELS,
    "time_dim": 32,
    "ctx_dim": 16,
}
"""As in a file's metadata. Two levels are enough for a sampler."""

STEPS = 300
BATCH = 16
FRAMES = 16
LEARNING_RATE = 2e-3
WITHOUT_CONDITION = 0.3
"""Share of samples whose condition is zeros, so that guidance has both of its predictions."""


def fitted(seed: int) -> dict[str, Tensor]:
    """Weights that predict the noise in motion that follows its condition, in all three processes
    of 08_ddim."""
    torch.manual_seed(seed)
    unet = UNet1d(config(SIZES))
    optimizer = torch.optim.Adam(unet.parameters(), LEARNING_RATE)
    schedules = [NoiseSchedule.cosine(), NoiseSchedule.linear(), NoiseSchedule.linear(50)]
    follow = torch.randn(AUDIO_CHANNELS, MOTION_CHANNELS) / AUDIO_CHANNELS**0.5
    for i in range(STEPS):
        schedule = schedules[i % len(schedules)]
        cond = torch.randn(BATCH, AUDIO_CHANNELS, FRAMES)
        drift = cond.cumsum(dim=2) / FRAMES**0.5
        motion = torch.einsum("bct,cd->bdt", drift, follow).tanh()
        timesteps = torch.randint(schedule.num_train_timesteps, (BATCH,))
        noise = torch.randn_like(motion)
        x_t = schedule.add_noise(motion, noise, timesteps)
        cond = cond * (torch.rand(BATCH, 1, 1) >= WITHOUT_CONDITION)
        loss = F.mse_loss(unet(x_t, timesteps, cond), noise)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return {name: values.clone() for name, values in unet.state_dict().items()}
