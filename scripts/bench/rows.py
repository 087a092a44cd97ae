"""The rows of the benchmark. A new row is an entry of `ROWS`; a new network also needs an entry of
`DENOISERS` in `networks.py` and an arm in `worker/main.rs`."""

from dataclasses import dataclass
from typing import Any

FRAMES = 120
PADDED_FRAMES = 224
ADAM_BYTES_PER_PARAMETER = 16
"""Weight, gradient and two moments, which every framework keeps during training."""
AVERAGE_BYTES_PER_PARAMETER = 4
"""The moving average, if a row has one."""


@dataclass(frozen=True)
class Row:
    """One comparison of kinegrad with PyTorch."""

    name: str
    what: str
    """Description in the table."""
    parameters: int
    model: dict[str, Any]
    """kinegrad's table `model`, every size given."""
    task: dict[str, Any]
    """`kind` and its settings, in the names of kinegrad's config tables."""
    batch_size: int
    frames: int = FRAMES
    prediction_type: str = "sample"
    rounds: int = 10
    """After the warm-up."""
    warm_up: int = 2
    quick: bool = False
    """True for rows of the quick subset."""
    memory_against: str | None = None
    """The row whose PyTorch memory this one's is compared with, if not its own."""
    document_seconds: float | None = None
    """Time of a step on a CPU according to CC-MotionGen."""

    @property
    def trains(self) -> bool:
        """True if the row has a loss."""
        return self.task["kind"] not in ("sample", "draw_flow", "match")

    @property
    def floor_bytes(self) -> int:
        """Memory that does not count, because both sides need it."""
        if not self.trains:
            return 0
        average = AVERAGE_BYTES_PER_PARAMETER if "ema" in self.task else 0
        return (ADAM_BYTES_PER_PARAMETER + average) * self.parameters

    def spec(self, weights: str) -> dict[str, Any]:
        """The file that both workers read."""
        return {
            "weights": weights,
            "model": self.model,
            "prediction_type": self.prediction_type,
            "task": self.task,
            "batch_size": self.batch_size,
            "frames": self.frames,
        }


def unet1d(model_channels: int, channel_mult: list[int]) -> dict[str, Any]:
    """The audio-conditioned UNet, without dropout."""
    return {
        "kind": "unet1d",
        "model_channels": model_channels,
        "channel_mult": channel_mult,
        "time_embed_dim": 256,
        "context_dim": 256,
        "dropout": 0.0,
    }


def gmd_unet(
    motion_channels: int, model_channels: int, channel_mult: list[float]
) -> dict[str, Any]:
    """The text-conditioned UNet with adaptive group normalisation."""
    return {
        "kind": "gmd_unet",
        "motion_channels": motion_channels,
        "model_channels": model_channels,
        "channel_mult": channel_mult,
        "padded_frames": PADDED_FRAMES,
    }


def train() -> dict[str, Any]:
    """A training step on noised motion."""
    optim = {"learning_rate": 1e-4, "weight_decay": 1e-4}
    return {"kind": "train", "optim": optim, "max_grad_norm": 1.0}


def train_gmd() -> dict[str, Any]:
    """A training step on noised motion of several lengths, at GMD's published settings."""
    return {
        "kind": "train_gmd",
        "diffusion": {"beta_min": 0.0, "beta_max": 0.999},
        "trajectory_scale": 1.0,
        "optim": {"learning_rate": 1e-4, "weight_decay": 1e-2},
        "max_grad_norm": 1.0,
        "ema": {"decay": 0.9999, "update_every": 1, "inv_gamma": 0.0},
    }


def flow() -> dict[str, Any]:
    """Autoregressive flow matching, at the document's widths."""
    return {
        "kind": "flow",
        "joint_dim": 128,
        "context_dim": 64,
        "gru_dim": 128,
        "decoder_dim": 256,
        "latent_dim": 128,
        "num_layers": 4,
        "num_heads": 4,
        "ff_size": 512,
    }


def train_flow() -> dict[str, Any]:
    """A training step on windows of clips, with the settings of `configs/flow.toml`."""
    return {
        "kind": "train_flow",
        "optim": {"learning_rate": 5e-4, "weight_decay": 0.0},
        "max_grad_norm": 1.0,
        "ema": {"decay": 0.995, "update_every": 1, "inv_gamma": 0.0},
    }


def end_to_end(mode: str) -> dict[str, Any]:
    """A training step through 5 sampling steps, at CC-MotionGen's learning rates."""
    return {
        "kind": "end_to_end",
        "optim": {"weight_decay": 1e-4, "groups": {"unet": 1e-6, "decoder": 5e-5}},
        "max_grad_norm": 1.0,
        "rollout": {"steps": 5, "mode": mode, "last_k": 1, "start": "noise", "clip": "none"},
    }


def ddim(steps: int) -> dict[str, Any]:
    """One batch sampled by deterministic DDIM."""
    sampler = {"kind": "ddim", "num_inference_steps": steps, "eta": 0.0}
    return {"kind": "sample", "sampler": sampler | {"timestep_spacing": "linspace"}}


BASE_64 = unet1d(64, [1, 2, 4, 8])
BASE_64_PARAMETERS = 16_342_361
ALIGNED = BASE_64 | {"audio_conditioning": "aligned"}
ALIGNED_PARAMETERS = 17_581_017
DECODER_PARAMETERS = 1_591_321
BASE_128 = unet1d(128, [1, 2, 4, 8])
CC116M = unet1d(256, [1, 2, 4, 4])
CC116M_PARAMETERS = 104_436_505
GMD_TRAJECTORY = gmd_unet(4, 512, [0.125, 0.25, 0.5])
GMD_MOTION_128 = gmd_unet(263, 128, [2, 2, 2, 2])
GMD_MOTION = gmd_unet(263, 512, [2, 2, 2, 2])
FLOW_PARAMETERS = 2_459_779
HISTORY_FRAMES = 15
DANCES = {"gangnam": (371, 405, 92), "salsa": (648, 393, 118)}
"""Frames and channels of two dances of GenMM's paper, and the number of constant channels."""
DOCUMENT_CPU_SECONDS = {5: 5.2, 10: 9.8, 20: 18.5, 50: 45.3}

ROWS: list[Row] = [
    Row(
        "train_base64",
        "training step, UNet of base 64, batch 4",
        BASE_64_PARAMETERS,
        BASE_64,
        train(),
        batch_size=4,
        prediction_type="epsilon",
        quick=True,
    ),
    Row(
        "train_aligned",
        "training step, UNet of base 64 with aligned conditioning, batch 4",
        ALIGNED_PARAMETERS,
        ALIGNED,
        train(),
        batch_size=4,
        quick=True,
    ),
    Row(
        "train_base128",
        "training step, UNet of base 128, batch 16",
        59_217_049,
        BASE_128,
        train(),
        batch_size=16,
        prediction_type="epsilon",
        quick=True,
    ),
    *(
        Row(
            f"e2e_{mode}",
            f"end-to-end step, 5-step rollout `{mode}`, base 64, batch 8",
            BASE_64_PARAMETERS + DECODER_PARAMETERS,
            BASE_64,
            end_to_end(mode),
            batch_size=8,
            quick=mode != "last_k",
            memory_against="e2e_full" if mode == "checkpointed" else None,
        )
        for mode in ("full", "checkpointed", "last_k")
    ),
    *(
        Row(
            f"sample_batch{batch_size}",
            f"DDIM-20 sampling, base 64, batch {batch_size}",
            BASE_64_PARAMETERS,
            BASE_64,
            ddim(20),
            batch_size,
            quick=batch_size == 1,
        )
        for batch_size in (1, 8)
    ),
    *(
        Row(
            f"sample_aligned_batch{batch_size}",
            f"DDIM-20 sampling, base 64 with aligned conditioning, batch {batch_size}",
            ALIGNED_PARAMETERS,
            ALIGNED,
            ddim(20),
            batch_size,
        )
        for batch_size in (1, 8)
    ),
    *(
        Row(
            f"cc116m_{steps}",
            f"DDIM-{steps} sampling, `cc116m`, batch 1",
            CC116M_PARAMETERS,
            CC116M,
            ddim(steps),
            batch_size=1,
            rounds=5,
            warm_up=1,
            quick=steps == 5,
            document_seconds=seconds,
        )
        for steps, seconds in DOCUMENT_CPU_SECONDS.items()
    ),
    *(
        Row(
            f"gmd_trajectory_batch{batch_size}",
            f"training step, GMD's trajectory model, batch {batch_size}",
            8_549_316,
            GMD_TRAJECTORY,
            train_gmd(),
            batch_size,
            frames=PADDED_FRAMES,
            prediction_type="epsilon",
            quick=batch_size == 8,
        )
        for batch_size in (8, 32)
    ),
    Row(
        "gmd_motion_128",
        "training step, GMD's motion model at width 128, batch 4",
        15_024_903,
        GMD_MOTION_128,
        train_gmd(),
        batch_size=4,
        frames=PADDED_FRAMES,
        quick=True,
    ),
    Row(
        "gmd_motion",
        "training step, GMD's motion model, batch 1",
        233_507_079,
        GMD_MOTION,
        train_gmd(),
        batch_size=1,
        frames=PADDED_FRAMES,
        rounds=5,
    ),
    Row(
        "train_flow",
        "training step, motion that goes on, 64 windows of 15 frames",
        FLOW_PARAMETERS,
        flow(),
        train_flow(),
        batch_size=64,
        frames=HISTORY_FRAMES,
        quick=True,
    ),
    Row(
        "draw_flow",
        "20 poses one after the other, motion that goes on, 10 Euler steps each",
        FLOW_PARAMETERS,
        flow(),
        {"kind": "draw_flow", "steps": 10},
        batch_size=20,
        frames=HISTORY_FRAMES,
        quick=True,
    ),
    *(
        Row(
            f"match_{name}",
            f"new motion from {frames} frames of {channels} channels, to twice as many",
            0,
            {"kind": "matching", "frames": frames, "channels": channels, "still": still},
            {"kind": "match"},
            batch_size=1,
            frames=2 * frames,
            quick=True,
        )
        for name, (frames, channels, still) in DANCES.items()
    ),
]
