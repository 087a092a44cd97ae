"""Noise schedule, DDIM step and the differentiable rollout of a sampler (CC-MotionGen,
sections 3.2, 5.2 and 7.3; docs/sources.md, sections 1.2, 1.3 and 1.8).

With `abar` for `alphas_cumprod`, and with eta = 0 and no clipping:

    x_t  = sqrt(abar_t) x_start + sqrt(1 - abar_t) noise
    x_t' = sqrt(abar_t') pred_original_sample + sqrt(1 - abar_t') pred_epsilon
"""

import math
from collections.abc import Callable
from enum import Enum

import numpy as np
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

Denoiser = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`(x_t [B, 25, T], timesteps [B], cond [B, 163, T])` to `[B, 25, T]`."""


class PredictionType(Enum):
    """The prediction type."""

    EPSILON = "epsilon"
    SAMPLE = "sample"
    V_PREDICTION = "v_prediction"


class RolloutMode(Enum):
    """Which activations of a rollout are kept for the backward pass."""

    FULL = "full"
    """All of every step: PyTorch's ordinary graph."""
    CHECKPOINTED = "checkpointed"
    """Only the state between steps; each step is computed again in the backward pass."""
    LAST_K = "last_k"
    """All of the last k steps; no gradient passes through the earlier ones."""


class NoiseSchedule:
    """Tables over the timesteps 0..T in float64; a value is rounded once, at its use."""

    def __init__(self, betas: np.ndarray) -> None:
        abar = np.cumprod(1.0 - betas)
        self.sqrt_abar: np.ndarray = np.sqrt(abar)
        self.sqrt_one_minus_abar: np.ndarray = np.sqrt(1.0 - abar)
        self._on_device: dict[torch.device, tuple[Tensor, Tensor]] = {}

    @classmethod
    def cosine(
        cls, num_train_timesteps: int = 1000, beta_min: float = 1e-4, beta_max: float = 0.9999
    ) -> "NoiseSchedule":
        """`abar` falls as `cos^2`; betas are clipped to `[beta_min, beta_max]`."""

        def signal(u: np.ndarray) -> np.ndarray:
            return np.cos(math.pi / 2 * (u + 0.008) / 1.008) ** 2

        u = np.arange(num_train_timesteps + 1) / num_train_timesteps
        return cls(np.clip(1.0 - signal(u[1:]) / signal(u[:-1]), beta_min, beta_max))

    @classmethod
    def linear(cls, num_train_timesteps: int = 1000) -> "NoiseSchedule":
        """Betas equidistant from 1e-4 to 0.02, whatever their number."""
        return cls(np.linspace(1e-4, 0.02, num_train_timesteps))

    @property
    def num_train_timesteps(self) -> int:
        """T."""
        return len(self.sqrt_abar)

    def add_noise(self, x_start: Tensor, noise: Tensor, timesteps: Tensor) -> Tensor:
        """`x_t`, for a timestep per sample."""
        signal, sigma = self._per_sample(timesteps, x_start)
        return signal * x_start + sigma * noise

    def target(
        self, x_start: Tensor, noise: Tensor, timesteps: Tensor, prediction_type: PredictionType
    ) -> Tensor:
        """The target of the network at `x_t`."""
        match prediction_type:
            case PredictionType.EPSILON:
                return noise
            case PredictionType.SAMPLE:
                return x_start
            case PredictionType.V_PREDICTION:
                signal, sigma = self._per_sample(timesteps, x_start)
                return signal * noise - sigma * x_start

    def _per_sample(self, timesteps: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
        # Stays on the device: a copy in each step would make the host wait for a GPU.
        if like.device not in self._on_device:
            signal, sigma = map(torch.from_numpy, (self.sqrt_abar, self.sqrt_one_minus_abar))
            self._on_device[like.device] = (signal.to(like.device), sigma.to(like.device))
        signal, sigma = (
            table[timesteps].to(like.dtype)[:, None, None] for table in self._on_device[like.device]
        )
        return signal, sigma


def rollout_timesteps(num_train_timesteps: int, steps: int) -> list[int]:
    """`floor((T - 1) (K - 1 - i) / (K - 1))` for i = 0..K: from T - 1 down to 0."""
    if steps < 2:
        raise ValueError(f"a rollout takes at least 2 steps, not {steps}")
    last = steps - 1
    return [(num_train_timesteps - 1) * (last - i) // last for i in range(steps)]


def ddim_step(
    schedule: NoiseSchedule,
    prediction_type: PredictionType,
    model_output: Tensor,
    x: Tensor,
    timestep: int,
    next_timestep: int | None,
) -> Tensor:
    """From `x_t` to the next timestep, or to clean motion if that is None."""
    signal = float(schedule.sqrt_abar[timestep])
    sigma = float(schedule.sqrt_one_minus_abar[timestep])
    match prediction_type:
        case PredictionType.EPSILON:
            pred_epsilon = model_output
            pred_original_sample = (x - sigma * model_output) / signal
        case PredictionType.SAMPLE:
            pred_epsilon = (x - signal * model_output) / sigma
            pred_original_sample = model_output
        case PredictionType.V_PREDICTION:
            pred_epsilon = signal * model_output + sigma * x
            pred_original_sample = signal * x - sigma * model_output
    if next_timestep is None:
        return pred_original_sample
    next_signal = float(schedule.sqrt_abar[next_timestep])
    next_sigma = float(schedule.sqrt_one_minus_abar[next_timestep])
    return next_signal * pred_original_sample + next_sigma * pred_epsilon


def rollout(
    denoiser: Denoiser,
    schedule: NoiseSchedule,
    prediction_type: PredictionType,
    x: Tensor,
    cond: Tensor,
    steps: int,
    mode: RolloutMode,
    last_k: int = 1,
) -> Tensor:
    """Samples in `steps` DDIM steps from noise `x [B, 25, T]`, with gradients according to
    `mode`."""
    timesteps = rollout_timesteps(schedule.num_train_timesteps, steps)

    def step(x: Tensor, index: int) -> Tensor:
        timestep = timesteps[index]
        next_timestep = timesteps[index + 1] if index + 1 < steps else None
        model_output = denoiser(x, torch.full((len(x),), timestep, device=x.device), cond)
        return ddim_step(schedule, prediction_type, model_output, x, timestep, next_timestep)

    for index in range(steps):
        match mode:
            case RolloutMode.FULL:
                x = step(x, index)
            case RolloutMode.CHECKPOINTED:
                # No dropout in the network, so there is no random state to restore.
                x = checkpoint(step, x, index, use_reentrant=False, preserve_rng_state=False)
            case RolloutMode.LAST_K:
                with torch.set_grad_enabled(index >= steps - last_k):
                    x = step(x, index)
    return x
