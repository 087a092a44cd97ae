"""Files of reference tensors, and a report of how far something is from them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor, nn


class Golden:
    """One file of reference tensors."""

    def __init__(self, folder: Path, name: str) -> None:
        with safe_open(folder / f"{name}.safetensors", "pt") as file:
            self.metadata: dict[str, str] = file.metadata()
            self.tensors: dict[str, Tensor] = {key: file.get_tensor(key) for key in file.keys()}

    def __getitem__(self, key: str) -> Tensor:
        return self.tensors[key]

    def under(self, prefix: str) -> dict[str, Tensor]:
        """All tensors whose key starts with `prefix`, by the rest of the key."""
        return {k[len(prefix) :]: v for k, v in self.tensors.items() if k.startswith(prefix)}

    def json(self, key: str) -> Any:
        """A metadata entry that is JSON."""
        return json.loads(self.metadata[key])


class Report:
    """The worst error of each group of comparisons."""

    def __init__(self) -> None:
        self.groups: dict[str, tuple[float, float, str, int]] = {}

    def compare(
        self, group: str, tolerance: float, name: str, ours: Tensor, reference: Tensor
    ) -> None:
        """Enters one comparison."""
        if ours.shape != reference.shape:
            raise SystemExit(f"check_golden: {group}: `{name}` has shape {tuple(ours.shape)}")
        scale = reference.abs().max().item()
        error = (ours.detach().double() - reference.double()).abs().max().item()
        self.enter(group, tolerance, name, error / scale if scale > 0 else error)

    def enter(self, group: str, tolerance: float, name: str, error: float) -> None:
        """Enters one error, already scaled."""
        worst, _, where, count = self.groups.get(group, (-1.0, tolerance, "", 0))
        if not error <= worst:  # also where it is not a number
            worst, where = error, name
        self.groups[group] = (worst, tolerance, where, count + 1)

    def print(self) -> bool:
        """Prints all groups; true if every one is within its tolerance."""
        print("| group | compared | largest error | tolerance | at | |\n|---|---|---|---|---|---|")
        for group, (worst, tolerance, where, count) in self.groups.items():
            verdict = "ok" if worst <= tolerance else "TOO LARGE"
            print(f"| {group} | {count} | {worst:.1e} | {tolerance:.0e} | {where} | {verdict} |")
        return all(worst <= tolerance for worst, tolerance, _, _ in self.groups.values())


def hashed_weights(golden: Golden, model: nn.Module) -> dict[str, Tensor]:
    """Weights made by the integer hash that the reference describes, with its three checks."""
    weights: dict[str, Tensor] = {}
    state = model.state_dict()
    seed = int(golden["check.hash_seed"])
    for position, name in enumerate(golden.json("param_order")):
        shape = state[name].shape
        first = (seed + position * 0x9E3779B9) % 2**32
        x = (np.arange(shape.numel(), dtype=np.uint32) + np.uint32(first)).astype(np.uint32)
        x ^= x >> np.uint32(16)
        x *= np.uint32(0x7FEB352D)
        x ^= x >> np.uint32(15)
        x *= np.uint32(0x846CA68B)
        x ^= x >> np.uint32(16)
        u = 2.0 * x.astype(np.float64) / 2.0**32 - 1.0
        if len(shape) >= 2:
            u /= np.sqrt(shape[1:].numel())
        elif name.endswith("weight"):
            u = 1.0 + 0.2 * u
        else:
            u *= 0.1
        weights[name] = torch.from_numpy(u.astype(np.float32)).reshape(shape)
    total = sum(w.double().sum().item() for w in weights.values())
    count = sum(w.numel() for w in weights.values())
    assert count == int(golden["check.num_parameters"])
    assert abs(total - float(golden["check.sum64_of_all_parameters"])) < 1e-6 * abs(total)
    assert (
        weights["output_conv.weight"].flatten()[-8:].equal(golden["check.last8.output_conv.weight"])
    )
    return weights
