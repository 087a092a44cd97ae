"""Temporal losses on decoded motion `[B, T, 25]` (docs/sources.md, section 1.7)."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

FPS = 30.0
POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ACCELERATION = slice(6, 9)
QUATERNION = slice(9, 13)
PHASE = 16


@dataclass
class TemporalLosses:
    """The five terms, their weights 1, 10, 5, 2 and 1 included; each is a scalar."""

    jerk: Tensor
    velocity_coherence: Tensor
    accel_coherence: Tensor
    quat_delta: Tensor
    phase_monotonic: Tensor

    @property
    def total(self) -> Tensor:
        """Their sum."""
        return (
            self.jerk
            + self.velocity_coherence
            + self.accel_coherence
            + self.quat_delta
            + self.phase_monotonic
        )


def temporal_losses(motion: Tensor) -> TemporalLosses:
    """All terms for `motion [B, T, 25]`."""
    velocity, acceleration = motion[..., VELOCITY], motion[..., ACCELERATION]
    return TemporalLosses(
        jerk=jerk(acceleration),
        velocity_coherence=10.0 * coherence(motion[..., POSITION], velocity, 5.0),
        accel_coherence=5.0 * coherence(velocity, acceleration, 100.0),
        quat_delta=2.0 * quat_delta(motion[..., QUATERNION]),
        phase_monotonic=phase_monotonic(motion[..., PHASE]),
    )


def jerk(acceleration: Tensor) -> Tensor:
    """Mean squared norm of the jerk, in units of 50000.

    Squares are summed without taking the norm first: the gradient of a norm is not a number
    where two accelerations are equal.
    """
    return (change(acceleration) / 50000.0).square().sum(dim=-1).mean()


def coherence(quantity: Tensor, derivative: Tensor, scale: float) -> Tensor:
    """Mean square of `derivative` minus the forward difference of `quantity`, over `scale`."""
    return ((derivative[:, :-1] - change(quantity)) / scale).square().mean()


def quat_delta(quaternion: Tensor) -> Tensor:
    """Violation of `|q . q'| >= 0.95` by consecutive rotations."""
    dot = (quaternion[:, 1:] * quaternion[:, :-1]).sum(dim=-1)
    return torch.relu(0.95 - dot.abs()).mean()


def phase_monotonic(phase: Tensor) -> Tensor:
    """Drops of `phase [B, T]` beyond one half, summed over time."""
    return torch.relu(-phase.diff(dim=1) - 0.5).sum(dim=1).mean()


def change(quantity: Tensor) -> Tensor:
    """Forward difference per second: `[B, T, C]` to `[B, T - 1, C]`."""
    return FPS * quantity.diff(dim=1)


def position_loss(decoded: Tensor, motion: Tensor) -> Tensor:
    """Mean squared error of the positions."""
    return F.mse_loss(decoded[..., POSITION], motion[..., POSITION])


def quaternion_loss(decoded: Tensor, motion: Tensor) -> Tensor:
    """Mean squared error of the quaternions."""
    return F.mse_loss(decoded[..., QUATERNION], motion[..., QUATERNION])
