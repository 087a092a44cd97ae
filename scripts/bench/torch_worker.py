"""PyTorch's worker of `scripts/bench/run`: runs one step per request.

    torch_worker.py FOLDER DEVICE [--compile]

Files and answers are those of kinegrad's worker, `worker/main.rs`.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Protocol

import torch
from ccmotion.denoising import DenoisingConfig, DenoisingTrainer
from ccmotion.diffusion import NoiseSchedule, PredictionType, RolloutMode, rollout
from ccmotion.e2e import Batch, EndToEndConfig, EndToEndModel, Trainer
from flow.network import JOINTS, FlowModel
from flow.training import Trainer as FlowTrainer
from flow.training import drawn
from genmm.matching import synthesized
from gmd import training as gmd
from networks import build, count
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor, nn


class Work(Protocol):
    """A task with its networks."""

    def step(self) -> float | None:
        """One step; returns its loss, if any."""


class Training:
    """Trains the denoiser on noised motion."""

    def __init__(self, model: nn.Module, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        task = row["task"]
        config = DenoisingConfig(
            prediction_type=PredictionType(row["prediction_type"]),
            learning_rate=task["optim"]["learning_rate"],
            weight_decay=task["optim"]["weight_decay"],
            max_grad_norm=task["max_grad_norm"],
        )
        self.trainer = DenoisingTrainer(model, config)
        self.inputs = {name: inputs[name] for name in ("motion", "cond", "timesteps", "noise")}

    def step(self) -> float:
        return self.trainer.step(**self.inputs)


class GmdTraining:
    """Trains a text-conditioned denoiser on noised clips of several lengths."""

    def __init__(self, model: nn.Module, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        task = row["task"]
        config = gmd.TrainingConfig(
            prediction_type=PredictionType(row["prediction_type"]),
            schedule=NoiseSchedule.cosine(**task["diffusion"]),
            trajectory_scale=task["trajectory_scale"],
            learning_rate=task["optim"]["learning_rate"],
            weight_decay=task["optim"]["weight_decay"],
            max_grad_norm=task["max_grad_norm"],
            ema_decay=task["ema"]["decay"],
        )
        self.trainer = gmd.Trainer(model, config)
        self.inputs = {name: inputs[name] for name in ("motion", "mask", "timesteps", "noise")}
        self.inputs["text_features"] = inputs["cond"].squeeze(2)

    def step(self) -> float:
        return self.trainer.step(**self.inputs)


class EndToEnd:
    """Trains denoiser and decoder through the sampler."""

    def __init__(
        self, model: EndToEndModel, inputs: dict[str, Tensor], row: dict[str, Any]
    ) -> None:
        task = row["task"]
        config = EndToEndConfig(
            steps=task["rollout"]["steps"],
            mode=RolloutMode(task["rollout"]["mode"]),
            last_k=task["rollout"]["last_k"],
            prediction_type=PredictionType(row["prediction_type"]),
            unet_learning_rate=task["optim"]["groups"]["unet"],
            decoder_learning_rate=task["optim"]["groups"]["decoder"],
            weight_decay=task["optim"]["weight_decay"],
            max_grad_norm=task["max_grad_norm"],
            ema_decay=None,
        )
        self.trainer = Trainer(model, config)
        self.batch = Batch(**inputs)

    def step(self) -> float:
        return self.trainer.step(self.batch)


class Sampling:
    """Samples one batch of motion: DDIM, eta 0."""

    def __init__(self, model: nn.Module, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        self.model = model
        self.inputs = inputs
        self.schedule = NoiseSchedule.cosine()
        self.prediction_type = PredictionType(row["prediction_type"])
        self.steps = row["task"]["sampler"]["num_inference_steps"]
        self.last: Tensor | None = None

    def step(self) -> None:
        with torch.inference_mode():
            self.last = rollout(
                self.model,
                self.schedule,
                self.prediction_type,
                self.inputs["x_T"],
                self.inputs["cond"],
                self.steps,
                RolloutMode.FULL,
            )


def windows(inputs: dict[str, Tensor]) -> dict[str, Tensor]:
    """Histories and their conditions, as inputs of the flow networks."""
    return {
        "history": inputs["history"].transpose(1, 2),
        "text": inputs["cond"].squeeze(2),
        "place": inputs["place"].squeeze(2),
        "noise": inputs["noise"].transpose(1, 2),
    }


class FlowTraining:
    """Trains the networks of autoregressive flow matching."""

    def __init__(self, model: FlowModel, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        task = row["task"]
        self.trainer = FlowTrainer(
            model,
            learning_rate=task["optim"]["learning_rate"],
            weight_decay=task["optim"]["weight_decay"],
            max_grad_norm=task["max_grad_norm"],
            ema_decay=task["ema"]["decay"],
        )
        self.inputs = windows(inputs) | {
            "pose": inputs["motion"].squeeze(2).unflatten(1, (JOINTS, 3)),
            "times": inputs["times"].flatten(),
        }

    def step(self) -> float:
        return self.trainer.step(**self.inputs)


class FlowDrawing:
    """Samples the next poses of histories, one after the other."""

    def __init__(self, model: FlowModel, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        self.model = model.eval()
        inputs = windows(inputs)
        self.poses = [
            {name: values[i : i + 1] for name, values in inputs.items()}
            for i in range(row["batch_size"])
        ]
        self.steps = row["task"]["steps"]
        self.last: Tensor | None = None

    def step(self) -> None:
        with torch.inference_mode():
            poses = [drawn(self.model, steps=self.steps, **pose) for pose in self.poses]
            self.last = torch.cat(poses)


class Matching:
    """Synthesises a motion from an example."""

    def __init__(self, _: nn.Module, inputs: dict[str, Tensor], row: dict[str, Any]) -> None:
        self.example, self.noise = inputs["example"][0], inputs["noise"][0]
        self.frames = row["frames"]
        self.last: Tensor | None = None

    def step(self) -> None:
        with torch.inference_mode():
            self.last = synthesized(self.example, self.frames, self.noise)


TASKS = {
    "train": Training,
    "train_gmd": GmdTraining,
    "end_to_end": EndToEnd,
    "train_flow": FlowTraining,
    "draw_flow": FlowDrawing,
    "sample": Sampling,
    "match": Matching,
}


def load_model(row: dict[str, Any], device: str) -> nn.Module:
    """The networks with the row's weights, no second copy of which is ever made."""
    with torch.device("meta"):
        model = build(row)
    model = model.to_empty(device=device)
    with torch.no_grad(), safe_open(row["weights"], "pt") as file:
        for name, values in model.state_dict().items():
            values.copy_(file.get_tensor(name))
    return model


def status(field: str) -> int | None:
    """A memory figure of this process in KiB, if the system has `/proc`."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith(field)), None)


def reset_peak() -> None:
    """Excludes the reading of files from the peak. If the peak cannot be reset, it is the larger of
    both."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def say(**answer: Any) -> None:
    """One line of JSON."""
    print(json.dumps(answer), flush=True)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("device")
    parser.add_argument("--compile", action="store_true", help="the denoiser with torch.compile")
    return parser.parse_args()


def main() -> None:
    """Loads, then answers."""
    start_kib = status("VmRSS:")
    args = arguments()
    row = json.loads(Path(args.folder, "row.json").read_text())
    inputs = load_file(args.folder / "inputs.safetensors", args.device)
    model = load_model(row, args.device)
    if args.compile:
        (model.unet if isinstance(model, EndToEndModel) else model).compile()
    work: Work = TASKS[row["task"]["kind"]](model, inputs, row)
    reset_peak()
    say(parameters=count(model), start_kib=start_kib)

    for line in sys.stdin:
        match line.strip().split(maxsplit=1):
            case ["step"]:
                start = time.perf_counter()
                loss = work.step()
                if torch.device(args.device).type == "cuda":
                    torch.cuda.synchronize()
                seconds = time.perf_counter() - start
                say(seconds=seconds, loss=loss, peak_kib=status("VmHWM:"))
            case ["save", path]:
                Path(path).write_bytes(work.last.float().cpu().numpy().tobytes())
                say()
            case _:
                sys.exit(f"torch_worker: `{line.strip()}` is neither `step` nor `save PATH`")


if __name__ == "__main__":
    main()
