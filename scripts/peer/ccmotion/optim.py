"""The update of a training step (docs/sources.md, section 1.10)."""

import torch
from torch import nn


def adamw(rates: list[tuple[nn.Module, float]], weight_decay: float) -> torch.optim.AdamW:
    """AdamW with a learning rate for each network, in PyTorch's fastest form."""
    groups = [{"params": network.parameters(), "lr": rate} for network, rate in rates]
    return torch.optim.AdamW(groups, weight_decay=weight_decay, fused=True)


def update(model: nn.Module, optimizer: torch.optim.Optimizer, max_grad_norm: float | None) -> None:
    """Clips the gradients by their global norm, updates the parameters, forgets the gradients."""
    if max_grad_norm is not None:
        nn.utils.clip_grad_norm_(model.parameters(), max_grad_norm)
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)


@torch.no_grad()
def average(shadow: nn.Module, model: nn.Module, decay: float) -> None:
    """Moves the parameters of the averaged copy `shadow` by `1 - decay` of their distance to the
    model's."""
    torch._foreach_lerp_(list(shadow.parameters()), list(model.parameters()), 1.0 - decay)
