#!/usr/bin/env python3
"""Compares the denoisers of `gmd` with reference tensors: outputs, losses, gradients and sizes.

    python3 scripts/peer/check_gmd.py GOLDEN_DIR

GOLDEN_DIR contains `unet_motion_tiny`, `unet_traj_tiny`, `unet_traj_xxs_plain_tiny`, `mdm_unet_tiny`,
`schedule_cosine1000` and `trajectory_loss`, each `.safetensors`. `data_fixtures/gmd` is compared
too. Outputs are compared absolutely, other tensors relative to their largest entry. Exits
with 1 if an error is above its tolerance.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ccmotion.diffusion import PredictionType
from gmd.denoiser import UNetDenoiser
from gmd.reference import denoiser_values, unet_values
from gmd.reference import gradients as model_gradients
from gmd.training import cosine_schedule, weighted_loss
from gmd.transformer import TransformerConfig, TransformerDenoiser
from gmd.unet import UNetConfig
from golden import Golden, Report

FIXTURES = Path(__file__).resolve().parents[2] / "data_fixtures" / "gmd"
MOTION = UNetConfig()
TRAJECTORY = UNetConfig(motion_channels=4, multipliers=(0.125, 0.25, 0.5))
TRAJECTORY_XXS = UNetConfig(
    motion_channels=4, multipliers=(0.0625, 0.125, 0.25, 0.5), adagn=False, zero_init=False
)
PARAMETERS = {
    "motion": (MOTION, 233_507_079),
    "trajectory": (TRAJECTORY, 8_549_316),
    "trajectory xxs": (TRAJECTORY_XXS, 7_754_980),
    "motion without AdaGN": (UNetConfig(adagn=False, zero_init=False), 225_102_087),
}
ZERO_GRADIENT = 1e-6
"""A gradient below this is zero but for rounding: a bias in front of a norm of single channels."""


def absolute(report: Report, group: str, tolerance: float, name: str, a: Tensor, b: Tensor) -> None:
    """Enters the largest difference, not divided by anything."""
    if a.shape != b.shape:
        raise SystemExit(f"check_gmd: {group}: `{name}` has shape {tuple(a.shape)}")
    report.enter(group, tolerance, name, (a.detach().double() - b.double()).abs().max().item())


def gradients(report: Report, group: str, golden: Golden, found: dict[str, Tensor]) -> None:
    """Compares all gradients of the file."""
    for key in golden.keys("grad."):
        reference, name = golden[key], key.removeprefix("grad.")
        if reference.abs().max() < ZERO_GRADIENT:
            absolute(report, f"{group} zero gradients", 1e-6, name, found[key], reference)
        else:
            report.compare(f"{group} gradients", 1e-4, name, found[key], reference)


def check_unet(report: Report, folder: Path, name: str, dtype: torch.dtype = torch.float32) -> None:
    """A bare network: intermediate values, output, loss and gradients."""
    golden = Golden(folder, name)
    values = unet_values(golden, dtype)
    for key in golden.keys("out."):
        absolute(report, f"{name} outputs", 2e-5, key, values[key], golden[key])
    gradients(report, name, golden, values)


def check_denoiser(
    report: Report, folder: Path, name: str, dtype: torch.dtype = torch.float32
) -> None:
    """The complete model: conditioning, padding, outputs, guidance and gradients."""
    golden = Golden(folder, name)
    values = denoiser_values(golden, dtype)
    bounds = {"out.y_cfg": ("guidance", 2e-4), "out.pe_rows": ("sinusoid rows", 1e-5)}
    for key in golden.keys("out."):
        if key == "out.loss":
            report.compare(f"{name} loss", 1e-5, "", values[key], golden[key])
        else:
            group, tolerance = bounds.get(key, ("outputs", 5e-5))
            absolute(report, f"{name} {group}", tolerance, key, values[key], golden[key])
    gradients(report, name, golden, values)


def check_schedule(report: Report, folder: Path) -> None:
    """The cumulative products, in float64."""
    golden = Golden(folder, "schedule_cosine1000")
    reference = golden["out.alphas_cumprod"].numpy()
    error = np.abs(cosine_schedule().sqrt_abar ** 2 / reference - 1).max()
    report.enter("schedule, cumulative products", 1e-12, "", error)


def check_loss(report: Report, folder: Path) -> None:
    """The weighted loss of both prediction types and its gradient, with the file's denoiser."""
    golden = Golden(folder, "trajectory_loss")
    schedule = cosine_schedule()
    x0, noise, t = golden["in.x0"][:, :, 0], golden["in.noise"][:, :, 0], golden["in.t"]
    mask = golden["in.mask"][:, 0].float()
    x_t = schedule.add_noise(x0, noise, t)
    for kind, prediction_type in [("x0", PredictionType.SAMPLE), ("eps", PredictionType.EPSILON)]:
        absolute(report, "loss, x_t", 1e-5, kind, x_t, golden[f"out.{kind}.x_t"][:, :, 0])
        target = schedule.target(x0, noise, t, prediction_type)
        for k in golden["in.k"].tolist():
            case = f"{kind}.k{k:g}"
            W, v = (golden[f"model.{key}"].clone().requires_grad_() for key in "Wv")
            h = torch.einsum("cd,bdt->bct", W, x_t) + v[:, None] * (t / 1000)[:, None, None]
            prediction = golden["model.s"] * torch.tanh(h)
            loss = weighted_loss(prediction, target, mask, k)
            loss.mean().backward()
            report.compare("loss", 1e-5, case, loss, golden[f"out.{case}.loss"])
            for key, found in {"W": W, "v": v}.items():
                reference = golden[f"grad.{case}.{key}"]
                report.compare("loss gradients", 1e-4, f"{case} {key}", found.grad, reference)


def check_sizes(report: Report) -> None:
    """Parameter counts at full size, and that a new network answers zero."""
    for name, (config, expected) in PARAMETERS.items():
        with torch.device("meta"):
            model = UNetDenoiser(config)
        count = sum(parameter.numel() for parameter in model.parameters())
        report.enter("parameter counts", 0, name, abs(count - expected))
    model = UNetDenoiser(TRAJECTORY)
    y = model(torch.randn(2, 4, 196), torch.tensor([3, 900]), torch.randn(2, 512))
    report.enter("first answer of a new network", 0, "trajectory", y.abs().max().item())


def check_checkpoint(report: Report, folder: Path, name: str) -> None:
    """The outputs of a checkpoint's networks, in float32 against float64."""
    golden = Golden(folder, name)
    config = golden.json("config")
    padded_frames = config.pop("padded_frames")
    model = UNetDenoiser(UNetConfig(**config), padded_frames)
    content = torch.load(folder / f"{name}.pt", map_location="cpu")
    x, t, text = golden["in.x"], golden["in.t"], golden["in.text_features"]
    averaged = {"y": text, "y_uncond": torch.zeros_like(text)}
    texts = {"model": {"y_model": text}, "model_avg": averaged}
    for key in texts if "model" in content else ["model_avg"]:
        state = content.get(key, content)
        model.load_state_dict({own: state[own] for own in model.state_dict()})
        for answer, features in texts[key].items():
            reference = golden[f"out.{answer}"]
            absolute(report, f"{name} outputs", 2e-5, answer, model(x, t, features), reference)


def check_transformer(report: Report, folder: Path, name: str) -> None:
    """The transformer in float32 against values computed in float64."""
    golden = Golden(folder, name)
    model = TransformerDenoiser(TransformerConfig(**golden.json("config")))
    model.load_state_dict(golden.under("model."))
    x = golden["in.x"].clone().requires_grad_()
    t, text = golden["in.t"], golden["in.text_features"]
    values = {"y_uncond": model(x, t, torch.zeros_like(text)), "tokens": model.tokens(x, t, text)}
    for i, layer in enumerate(model.seqTransEncoder.layers):
        layer.register_forward_hook(lambda _m, _i, out, i=i: values.update({f"layer{i}": out}))
    values["y"] = model(x, t, text)
    loss = values["y"].square().mean()
    loss.backward()
    values["loss"] = loss[None]
    for key, reference in golden.under("out.").items():
        absolute(report, f"{name} outputs", 2e-5, key, values[key], reference)
    gradients(report, name, golden, {"grad.in.x": x.grad} | model_gradients(model))


def main() -> int:
    """Runs all checks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("golden_dir", type=Path, help="folder with the .safetensors files")
    folder = parser.parse_args().golden_dir
    torch.set_num_threads(2)
    torch.manual_seed(0)
    report = Report()
    for name in ["unet_motion_tiny", "unet_traj_tiny", "unet_traj_xxs_plain_tiny"]:
        check_unet(report, folder, name)
    check_denoiser(report, folder, "mdm_unet_tiny")
    check_schedule(report, folder)
    check_loss(report, folder)
    check_sizes(report)
    for name in ["checkpoint_tiny", "checkpoint_bare"]:
        check_checkpoint(report, FIXTURES, name)
    check_transformer(report, FIXTURES, "mdm_transformer_tiny")
    return 0 if report.print() else 1


if __name__ == "__main__":
    sys.exit(main())
