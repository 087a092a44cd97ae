"""Datasets as sequences of arrays, and the stream of training batches."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _kinegrad
from ._settings import Path as PathArgument
from ._settings import overrides

__all__ = ["Batches", "Dataset"]

Item = dict[str, Any]


class Dataset(Sequence[Item]):
    """One split of a dataset: a sequence of dictionaries.

    A phrase has `id`, `motion` `[T, 25]` float32 and `audio` `[163, T]` float32 (`[170, T]` with
    the beats in `data.audio_features`), as stored. A clip has `id`, `motion` `[T, 263]` or `[T, 251]`
    with the root encoding of the model, and `captions`. Items are read on demand and cached
    (`data.cache`).

    A dataset can be sent to other processes, such as the workers of a PyTorch `DataLoader`, forked
    or not: each process opens it again with new threads and connections.

    Args:
        source: A config file (`.toml`), or the address of a dataset: a folder, a bucket
            (`gs://`, `s3://`) or a web server.
        split: `"train"` or `"validation"`.
        settings: Keys of the config, such as `{"data.validation.fraction": 0.1}`.
        run: A run, instead of `source`: its dataset with its statistics.

    Raises:
        DataError: For a dataset that cannot be used.
        ConfigError: For invalid settings.
    """

    def __init__(
        self,
        source: PathArgument | None = None,
        split: Literal["train", "validation"] = "train",
        *,
        settings: Mapping[str, Any] | Sequence[str] | None = None,
        run: PathArgument | None = None,
    ) -> None:
        if (source is None) == (run is None) and not (run is None and settings):
            raise TypeError("a dataset has a `source`, or a `run`")
        if run is not None and settings:
            raise TypeError("the dataset of a `run` has its settings")
        place = None if source is None else os.fspath(source)
        folder = None if run is None else os.fspath(run)
        self._arguments = (place, folder, overrides(settings), split)
        self._process = os.getpid()
        self._opened: _kinegrad.Dataset | None = _kinegrad.Dataset(*self._arguments)

    @property
    def _native(self) -> _kinegrad.Dataset:
        if self._opened is None or self._process != os.getpid():
            if self._opened is not None:
                # It belongs to the parent process, whose threads do not exist here.
                _kinegrad.abandon(self._opened)
            self._opened = _kinegrad.Dataset(*self._arguments)
            self._process = os.getpid()
        return self._opened

    def __getstate__(self) -> dict[str, Any]:
        return {"_arguments": self._arguments, "_process": -1, "_opened": None}

    @property
    def ids(self) -> list[str]:
        """The ids, in order."""
        return self._native.ids()

    @property
    def config(self) -> dict[str, Any]:
        """The `data` table of the config, with all defaults filled in."""
        table: dict[str, Any] = json.loads(self._native.config)
        return table

    @property
    def fps(self) -> float:
        """Frames per second of the motion."""
        return self._native.fps

    @property
    def warnings(self) -> list[str]:
        """Warnings about the dataset."""
        return self._native.warnings

    @property
    def mean(self) -> NDArray[np.float64]:
        """The mean of each channel, `[channels]`, which normalises the batches."""
        return np.array(self._native.statistics()[0])

    @property
    def std(self) -> NDArray[np.float64]:
        """The standard deviation of each channel, which normalises the batches."""
        return np.array(self._native.statistics()[1])

    def __len__(self) -> int:
        return len(self._native)

    def __getitem__(self, key: Any) -> Any:
        """Item by position or id; a slice gives a list."""
        if isinstance(key, slice):
            return [self[position] for position in range(*key.indices(len(self)))]
        if isinstance(key, str):
            try:
                key = self.ids.index(key)
            except ValueError:
                raise KeyError(key) from None
        position = key.__index__()
        if position < 0:
            position += len(self)
        if not 0 <= position < len(self):
            raise IndexError(f"item {key} of {len(self)}")
        return self._native.item(position)

    def __iter__(self) -> Iterator[Item]:
        for position in range(len(self)):
            yield self[position]

    def batches(
        self,
        seed: int | None = None,
        batch_size: int | None = None,
        *,
        first: int = 0,
        num_workers: int = 0,
    ) -> Batches:
        """The endless stream of batches of a training with this `seed`: cropped, augmented and
        normalised, each a dictionary of `ids`, `motion` `[B, C, T]`, the condition (`audio`
        `[B, 163, T]`, or `text` `[B, 512, 1]`), and `mask` `[B, T]`, 1 in valid frames.

        A batch depends only on seed, batch size and number.

        Args:
            seed: Seed of order, crops and augmentation; by default `run.seed` of the config.
            batch_size: Samples in a batch; by default `data.batch_size`.
            first: Number of the first batch.
            num_workers: Threads that prepare batches ahead; with 0 batches are prepared on demand.
        """
        return Batches(self, seed, batch_size, first, num_workers)

    def __repr__(self) -> str:
        place, folder, _, split = self._arguments
        return f"<kinegrad.Dataset {place or folder or 'synthetic'} ({split}), {len(self)} items>"


class Batches(Iterator[Item]):
    """The stream of training batches; see `Dataset.batches`."""

    def __init__(
        self,
        dataset: Dataset,
        seed: int | None,
        batch_size: int | None,
        first: int,
        num_workers: int,
    ) -> None:
        self._dataset = dataset
        self._seed = seed
        self._batch_size = batch_size
        self._number = first
        self._num_workers = num_workers
        self._process = -1
        self._started: _kinegrad.Batches | None = None
        self._start()

    def _start(self) -> _kinegrad.Batches:
        if self._started is None or self._process != os.getpid():
            if self._started is not None:
                _kinegrad.abandon(self._started)
            native = self._dataset._native
            seed = native.seed if self._seed is None else self._seed
            self._started = native.batches(
                seed, self._batch_size, self._num_workers, self._number
            )
            self._process = os.getpid()
        return self._started

    @property
    def number(self) -> int:
        """The number of the next batch."""
        return self._number

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_process": -1, "_started": None}

    def __next__(self) -> Item:
        batch = self._start().next_batch()
        self._number += 1
        return batch
