"""One step of end-to-end training: denoiser and decoder, through the sampler
(CC-MotionGen, sections 7.1 to 7.4; docs/sources.md, section 1.8)."""

import copy
from dataclasses import dataclass, field

from torch import Tensor, nn
from torch.nn import functional as F

from .decoder import MotionDecoder
from .diffusion import NoiseSchedule, PredictionType, RolloutMode, rollout
from .losses import TemporalLosses, position_loss, quaternion_loss, temporal_losses
from .optim import adamw, average, update
from .unet1d import UNet1d


@dataclass(frozen=True)
class EndToEndConfig:
    """Everything about the step that is not a tensor."""

    steps: int
    mode: RolloutMode = RolloutMode.CHECKPOINTED
    last_k: int = 1
    prediction_type: PredictionType = PredictionType.SAMPLE
    schedule: NoiseSchedule = field(default_factory=NoiseSchedule.cosine)
    diffusion_weight: float = 0.1
    decoder_weight: float = 1.0
    temporal_weight: float = 10.0
    unet_learning_rate: float = 1e-6
    decoder_learning_rate: float = 5e-5
    weight_decay: float = 1e-4
    max_grad_norm: float | None = None
    ema_decay: float | None = 0.9999
    """None keeps no averaged copy."""


@dataclass
class Batch:
    """Motion with all random numbers of the step."""

    motion: Tensor
    """`[B, 25, T]`"""
    cond: Tensor
    """`[B, 163, T]`"""
    timesteps: Tensor
    """`[B]`, of the diffusion loss"""
    noise: Tensor
    """`[B, 25, T]`, of the diffusion loss"""
    x_T: Tensor
    """`[B, 25, T]`, start of the rollout"""


@dataclass
class RolloutLosses:
    """Scalars that depend on the rollout, unweighted against each other."""

    decoded: Tensor
    """`[B, T, 25]`, the motion they were taken from"""
    position: Tensor
    quaternion: Tensor
    temporal: TemporalLosses


class EndToEndModel(nn.Module):
    """The two networks."""

    def __init__(self, unet: UNet1d, decoder: MotionDecoder) -> None:
        super().__init__()
        self.unet = unet
        self.decoder = decoder

    def diffusion_loss(self, batch: Batch, config: EndToEndConfig) -> Tensor:
        """Mean squared error of the network's prediction at `x_t`."""
        x_t = config.schedule.add_noise(batch.motion, batch.noise, batch.timesteps)
        target = config.schedule.target(
            batch.motion, batch.noise, batch.timesteps, config.prediction_type
        )
        return F.mse_loss(self.unet(x_t, batch.timesteps, batch.cond), target)

    def rollout_losses(self, batch: Batch, config: EndToEndConfig) -> RolloutLosses:
        """Losses of the decoded sample."""
        x = rollout(
            self.unet,
            config.schedule,
            config.prediction_type,
            batch.x_T,
            batch.cond,
            config.steps,
            config.mode,
            config.last_k,
        )
        decoded = self.decoder(x.transpose(1, 2))
        motion = batch.motion.transpose(1, 2)
        return RolloutLosses(
            decoded=decoded,
            position=position_loss(decoded, motion),
            quaternion=quaternion_loss(decoded, motion),
            temporal=temporal_losses(decoded),
        )


def backward(
    model: EndToEndModel, batch: Batch, config: EndToEndConfig
) -> tuple[Tensor, Tensor, RolloutLosses]:
    """Adds the gradient of the total to the parameters; returns total, diffusion loss, the rest."""
    diffusion = model.diffusion_loss(batch, config)
    losses = model.rollout_losses(batch, config)
    total = (
        config.diffusion_weight * diffusion
        + config.decoder_weight * (losses.position + losses.quaternion)
        + config.temporal_weight * losses.temporal.total
    )
    total.backward()
    return total, diffusion, losses


class Trainer:
    """Model, AdamW with a learning rate for each network, and an EMA copy of both."""

    def __init__(self, model: EndToEndModel, config: EndToEndConfig) -> None:
        self.model = model
        self.config = config
        self.ema_model = None
        if config.ema_decay is not None:
            self.ema_model = copy.deepcopy(model).requires_grad_(False)
        rates = [
            (model.unet, config.unet_learning_rate),
            (model.decoder, config.decoder_learning_rate),
        ]
        self.optimizer = adamw(rates, config.weight_decay)

    def step(self, batch: Batch) -> float:
        """Trains on one batch; returns the total loss."""
        total, _, _ = backward(self.model, batch, self.config)
        update(self.model, self.optimizer, self.config.max_grad_norm)
        if self.ema_model is not None:
            average(self.ema_model, self.model, self.config.ema_decay)
        return float(total.detach())
