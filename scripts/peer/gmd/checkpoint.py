#!/usr/bin/env python3
"""Writes checkpoints like those of training programs for GMD's networks.

    cd scripts/peer
    python3 -m gmd.checkpoint WEIGHTS.safetensors OUT.pt [--bare] [--without KEY] [--extra KEY] ...

WEIGHTS contains a network under `model.`, like the reference files and `data_fixtures/gmd`. Besides
the weights, a checkpoint contains tensors that an importer must ignore: parts of the text encoder
and the table of sinusoids, twice and with shared memory. The tensors are on a GPU, and trained
weights are parameters, not plain tensors.
"""

import argparse
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from torch import Tensor, nn

from .conditioning import sinusoid_rows

GPU = "cuda:0"
PERTURBATION = 0.02
"""Standard deviation of the difference between `model` and `model_avg`."""
TEXT_ENCODER = {
    "clip_model.positional_embedding": (3, 4),
    "clip_model.transformer.resblocks.0.attn.in_proj_weight": (12, 4),
    "clip_model.logit_scale": (),
}
"""A few keys of the text encoder, much smaller than the real ones."""
TABLE = "sequence_pos_encoder.pe"


def read_weights(path: Path) -> dict[str, Tensor]:
    """The tensors under `model.`."""
    with safe_open(path, "pt") as file:
        names = [name for name in file.keys() if name.startswith("model.")]
        return {name.removeprefix("model."): file.get_tensor(name) for name in names}


def perturbed(weights: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Other weights of the same sizes."""
    return {
        name: values + PERTURBATION * torch.randn(values.shape, generator=generator)
        for name, values in weights.items()
    }


def state_dict(
    weights: dict[str, Tensor],
    generator: torch.Generator,
    *,
    table_rows: int,
    text_encoder: bool = True,
    parameters: bool = False,
) -> "OrderedDict[str, Tensor]":
    """A module's state: its weights and other entries."""
    state: OrderedDict[str, Tensor] = OrderedDict()
    if table_rows > 0:
        width = weights["embed_text.bias"].numel()
        table = sinusoid_rows(torch.arange(table_rows), width).float()[:, None]
        state[TABLE] = state[f"embed_timestep.{TABLE}"] = table
    for name, values in weights.items():
        state[name] = nn.Parameter(values) if parameters else values
    if text_encoder:
        for name, shape in TEXT_ENCODER.items():
            state[name] = torch.randn(shape, generator=generator)
    # As in `Module.state_dict`; in the pickle it is the dictionary's state.
    state._metadata = OrderedDict({"": {"version": 1}, "unet": {"version": 1}})
    return state


def change(state: dict[str, Tensor], args: argparse.Namespace) -> None:
    """Changes `state` so that an importer must refuse it."""
    for name in args.without:
        del state[name]
    for name in args.extra:
        state[name] = torch.zeros(2)
    for name in args.reshape:
        values = state[name].detach()
        state[name] = torch.cat([values, values])
    for name in args.not_finite:
        values = state[name].detach().clone()
        values.flatten()[0] = float("nan")
        state[name] = values


def save(content: Any, path: Path, location: str = GPU) -> None:
    """Writes a file whose tensors claim to come from the device `location`."""
    # Taggers are called by priority; PyTorch's own start at 10.
    registry = torch.serialization._package_registry
    before = list(registry)
    torch.serialization.register_package(0, lambda storage: location, lambda storage, tag: None)
    try:
        torch.save(content, path)
    finally:
        registry[:] = before


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--bare", action="store_true", help="one state, not `model`, `model_avg`")
    parser.add_argument("--seed", type=int, default=0, help="of the perturbed weights")
    parser.add_argument("--table-rows", type=int, default=1000, help="0 leaves the table out")
    parser.add_argument("--location", default=GPU, help="device in the file; default %(default)s")
    parser.add_argument("--half", action="store_true", help="weights in half precision")
    for option, what in {
        "without": "leave this weight out",
        "extra": "add a tensor of this name",
        "reshape": "double this weight's first axis",
        "not-finite": "put a not-a-number into this weight",
    }.items():
        parser.add_argument(f"--{option}", action="append", default=[], metavar="KEY", help=what)
    return parser.parse_args()


def main() -> None:
    """Writes one file; changes apply to every state in it."""
    args = arguments()
    generator = torch.Generator().manual_seed(args.seed)
    averaged = read_weights(args.weights)
    networks = {"model": perturbed(averaged, generator), "model_avg": averaged}
    states = {}
    for key, weights in networks.items():
        if args.half:
            weights = {name: values.half() for name, values in weights.items()}
        states[key] = state_dict(
            weights, generator, table_rows=args.table_rows, parameters=key == "model"
        )
        change(states[key], args)
    save(states["model_avg"] if args.bare else states, args.out, args.location)


if __name__ == "__main__":
    main()
