"""One step of training a denoiser on clips of different lengths (GMD appendix C.1 and E)."""

import copy
from dataclasses import dataclass, field

import torch
from ccmotion.diffusion import NoiseSchedule, PredictionType
from ccmotion.optim import adamw, average, update
from torch import Tensor, nn

TRAJECTORY_CHANNELS = 4
"""Root rotation, ground position and height come first."""


def cosine_schedule() -> NoiseSchedule:
    """Value of the published models."""
    return NoiseSchedule.cosine(beta_min=0.0, beta_max=0.999)


def weighted_loss(
    prediction: Tensor, target: Tensor, mask: Tensor, trajectory_scale: float = 1.0
) -> Tensor:
    """The loss of each sample: `[B, D, T]` and `mask [B, 1, T]`, 1 where a frame counts, to `[B]`.

    A channel weighs k^2 among the trajectory's, else 1, over the sum of all weights; the weighted
    squares are summed over channels and averaged over the frames that count.
    """
    weights = torch.ones(prediction.shape[1], dtype=prediction.dtype, device=prediction.device)
    weights[:TRAJECTORY_CHANNELS] = trajectory_scale**2
    weights /= weights.sum()
    per_frame = torch.einsum("bdt,d->bt", (prediction - target).square(), weights)
    mask = mask[:, 0]
    return (per_frame * mask).sum(dim=1) / mask.sum(dim=1)


@dataclass(frozen=True)
class TrainingConfig:
    """Everything about the step that is not a tensor; the published values."""

    prediction_type: PredictionType
    """The motion model's is `SAMPLE`, the trajectory model's `EPSILON`."""
    schedule: NoiseSchedule = field(default_factory=cosine_schedule)
    trajectory_scale: float = 1.0
    """k."""
    learning_rate: float = 1e-4
    weight_decay: float = 1e-2
    max_grad_norm: float | None = 1.0
    ema_decay: float | None = 0.9999
    """None keeps no averaged copy."""


class Trainer:
    """A denoiser, AdamW, and an averaged copy of the denoiser."""

    def __init__(self, model: nn.Module, config: TrainingConfig) -> None:
        self.model = model
        self.config = config
        self.ema_model = None
        if config.ema_decay is not None:
            self.ema_model = copy.deepcopy(model).requires_grad_(False)
        self.optimizer = adamw([(model, config.learning_rate)], config.weight_decay)

    def step(
        self, motion: Tensor, mask: Tensor, text_features: Tensor, timesteps: Tensor, noise: Tensor
    ) -> float:
        """Trains on one batch, its clips padded with zeros; returns the loss.

        `motion` and `noise [B, D, T]`, `mask [B, 1, T]`, `text_features [B, 512]`, zero where the
        text was dropped, `timesteps [B]`.
        """
        schedule, prediction_type = self.config.schedule, self.config.prediction_type
        x_t = schedule.add_noise(motion, noise, timesteps)
        target = schedule.target(motion, noise, timesteps, prediction_type)
        prediction = self.model(x_t, timesteps, text_features)
        loss = weighted_loss(prediction, target, mask, self.config.trajectory_scale).mean()
        loss.backward()
        update(self.model, self.optimizer, self.config.max_grad_norm)
        if self.ema_model is not None:
            average(self.ema_model, self.model, self.config.ema_decay)
        return float(loss.detach())
