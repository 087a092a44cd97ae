"""PyTorch's process of `scripts/loader/run`: a `DataLoader` over the phrases of a folder.

    torch_loader.py FOLDER WORKERS CACHED WARM_UP_EPOCHS

Loads like CC-MotionGen, section 6.1 (docs/sources.md, section 1.1), with kinegrad's normalisation of
motion. Answers are those of kinegrad's process, `crates/data/examples/loader_speed.rs`.
"""

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, RandomSampler

BATCH_SIZE = 32
FRAMES = 120
FEATURES = ("mel", "chroma", "mfcc", "rms", "spectral_centroid", "onset_strength")
ENDLESS = 10**12
"""Number of samples: more than any measurement uses."""


class Phrases(Dataset[tuple[Tensor, Tensor]]):
    """Motion `[25, 120]`, normalised, and audio features `[163, 120]` of each phrase."""

    def __init__(self, folder: Path, cached: bool) -> None:
        statistics = json.loads((folder / "statistics.json").read_text())
        self.mean = np.array(statistics["mean"], np.float32)
        self.std = np.array(statistics["std"], np.float32)
        self.folder = folder
        self.ids = sorted(path.name for path in (folder / "motion").iterdir())
        self.cached = cached
        self.cache: dict[int, tuple[Tensor, Tensor]] = {}
        """Each worker process has its own."""

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        if index in self.cache:
            return self.cache[index]
        name = self.ids[index]
        with np.load(self.folder / "audio_features" / name / "features.npz") as archive:
            audio = np.concatenate([np.atleast_2d(archive[feature]) for feature in FEATURES])
        motion = np.load(self.folder / "motion" / name / "trajectory.npy")
        frames = min(motion.shape[0], audio.shape[1], FRAMES)
        motion = (motion[:frames] - self.mean) / self.std
        audio = audio[:, :frames]
        if frames < FRAMES:
            motion = np.concatenate([motion, np.zeros((FRAMES - frames, 25), np.float32)])
            audio = np.concatenate([audio, np.zeros((163, FRAMES - frames), np.float32)], axis=1)
        sample = torch.from_numpy(motion.T).float(), torch.from_numpy(audio).float()
        if self.cached:
            self.cache[index] = sample
        return sample


def batches(phrases: Phrases, workers: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Endless batches. The sampler is that of `shuffle=True`, one permutation after another,
    without `DataLoader`'s pause after each."""
    sampler = RandomSampler(phrases, num_samples=ENDLESS)
    loader = DataLoader(phrases, batch_size=BATCH_SIZE, sampler=sampler, num_workers=workers)
    return iter(loader)


def main() -> None:
    """Measures on request."""
    folder, workers, cached, epochs = Path(sys.argv[1]), *map(int, sys.argv[2:])
    phrases = Phrases(folder, bool(cached))
    stream = batches(phrases, workers)
    batches_per_epoch = len(phrases) // BATCH_SIZE
    sums = {"motion": 0.0, "audio": 0.0}
    for _ in range(batches_per_epoch):
        motion, audio = next(stream)
        sums["motion"] += motion.double().abs().sum().item()
        sums["audio"] += audio.double().abs().sum().item()
    print(json.dumps(sums), flush=True)
    for _ in range(batches_per_epoch * epochs):
        next(stream)
    for line in sys.stdin:
        seconds = float(line)
        # Batches that were prepared in advance do not count.
        for _ in range(2 * workers + 1):
            next(stream)
        start, samples = time.perf_counter(), 0
        while time.perf_counter() - start < seconds:
            motion, _ = next(stream)
            samples += len(motion)
        print(samples / (time.perf_counter() - start), flush=True)


if __name__ == "__main__":
    main()
