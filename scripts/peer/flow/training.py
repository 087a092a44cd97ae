"""A training step of flow matching, and poses sampled by Euler's method."""

import copy

import torch
from ccmotion.optim import adamw, average, update
from torch import Tensor

from flow.network import FlowModel, previous_state


class Trainer:
    """Both networks, AdamW, and an averaged copy of the networks."""

    def __init__(
        self,
        model: FlowModel,
        learning_rate: float,
        weight_decay: float,
        max_grad_norm: float,
        ema_decay: float,
    ) -> None:
        self.model = model
        self.ema_model = copy.deepcopy(model).requires_grad_(False)
        self.optimizer = adamw([(model, learning_rate)], weight_decay)
        self.max_grad_norm, self.ema_decay = max_grad_norm, ema_decay

    def step(
        self,
        history: Tensor,
        text: Tensor,
        place: Tensor,
        pose: Tensor,
        noise: Tensor,
        times: Tensor,
    ) -> float:
        """Trains on windows: `history [B, T, 263]`, `text [B, 512]`, `place [B, 2]` (progress, duration),
        the next `pose` and `noise [B, J, 3]`, `times [B]`; returns the loss."""
        t = times[:, None, None]
        x_t = (1.0 - t) * noise + t * pose
        context = self.model.encoder(history, text, place[:, 1:])
        previous = previous_state(history[:, -1])
        velocity = self.model.predictor(x_t, times, context, previous, place[:, 0])
        loss = (velocity - (pose - noise)).square().mean()
        loss.backward()
        update(self.model, self.optimizer, self.max_grad_norm)
        average(self.ema_model, self.model, self.ema_decay)
        return float(loss.detach())


def drawn(
    model: FlowModel, history: Tensor, text: Tensor, place: Tensor, noise: Tensor, steps: int
) -> Tensor:
    """The next pose of each history, `[B, J, 3]`, in equal steps of Euler's method; arguments as of
    [`Trainer.step`]."""
    context = model.encoder(history, text, place[:, 1:])
    previous = previous_state(history[:, -1])
    x = noise
    for step in range(steps):
        t = torch.full_like(place[:, 0], step / steps)
        x = x + model.predictor(x, t, context, previous, place[:, 0]) / steps
    return x
