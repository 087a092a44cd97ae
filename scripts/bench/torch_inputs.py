"""Makes what both sides of a row load: weights, unless another row made them, and inputs.

    torch_inputs.py FOLDER      reads FOLDER/row.json
"""

import json
import sys
from pathlib import Path

import torch
from ccmotion.unet1d import AUDIO_CHANNELS, MOTION_CHANNELS
from networks import build
from safetensors.torch import save_file

NUM_TRAIN_TIMESTEPS = 1000


def main() -> None:
    """Writes the files."""
    folder = Path(sys.argv[1])
    row = json.loads(Path(folder, "row.json").read_text())
    weights = Path(row["weights"])
    if not weights.exists():
        torch.manual_seed(0)
        save_file(build(row).state_dict(), weights)
    torch.manual_seed(1)
    batch, frames = row["batch_size"], row["frames"]
    inputs = {
        "motion": torch.randn(batch, MOTION_CHANNELS, frames),
        "cond": torch.randn(batch, AUDIO_CHANNELS, frames),
        "noise": torch.randn(batch, MOTION_CHANNELS, frames),
        "timesteps": torch.randint(NUM_TRAIN_TIMESTEPS, (batch,)),
        "x_T": torch.randn(batch, MOTION_CHANNELS, frames),
    }
    save_file(inputs, folder / "inputs.safetensors")


if __name__ == "__main__":
    main()
