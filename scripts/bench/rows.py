"""What is measured. A new row is an entry of `ROWS`; a new network is also one of `DENOISERS` in
`networks.py`, and what `bench_worker.rs` loads."""

from dataclasses import dataclass
from typing import Any

FRAMES = 120
ADAM_BYTES_PER_PARAMETER = 16
"""Weight, gradient and two moments, which every framework holds while it trains."""


@dataclass(frozen=True)
class Row:
    """One comparison of kinegrad with PyTorch."""

    name: str
    what: str
    """In words, for the reader of the table."""
    parameters: int
    model: dict[str, Any]
    """kinegrad's table `model`, every size given."""
    task: dict[str, Any]
    """`kind` and its settings, in the names of kinegrad's config tables."""
    batch_size: int
    prediction_type: str = "sample"
    rounds: int = 10
    """After the warm-up."""
    warm_up: int = 2
    quick: bool = False
    """Whether it belongs to the quick subset."""
    memory_against: str | None = None
    """The row whose PyTorch memory this one's is compared with, if not its own."""
    document_seconds: float | None = None
    """What the document says a step takes on a CPU."""

    @property
    def trains(self) -> bool:
        """Whether there is a loss."""
        return self.task["kind"] != "sample"

    @property
    def floor_bytes(self) -> int:
        """Memory that does not count, because both sides need it."""
        return ADAM_BYTES_PER_PARAMETER * self.parameters if self.trains else 0

    def spec(self, weights: str) -> dict[str, Any]:
        """What both workers read."""
        return {
            "weights": weights,
            "model": self.model,
            "prediction_type": self.prediction_type,
            "task": self.task,
            "batch_size": self.batch_size,
            "frames": FRAMES,
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


def train() -> dict[str, Any]:
    """A training step on noised motion."""
    optim = {"learning_rate": 1e-4, "weight_decay": 1e-4}
    return {"kind": "train", "optim": optim, "max_grad_norm": 1.0}


def end_to_end(mode: str) -> dict[str, Any]:
    """A training step through 5 sampling steps, at the document's learning rates."""
    return {
        "kind": "end_to_end",
        "optim": {"weight_decay": 1e-4, "groups": {"unet": 1e-6, "decoder": 5e-5}},
        "max_grad_norm": 1.0,
        "rollout": {"steps": 5, "mode": mode, "last_k": 1, "start": "noise", "clip": "none"},
    }


def ddim(steps: int) -> dict[str, Any]:
    """One batch drawn by deterministic DDIM."""
    sampler = {"kind": "ddim", "num_inference_steps": steps, "eta": 0.0}
    return {"kind": "sample", "sampler": sampler | {"timestep_spacing": "linspace"}}


BASE_64 = unet1d(64, [1, 2, 4, 8])
BASE_64_PARAMETERS = 16_342_361
DECODER_PARAMETERS = 1_591_321
BASE_128 = unet1d(128, [1, 2, 4, 8])
CC116M = unet1d(256, [1, 2, 4, 4])
CC116M_PARAMETERS = 104_436_505
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
]
