#!/usr/bin/env python3
"""Trains a few end-to-end steps on random data and prints one line of JSON.

`scripts/rollout_memory` runs this in a separate process and reads its peak memory.
"""

import argparse
import json
import resource
import time

import torch

from ccmotion.decoder import MotionDecoder
from ccmotion.diffusion import PredictionType, RolloutMode
from ccmotion.e2e import Batch, EndToEndConfig, EndToEndModel, Trainer
from ccmotion.unet1d import AUDIO_CHANNELS, MOTION_CHANNELS, UNet1d, UNetConfig


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rollout-steps", type=int, default=5, help="K, steps of the sampler")
    parser.add_argument("--mode", choices=[m.value for m in RolloutMode], default="checkpointed")
    parser.add_argument("--last-k", type=int, default=1)
    parser.add_argument(
        "--prediction-type", choices=[p.value for p in PredictionType], default="sample"
    )
    parser.add_argument("--train-steps", type=int, default=3)
    parser.add_argument("--batch-size", type=int, default=8)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--threads", type=int, default=2)
    return parser.parse_args()


def random_batch(size: int, frames: int, num_train_timesteps: int) -> Batch:
    """Normal motion, audio and noise."""
    return Batch(
        motion=torch.randn(size, MOTION_CHANNELS, frames),
        cond=torch.randn(size, AUDIO_CHANNELS, frames),
        timesteps=torch.randint(num_train_timesteps, (size,)),
        noise=torch.randn(size, MOTION_CHANNELS, frames),
        x_T=torch.randn(size, MOTION_CHANNELS, frames),
    )


def peak_mib() -> float:
    """Largest resident set of this process until now (Linux counts it in KiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Runs the steps."""
    args = arguments()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    after_import = peak_mib()
    config = EndToEndConfig(
        steps=args.rollout_steps,
        mode=RolloutMode(args.mode),
        last_k=args.last_k,
        prediction_type=PredictionType(args.prediction_type),
        max_grad_norm=1.0,
    )
    trainer = Trainer(EndToEndModel(UNet1d(UNetConfig()), MotionDecoder()), config)
    seconds, losses = [], []
    for _ in range(args.train_steps):
        batch = random_batch(args.batch_size, args.frames, config.schedule.num_train_timesteps)
        start = time.perf_counter()
        losses.append(trainer.step(batch))
        seconds.append(time.perf_counter() - start)
    report = {
        "torch": torch.__version__,
        "unet_parameters": sum(p.numel() for p in trainer.model.unet.parameters()),
        "decoder_parameters": sum(p.numel() for p in trainer.model.decoder.parameters()),
        "losses": losses,
        "seconds": seconds,
        "import_mib": after_import,
        "peak_mib": peak_mib(),
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main()
