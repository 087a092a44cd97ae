"""Writes the files of a row: weights, unless another row wrote them, and inputs.

    torch_inputs.py FOLDER      reads FOLDER/row.json
"""

import json
import sys
from pathlib import Path
from typing import Any

import torch
from ccmotion.unet1d import AUDIO_CHANNELS, MOTION_CHANNELS
from flow.network import FEATURES, JOINTS
from genmm.matching import first_length
from gmd.conditioning import TEXT_FEATURES
from networks import build
from safetensors.torch import save_file
from torch import Tensor

NUM_TRAIN_TIMESTEPS = 1000
GMD_LENGTHS = (40, 196)
"""Frames of the shortest and of the longest clip."""


def unet1d(row: dict[str, Any]) -> dict[str, Tensor]:
    """Motion with audio features."""
    batch, frames = row["batch_size"], row["frames"]
    return {
        "motion": torch.randn(batch, MOTION_CHANNELS, frames),
        "cond": torch.randn(batch, AUDIO_CHANNELS, frames),
        "noise": torch.randn(batch, MOTION_CHANNELS, frames),
        "timesteps": torch.randint(NUM_TRAIN_TIMESTEPS, (batch,)),
        "x_T": torch.randn(batch, MOTION_CHANNELS, frames),
    }


def gmd_unet(row: dict[str, Any]) -> dict[str, Tensor]:
    """Clips of several lengths, zero after their ends, with text features. All floats have three
    axes, as in kinegrad."""
    batch, frames = row["batch_size"], row["frames"]
    shape = (batch, row["model"]["motion_channels"], frames)
    shortest, longest = GMD_LENGTHS
    lengths = torch.randint(shortest, longest + 1, (batch,))
    lengths[0] = longest
    mask = (torch.arange(frames) < lengths[:, None, None]).float()
    return {
        "motion": torch.randn(shape) * mask,
        "mask": mask,
        "cond": torch.randn(batch, TEXT_FEATURES, 1),
        "noise": torch.randn(shape),
        "timesteps": torch.randint(NUM_TRAIN_TIMESTEPS, (batch,)),
    }


def matching(row: dict[str, Any]) -> dict[str, Tensor]:
    """A smooth example, some channels of which never change, and the noise that the coarsest level
    starts from, one frame after the other."""
    frames, channels = row["model"]["frames"], row["model"]["channels"]
    # Of this seed PyTorch's matches in single precision are those in double precision; of some others
    # its products of matrices confuse near ones.
    torch.manual_seed(2)
    steps = torch.randn(1, frames, channels)
    steps[:, 1:, channels - row["model"]["still"] :] = 0
    return {
        "example": torch.cumsum(steps, 1) / frames**0.5,
        "noise": torch.randn(1, first_length(frames, row["frames"]), channels),
    }


def flow(row: dict[str, Any]) -> dict[str, Tensor]:
    """Histories with a text and a place in their motions, and the poses that follow."""
    batch = row["batch_size"]
    return {
        "history": torch.randn(batch, FEATURES, row["frames"]),
        "cond": torch.randn(batch, TEXT_FEATURES, 1),
        "place": torch.rand(batch, 2, 1),
        "motion": torch.randn(batch, 3 * JOINTS, 1),
        "noise": torch.randn(batch, 3, JOINTS),
        "times": torch.rand(batch, 1, 1),
    }


INPUTS = {"unet1d": unet1d, "gmd_unet": gmd_unet, "flow": flow, "matching": matching}
"""By `model.kind`."""


def main() -> None:
    """Writes the files."""
    folder = Path(sys.argv[1])
    row = json.loads(Path(folder, "row.json").read_text())
    weights = Path(row["weights"])
    if not weights.exists():
        torch.manual_seed(0)
        save_file(build(row).state_dict(), weights)
    torch.manual_seed(1)
    inputs = INPUTS[row["model"]["kind"]](row)
    save_file(inputs, folder / "inputs.safetensors")


if __name__ == "__main__":
    main()
