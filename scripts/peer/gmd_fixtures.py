#!/usr/bin/env python3
"""Writes the files of `data_fixtures/gmd`.

    python3 scripts/peer/gmd_fixtures.py [FOLDER]

The README there describes them. Values are computed in float64 from float32 weights and inputs, and
stored in float32.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from gmd.checkpoint import perturbed, save, state_dict
from gmd.conditioning import TEXT_FEATURES
from gmd.denoiser import UNetDenoiser
from gmd.text_motion import Evaluator, TextMotionConfig, metrics
from gmd.transformer import TransformerConfig, TransformerDenoiser
from gmd.unet import UNetConfig

FOLDER = Path(__file__).resolve().parents[2] / "data_fixtures" / "gmd"
TABLE_ROWS = 100

TINY = UNetConfig(motion_channels=4, width=8, multipliers=(1, 1), cond_dim=8)
PLAIN = UNetConfig(
    motion_channels=4, width=8, multipliers=(1, 1), cond_dim=8, adagn=False, zero_init=False
)
PADDED_FRAMES = 32
FRAMES = 21
TRANSFORMER = TransformerConfig(
    motion_channels=12, latent_dim=16, heads=2, feed_forward=32, layers=2
)
PUBLISHED = TransformerConfig(latent_dim=16, heads=4, feed_forward=20, layers=2)
TRANSFORMER_FRAMES = 10
TRANSFORMER_GRADIENTS = [
    "embed_text.bias",
    "embed_timestep.time_embed.0.weight",
    "embed_timestep.time_embed.2.bias",
    "input_process.poseEmbedding.weight",
    "input_process.poseEmbedding.bias",
    "output_process.poseFinal.weight",
    "output_process.poseFinal.bias",
    "seqTransEncoder.layers.0.linear1.weight",
    "seqTransEncoder.layers.0.norm1.weight",
    "seqTransEncoder.layers.0.self_attn.in_proj_bias",
    "seqTransEncoder.layers.0.self_attn.in_proj_weight",
    "seqTransEncoder.layers.0.self_attn.out_proj.weight",
    "seqTransEncoder.layers.1.linear2.weight",
    "seqTransEncoder.layers.1.linear2.bias",
    "seqTransEncoder.layers.1.norm2.bias",
    "seqTransEncoder.layers.1.norm2.weight",
]

EVALUATOR = TextMotionConfig(
    channels=23,
    convolution=6,
    movement=5,
    motion_state=7,
    word_vector=4,
    text_state=6,
    embedding=8,
)
CLIPS = [40, 23, 196, 8, 4, 62]
WORDS = "unk sos eos a man walk slowly left arm chair over and the jump sit".split()
CAPTIONS = [
    "a/DET man/NOUN walk/VERB slowly/ADV",
    "the/DET man/NOUN jump/NOUN over/ADP the/DET chair/NOUN and/CCONJ sit/VERB",
    "a/DET " * 19 + "left/NOUN arm/NOUN man/NOUN",
    "zzz/VERB left/OTHER qqq/NOUN",
    "",
    "man/PROPN man/NUM man/AUX man/PRON man/ADJ",
    "arm/Act_VIP man/Act_VIP",
]
PAIRS = 70


def randomize(model: nn.Module, generator: torch.Generator) -> None:
    """Weights that let every path carry signal: also those that start at zero or one."""
    for name, values in model.named_parameters():
        noise = torch.randn(values.shape, generator=generator)
        if values.dim() > 1:
            noise /= values[0].numel() ** 0.5
        elif name.endswith("weight"):
            noise = 1.0 + 0.2 * noise
        else:
            noise *= 0.1
        values.data.copy_(noise)


def inputs(channels: int, frames: int, generator: torch.Generator) -> dict[str, Tensor]:
    """Two samples, the first near the data and the second near noise."""
    return {
        "in.x": torch.randn(2, channels, frames, generator=generator),
        "in.t": torch.tensor([7, 931], dtype=torch.int32),
        "in.text_features": torch.randn(2, TEXT_FEATURES, generator=generator),
    }


def answer(
    model: nn.Module, given: dict[str, Tensor], weights: dict[str, Tensor] | None = None
) -> Tensor:
    """The model's prediction in float64, with other weights if there are any."""
    if weights is not None:
        model.load_state_dict(weights)
    with torch.no_grad():
        return model(given["in.x"].double(), given["in.t"], given["in.text_features"].double())


def without_text(given: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same with the features of an empty text."""
    return given | {"in.text_features": torch.zeros_like(given["in.text_features"])}


def write(path: Path, tensors: dict[str, Tensor], config: object, **more: object) -> None:
    """A file with its configuration; floats become float32."""
    stored = {
        name: (values.detach().float() if values.is_floating_point() else values).contiguous()
        for name, values in tensors.items()
    }
    # One entry: the order of several changes from run to run.
    save_file(stored, path, {"config": json.dumps(asdict(config) | more)})
    path.chmod(0o644)


def checkpoint(folder: Path, name: str, config: UNetConfig, seed: int, *, bare: bool) -> None:
    """A checkpoint, and its network's outputs."""
    generator = torch.Generator().manual_seed(seed)
    model = UNetDenoiser(config, PADDED_FRAMES)
    randomize(model, generator)
    averaged = {key: values.clone() for key, values in model.state_dict().items()}
    given = inputs(config.motion_channels, FRAMES, generator)
    model.double()
    expected = {"out.y": answer(model, given), "out.y_uncond": answer(model, without_text(given))}
    if bare:
        save(
            state_dict(averaged, generator, table_rows=0, text_encoder=False), folder / f"{name}.pt"
        )
    else:
        trained = perturbed(averaged, generator)
        expected["out.y_model"] = answer(model, given, trained)
        states = {
            key: state_dict(weights, generator, table_rows=TABLE_ROWS, parameters=key == "model")
            for key, weights in {"model": trained, "model_avg": averaged}.items()
        }
        save(states, folder / f"{name}.pt")
    write(folder / f"{name}.safetensors", given | expected, config, padded_frames=PADDED_FRAMES)


def transformer(folder: Path) -> None:
    """The transformer: weights, inputs, every layer's output, gradients of the mean square."""
    generator = torch.Generator().manual_seed(3)
    model = TransformerDenoiser(TRANSFORMER)
    randomize(model, generator)
    tensors = {f"model.{name}": values.clone() for name, values in model.state_dict().items()}
    given = inputs(TRANSFORMER.motion_channels, TRANSFORMER_FRAMES, generator)
    model.double()
    tensors |= given | {"out.y_uncond": answer(model, without_text(given))}

    x = given["in.x"].double().requires_grad_()
    text = given["in.text_features"].double()
    tensors["out.tokens"] = model.tokens(x, given["in.t"], text)
    for i, layer in enumerate(model.seqTransEncoder.layers):
        layer.register_forward_hook(keep(tensors, f"out.layer{i}"))
    y = model(x, given["in.t"], text)
    loss = y.square().mean()
    loss.backward()
    tensors |= {"out.y": y, "out.loss": loss[None], "grad.in.x": x.grad}
    gradients = {name: values.grad for name, values in model.named_parameters()}
    tensors |= {f"grad.model.{name}": gradients[name] for name in TRANSFORMER_GRADIENTS}
    write(folder / "mdm_transformer_tiny.safetensors", tensors, TRANSFORMER)


def transformer_checkpoint(folder: Path) -> None:
    """A checkpoint of the transformer for HumanML3D's features, in half precision, and its
    outputs."""
    generator = torch.Generator().manual_seed(5)
    model = TransformerDenoiser(PUBLISHED)
    randomize(model, generator)
    halves = {name: values.half() for name, values in model.state_dict().items()}
    model.load_state_dict(halves)
    given = inputs(PUBLISHED.motion_channels, TRANSFORMER_FRAMES, generator)
    model.double()
    expected = {"out.y": answer(model, given), "out.y_uncond": answer(model, without_text(given))}
    save(state_dict(halves, generator, table_rows=20), folder / "checkpoint_mdm.pt")
    # The network has no padding: any length will do.
    write(folder / "checkpoint_mdm.safetensors", given | expected, PUBLISHED, padded_frames=1)


def evaluator(folder: Path) -> None:
    """The text-motion evaluator: weights, clips, captions, their embeddings, and the metrics of
    other embeddings."""
    generator = torch.Generator().manual_seed(4)
    model = Evaluator(EVALUATOR).eval()
    randomize(model, generator)
    tensors = dict(model.state_dict())
    tensors |= {f"in.clip{i}": torch.randn(n, 23, generator=generator) for i, n in enumerate(CLIPS)}
    tensors["in.mean"] = torch.randn(23, generator=generator)
    tensors["in.std"] = 0.5 + torch.rand(23, generator=generator)
    tensors["in.vectors"] = torch.randn(len(WORDS), EVALUATOR.word_vector, generator=generator)
    texts = torch.randn(PAIRS, 3, generator=generator)
    tensors["in.texts"] = texts
    tensors["in.motions"] = texts + 0.5 * torch.randn(PAIRS, 3, generator=generator)
    tensors["in.real"] = texts * torch.tensor([1.0, 0.5, 2.0]) + 0.3
    tensors = {name: values.clone() for name, values in tensors.items()}
    given = {name: values.double() for name, values in tensors.items()}
    model.double()
    vectors = dict(zip(WORDS, given["in.vectors"], strict=True))
    clips = [given[f"in.clip{i}"] for i in range(len(CLIPS))]
    with torch.no_grad():
        tensors["out.motion"] = model.motions(clips, given["in.mean"], given["in.std"])
        tensors["out.text"] = model.text_encoder.captions(CAPTIONS, vectors)
        found = metrics(given["in.texts"], given["in.motions"], given["in.real"])
    tensors |= {f"out.{name}": values for name, values in found.items()}
    write(
        folder / "text_motion_tiny.safetensors",
        tensors,
        EVALUATOR,
        words=WORDS,
        captions=CAPTIONS,
        clips=len(CLIPS),
    )


def keep(tensors: dict[str, Tensor], key: str) -> Callable[..., None]:
    """A hook that notes a module's output."""
    return lambda _module, _inputs, output: tensors.update({key: output})


def expanded(folder: Path) -> None:
    """Four gibibytes by their shape, from one stored number."""
    torch.save({"weight": torch.zeros(1).expand(1 << 30)}, folder / "checkpoint_expanded.pt")


def main() -> None:
    """Writes all files."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    checkpoint(folder, "checkpoint_tiny", TINY, seed=1, bare=False)
    checkpoint(folder, "checkpoint_bare", PLAIN, seed=2, bare=True)
    expanded(folder)
    transformer(folder)
    transformer_checkpoint(folder)
    evaluator(folder)


if __name__ == "__main__":
    main()
