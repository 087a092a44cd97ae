"""Writes `data_fixtures/flowmdm/checkpoint.pt`: weights as the published program saves them, tiny and
random, with its names, including those that are no parameters.

    python3 scripts/peer/flowmdm_fixture.py data_fixtures/flowmdm
"""

import argparse
from pathlib import Path

import torch

WIDTH, CHANNELS, TEXT, HEADS, INNER, LAYERS = 32, 263, 512, 1, 64, 2


def shapes() -> dict[str, tuple[int, ...]]:
    """Every parameter of a tiny network."""
    named: dict[str, tuple[int, ...]] = {}

    def linear(name: str, outputs: int, inputs: int, bias: bool = True) -> None:
        named[f"{name}.weight"] = (outputs, inputs)
        if bias:
            named[f"{name}.bias"] = (outputs,)

    def norm(name: str) -> None:
        named[f"{name}.weight"] = (WIDTH,)
        named[f"{name}.bias"] = (WIDTH,)

    linear("embed_timestep.time_embed.0", WIDTH, WIDTH)
    linear("embed_timestep.time_embed.2", WIDTH, WIDTH)
    linear("embed_text", WIDTH, TEXT)
    linear("input_process.poseEmbedding", WIDTH, CHANNELS)
    named["seqTransEncoder.pos_emb.absolute.scale"] = (1,)
    linear("seqTransEncoder.project_in", WIDTH, WIDTH)
    linear("seqTransEncoder.project_out", WIDTH, WIDTH)
    for index in range(2 * LAYERS):
        layer = f"seqTransEncoder.attn_layers.layers.{index}"
        norm(f"{layer}.0.0")
        if index % 2 == 0:
            linear(f"{layer}.1.custom_query_fn", WIDTH, 2 * WIDTH)
            for name in ("to_q", "to_k", "to_v"):
                linear(f"{layer}.1.{name}", 64 * HEADS, WIDTH, bias=False)
            linear(f"{layer}.1.to_out", WIDTH, 64 * HEADS, bias=False)
        else:
            linear(f"{layer}.1.ff.0.0", INNER, WIDTH)
            linear(f"{layer}.1.ff.3", WIDTH, INNER)
    norm("seqTransEncoder.attn_layers.final_norm")
    linear("output_process.poseFinal", CHANNELS, WIDTH)
    return named


def main() -> None:
    """Writes the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator().manual_seed(1)
    weights = {
        name: torch.randn(shape, generator=generator) * 0.1 for name, shape in shapes().items()
    }
    table = torch.zeros(5, 1, WIDTH)
    weights["sequence_pos_encoder.pe"] = table
    weights["embed_timestep.sequence_pos_encoder.pe"] = table
    weights["seqTransEncoder.attn_layers.rotary_pos_emb.relative.inv_freq"] = torch.zeros(16)
    torch.save(weights, folder / "checkpoint.pt")


if __name__ == "__main__":
    main()
