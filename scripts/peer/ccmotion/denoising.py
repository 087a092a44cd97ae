"""One step of training a denoiser on noised motion (CC-MotionGen, sections 5.3 and 6.2;
docs/sources.md, section 1.4)."""

from dataclasses import dataclass, field

from torch import Tensor, nn
from torch.nn import functional as F

from .diffusion import NoiseSchedule, PredictionType
from .optim import adamw, update


@dataclass(frozen=True)
class DenoisingConfig:
    """Everything about the step that is not a tensor."""

    prediction_type: PredictionType = PredictionType.EPSILON
    schedule: NoiseSchedule = field(default_factory=NoiseSchedule.cosine)
    learning_rate: float = 1e-4
    weight_decay: float = 1e-4
    max_grad_norm: float | None = 1.0


class DenoisingTrainer:
    """A denoiser and AdamW."""

    def __init__(self, model: nn.Module, config: DenoisingConfig) -> None:
        self.model = model
        self.config = config
        self.optimizer = adamw([(model, config.learning_rate)], config.weight_decay)

    def step(self, motion: Tensor, cond: Tensor, timesteps: Tensor, noise: Tensor) -> float:
        """Trains on one batch, `[B, C, T]` but for `timesteps [B]`; returns the loss."""
        schedule, prediction_type = self.config.schedule, self.config.prediction_type
        x_t = schedule.add_noise(motion, noise, timesteps)
        target = schedule.target(motion, noise, timesteps, prediction_type)
        loss = F.mse_loss(self.model(x_t, timesteps, cond), target)
        loss.backward()
        update(self.model, self.optimizer, self.config.max_grad_norm)
        return float(loss.detach())
