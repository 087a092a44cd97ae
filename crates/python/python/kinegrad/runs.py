"""Trained runs: training, sampling, evaluation."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Callable, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from . import _kinegrad
from ._progress import Bar, ProgressArgument, reporting
from ._settings import Path as PathArgument
from ._settings import overrides as as_overrides
from .data import Dataset
from .errors import UsageError

__all__ = ["Run", "Sample", "StepReport", "train"]


class StepReport(TypedDict):
    """One optimiser step of a training."""

    step: int
    """Steps done, this one included."""
    max_steps: int
    """Steps in total."""
    loss: float
    """Loss, averaged over the micro-batches."""
    learning_rate: float
    """Learning rate of the first group of parameters."""
    grad_norm: float
    """Global norm of the gradient before clipping."""


class Sample:
    """A generated motion."""

    def __init__(self, sample: _kinegrad.Sample) -> None:
        self._sample = sample
        self._arrays = dict(sample.arrays())

    @property
    def name(self) -> str:
        """The part of its file names after the prefix; empty for a single sample."""
        return self._sample.name

    @property
    def motion(self) -> NDArray[np.float32]:
        """The motion: a post-processed phrase `[T, 25]` at 30 frames per second, joint positions
        `[T, J, 3]` in metres, or for runs of recipe `gmd_trajectory` the ground path `[T, 2]`."""
        return self._arrays[".npy"]

    @property
    def raw(self) -> NDArray[np.float32] | None:
        """The model's output before post-processing, `[T, 25]`; `None` unless it is a phrase."""
        return self._arrays.get(".raw.npy")

    @property
    def features(self) -> NDArray[np.float32] | None:
        """Joint features, `[T, 263]` or `[T, 251]`; `None` unless it is a clip."""
        return self._arrays.get(".features.npy")

    @property
    def path(self) -> NDArray[np.float32] | None:
        """The ground path of the first stage, `[T, 2]` in metres; `None` for a single stage."""
        return self._arrays.get(".path.npy")

    @property
    def record(self) -> dict[str, Any]:
        """The record: run, checkpoint, seed, sampler, condition."""
        record: dict[str, Any] = json.loads(self._sample.record)
        return record

    @property
    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """All arrays by the ending of their files."""
        return dict(self._arrays)

    def bvh(self) -> str:
        """The motion as the text of a BVH file, in centimetres.

        Raises:
            UsageError: For a motion without a skeleton.
        """
        text = self._sample.bvh()
        if text is None:
            raise UsageError("the sample has no skeleton to write as BVH", None)
        return text

    def save(self, prefix: PathArgument, *, overwrite: bool = False) -> list[Path]:
        """Writes the files that `kinegrad sample --out PREFIX` writes, and returns their paths:
        `PREFIX.npy` and those beside it, `PREFIX-000.npy` for the first of several samples, with
        the record as JSON.

        Raises:
            UsageError: If the file exists, unless `overwrite`.
        """
        return self._sample.save(prefix, overwrite)

    def __repr__(self) -> str:
        shape = ", ".join(str(length) for length in self.motion.shape)
        return f"<kinegrad.Sample {self.name or 'sample'} [{shape}]>"


class Run:
    """A trained model.

    Args:
        path: Folder of a run, whose best checkpoint is used, or of a checkpoint.

    Raises:
        CheckpointError: If there is none, or it is damaged.
    """

    def __init__(self, path: PathArgument) -> None:
        self._path = Path(path)
        self._checkpoint, self._step, config = _kinegrad.open_run(self._path)
        self._config: dict[str, Any] = json.loads(config)

    @property
    def path(self) -> Path:
        """The folder of the run or checkpoint."""
        return self._path

    @property
    def checkpoint(self) -> Path:
        """The folder of the checkpoint."""
        return self._checkpoint

    @property
    def config(self) -> dict[str, Any]:
        """The config, with all defaults filled in."""
        return self._config

    @property
    def step(self) -> int:
        """Number of optimiser steps of the weights."""
        return self._step

    def metrics(self) -> dict[str, NDArray[Any]]:
        """The metrics of the training by name: `step` `[N]` int64, and `loss`, `val_loss`, `lr`,
        `grad_norm` and others `[N]` float64, NaN at steps without a value."""
        folder = self._path
        if not (folder / "metrics.jsonl").exists() and self._checkpoint.parent.name == "checkpoints":
            folder = self._checkpoint.parent.parent
        lines = _kinegrad.read_metrics(folder)
        found: dict[str, NDArray[Any]] = {
            "step": np.array([step for step, _ in lines], dtype=np.int64)
        }
        for index, (_, scalars) in enumerate(lines):
            for name, value in scalars:
                column = found.setdefault(name, np.full(len(lines), np.nan))
                column[index] = value
        return found

    def sample(
        self,
        *,
        item: str | None = None,
        audio: PathArgument | None = None,
        start: float = 0.0,
        audio_features: PathArgument | None = None,
        goal: PathArgument | Sequence[PathArgument] | None = None,
        text: str | None = None,
        text_encoder: PathArgument | None = None,
        text_embedding: str | None = None,
        history: PathArgument | None = None,
        prompts: PathArgument | None = None,
        path: PathArgument | None = None,
        metres_per_unit: float | None = None,
        trajectory_run: PathArgument | Run | None = None,
        held_out: int | None = None,
        source: str | None = None,
        continue_from: PathArgument | None = None,
        keep: str | Sequence[tuple[int, int]] | None = None,
        keep_from: PathArgument | None = None,
        postprocess: Literal["default", "ccmotion", "none"] = "default",
        style: str | Sequence[float] | None = None,
        best_of: int | None = None,
        select_by: Sequence[Literal["checks", "beat", "goal", "skating", "text"]] = ("checks",),
        count: int = 1,
        frames: int | None = None,
        seconds: float | None = None,
        seed: int = 0,
        steps: int | None = None,
        guidance_scale: float | None = None,
        settings: Mapping[str, Any] | Sequence[str] | None = None,
        weights: Literal["ema", "model"] = "ema",
        device: str | None = None,
        progress: ProgressArgument = None,
    ) -> list[Sample]:
        """Generates motion, with the options and results of `kinegrad sample`.

        Args:
            item: Item of the dataset that gives the condition: the audio features of a phrase, or
                the first caption of a clip; `*` matches any text. By default the first held-out
                phrase.
            audio: Song to use as the condition, of any length; from `start` to its end if there is
                no `frames`.
            start: Position in the song, in seconds, at which the motion starts.
            audio_features: `features.npz`, or a `.npy` file of `[163, frames]`, to use as the
                condition.
            goal: Goal file or files for position control of a clip.
            text: Text to use as the condition, embedded with `text_encoder`; for runs with
                `data.humanml3d.text = "labels"` one of the training captions.
            text_encoder: Folder with CLIP ViT-B/32, which embeds the text.
            text_embedding: Text embedding to use as the condition, `FILE#KEY`.
            history: Joint positions `[T, J, 3]` in metres that the motion continues, for runs of
                recipe `flow`.
            prompts: File of texts one after another, each with its length, for runs of recipe
                `flow` or `bpe_motion`.
            path: Path over the ground that the motion follows (.toml, .csv or .svg), for runs of
                recipe `bpe_motion`; `{"evaluation.path.method": "override"}` in `settings` selects
                the method.
            metres_per_unit: Metres in a unit of a path that is a drawing.
            trajectory_run: Run of recipe `gmd_trajectory` that generates the ground path first.
            held_out: Number of held-out items; each of the first ones gives a sample.
            source: Dataset that contains the phrase, instead of the run's own.
            continue_from: Motion file to continue: the sample begins with its last frames, a
                quarter of the training length.
            keep: Frames taken unchanged from `keep_from`, at the same positions:
                `"0..30,90..120"` or `[(0, 30), (90, 120)]`, without the ends.
            keep_from: Motion file that contains the frames of `keep`.
            postprocess: Repairs of the generated phrase: `"default"`, `"ccmotion"` (exactly
                CC-MotionGen's) or `"none"`.
            style: Style of the sample, for runs with `model.style`: a label, such as `"waltz"`, or
                eight numbers in the units of the motion's style channels.
            best_of: Number of samples of each condition of which the best is returned.
            select_by: What `best_of` compares, the first measure first: `"checks"`, `"beat"` (of
                phrases), `"goal"` (or path), `"skating"` (of bodies), `"text"` (of clips).
                `record["selection"]` has the scores of all.
            count: Samples per condition.
            frames: Frames to generate; by default the length of the condition.
            seconds: Seconds to generate, instead of `frames`.
            seed: Random seed of the noise.
            steps: Number of denoising steps.
            guidance_scale: Classifier-free guidance scale; 1 disables guidance.
            settings: Keys of the `sampling` table, such as
                `{"sampling.sampler.kind": "dpmpp_2m"}`.
            weights: `"ema"` for the exponential moving average, `"model"` for the trained weights.
            device: Device to run on, by default that of the run.
            progress: Called with stage, denoising steps done and in total; `None` for a bar if
                standard error is a terminal, `False` for no progress. An exception that it raises
                ends the call.

        Raises:
            UsageError: For conditions that the model does not support.
            Error: Anything else; see `kinegrad.errors`.
            KeyboardInterrupt: On Ctrl-C, after the denoising step.
        """
        if goal is None:
            goals: list[PathArgument] = []
        elif isinstance(goal, (str, Path)) or hasattr(goal, "__fspath__"):
            goals = [goal]
        else:
            goals = list(goal)
        if style is not None and not isinstance(style, str):
            style = ",".join(repr(float(number)) for number in style)
        frames_kept = keep
        if keep is not None and not isinstance(keep, str):
            frames_kept = ",".join(f"{start}..{end}" for start, end in keep)
        request = {
            "source": source,
            "item": item,
            "audio_features": audio_features,
            "audio": audio,
            "start": float(start),
            "goal": goals,
            "trajectory_run": _run_path(trajectory_run),
            "text": text,
            "text_encoder": text_encoder,
            "text_embedding": text_embedding,
            "history": history,
            "prompts": prompts,
            "path": path,
            "metres_per_unit": None if metres_per_unit is None else float(metres_per_unit),
            "held_out": held_out,
            "count": count,
            "frames": frames,
            "seconds": None if seconds is None else float(seconds),
            "seed": seed,
            "continue_from": continue_from,
            "keep": frames_kept,
            "keep_from": keep_from,
            "postprocess": postprocess,
            "best_of": best_of,
            "select_by": list(select_by),
            "style": style,
        }
        model = self._model(settings, steps, guidance_scale, weights, device)
        with reporting(progress, "denoising steps") as report:
            samples = _kinegrad.sample(model, request, report)
        return [Sample(sample) for sample in samples]

    def evaluate(
        self,
        *,
        source: str | None = None,
        songs: PathArgument | None = None,
        num_samples: int | None = None,
        num_frames: int | None = None,
        trajectory_run: PathArgument | Run | None = None,
        audio_ablation: bool = False,
        seed: int = 0,
        steps: int | None = None,
        guidance_scale: float | None = None,
        settings: Mapping[str, Any] | Sequence[str] | None = None,
        weights: Literal["ema", "model"] = "ema",
        device: str | None = None,
        progress: ProgressArgument = None,
    ) -> dict[str, Any]:
        """Evaluates the model on held-out motion: the numbers of `kinegrad eval --json` for one
        run. docs/evaluation.md defines them.

        Args:
            source: Dataset whose held-out items are used, instead of the run's own.
            songs: Folder of songs without motion, or a song, instead of held-out phrases.
            num_samples: Most samples in total.
            num_frames: Most frames of a sample: phrases are cut, songs are divided.
            trajectory_run: Run of recipe `gmd_trajectory` for two-stage sampling.
            audio_ablation: Compares each phrase's own music with silence and altered music.
            seed: Random seed of the noise.
            steps: Number of denoising steps.
            guidance_scale: Classifier-free guidance scale.
            settings: Keys of the tables `sampling` and `evaluation`, such as
                `{"evaluation.seeds": 4}`.
            weights: `"ema"` or `"model"`.
            device: Device to run on.
            progress: As in `sample`.

        Raises:
            Error: As `sample`.
            KeyboardInterrupt: On Ctrl-C, after the denoising step.
        """
        model = self._model(settings, steps, guidance_scale, weights, device)
        request = {
            "source": source,
            "songs": songs,
            "num_samples": num_samples,
            "num_frames": num_frames,
            "trajectory_run": _run_path(trajectory_run),
            "audio_ablation": audio_ablation,
            "seed": seed,
        }
        with reporting(progress, "denoising steps") as report:
            text = _kinegrad.evaluate(model, request, report)
        evaluated: dict[str, Any] = json.loads(text)
        return evaluated

    def dataset(self, split: Literal["train", "validation"] = "train") -> Dataset:
        """The run's own dataset, whose batches are normalised by the run's statistics."""
        return Dataset(run=self._path, split=split)

    def _model(
        self,
        settings: Mapping[str, Any] | Sequence[str] | None,
        steps: int | None,
        guidance_scale: float | None,
        weights: Literal["ema", "model"],
        device: str | None,
    ) -> dict[str, Any]:
        overrides = as_overrides(settings)
        if steps is not None:
            overrides.append(f"sampling.sampler.num_inference_steps={steps}")
        if guidance_scale is not None:
            overrides.append(f"sampling.sampler.guidance_scale={float(guidance_scale)!r}")
        return {"run": self._path, "settings": overrides, "weights": weights, "device": device}

    def __repr__(self) -> str:
        return f"<kinegrad.Run {self._path} at step {self._step}>"


def _run_path(run: PathArgument | Run | None) -> Path | None:
    if isinstance(run, Run):
        return run.path
    return None if run is None else Path(run)


def train(
    config: PathArgument = "kinegrad.toml",
    overrides: Mapping[str, Any] | Sequence[str] | None = None,
    *,
    runs_dir: PathArgument | None = None,
    resume: bool = False,
    on_step: Callable[[StepReport], object] | None = None,
    progress: bool | None = None,
) -> Run:
    """Trains a run to its end, as `kinegrad train` does.

    Args:
        config: The config file.
        overrides: Keys of the config, such as `{"train.max_steps": 100}`.
        runs_dir: Folder that contains the runs; `None` for the environment variable
            `KINEGRAD_RUNS_DIR`, else `runs`.
        resume: Continue the run from its latest valid checkpoint.
        on_step: Called after each optimiser step. Its exceptions are raised here, after a
            checkpoint has been written.
        progress: Whether to show a bar; `None` if standard error is a terminal.

    Returns:
        The run, opened at its best checkpoint.

    Raises:
        ConfigError: For an invalid config; no file has been written then.
        Error: Anything else; see `kinegrad.errors`.
        KeyboardInterrupt: On Ctrl-C, after a checkpoint has been written; `resume=True` continues.
    """
    shows = sys.stderr.isatty() if progress is None and sys.stderr is not None else bool(progress)
    bar = Bar("steps")

    def event(kind: str, fields: dict[str, Any]) -> None:
        if kind == "warning":
            sys.stderr.write(f"warning: {fields['text']}\n")
        elif kind == "step":
            if shows:
                bar(f"loss {fields['loss']:.4f}", fields["step"], fields["max_steps"])
            if on_step is not None:
                on_step(fields)  # type: ignore[arg-type]

    with bar:
        folder = _kinegrad.train(config, as_overrides(overrides), runs_dir, resume, event)
    return Run(folder)
