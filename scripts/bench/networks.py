"""The networks of a row in PyTorch, with kinegrad's names and sizes."""

from collections.abc import Callable
from typing import Any

from ccmotion.decoder import MotionDecoder
from ccmotion.e2e import EndToEndModel
from ccmotion.unet1d import UNet1d, UNetConfig
from flow.network import FlowConfig, FlowModel
from gmd.denoiser import UNetDenoiser
from gmd.unet import UNetConfig as GmdUNetConfig
from torch import nn


def unet1d(model: dict[str, Any]) -> UNet1d:
    """The audio-conditioned UNet of a table `model`."""
    config = UNetConfig(
        base=model["model_channels"],
        mult=tuple(model["channel_mult"]),
        time_dim=model["time_embed_dim"],
        ctx_dim=model["context_dim"],
        aligned=model.get("audio_conditioning") == "aligned",
    )
    return UNet1d(config)


def gmd_unet(model: dict[str, Any]) -> UNetDenoiser:
    """The text-conditioned UNet of a table `model`; nothing starts at zero, or all answers would be
    equal."""
    config = GmdUNetConfig(
        motion_channels=model["motion_channels"],
        width=model["model_channels"],
        multipliers=tuple(model["channel_mult"]),
        cond_dim=model["model_channels"],
        zero_init=False,
    )
    return UNetDenoiser(config, model["padded_frames"])


def flow(model: dict[str, Any]) -> FlowModel:
    """Autoregressive flow matching."""
    return FlowModel(FlowConfig(**{key: size for key, size in model.items() if key != "kind"}))


def matching(_: dict[str, Any]) -> nn.Module:
    """Matching has no network."""
    return nn.Module()


DENOISERS: dict[str, Callable[[dict[str, Any]], nn.Module]] = {
    "unet1d": unet1d,
    "gmd_unet": gmd_unet,
    "flow": flow,
    "matching": matching,
}
"""By `model.kind`."""


def build(row: dict[str, Any]) -> nn.Module:
    """Everything the row has weights of, with PyTorch's initial weights."""
    denoiser = DENOISERS[row["model"]["kind"]](row["model"])
    if row["task"]["kind"] == "end_to_end":
        return EndToEndModel(denoiser, MotionDecoder())
    return denoiser


def count(model: nn.Module) -> int:
    """Number of elements of all parameters."""
    return sum(parameter.numel() for parameter in model.parameters())
