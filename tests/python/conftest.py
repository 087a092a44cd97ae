"""Shared fixtures of the Python tests: the command line to compare with, and tiny runs."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import kinegrad

ROOT = Path(__file__).resolve().parents[2]

PHRASES = """
[run]
name = "phrases"
seed = 3
device = "cpu"

[data]
kind = "synthetic"
target_frames = 24
batch_size = 4
num_workers = 0

[data.synthetic]
phrases = 12
frames = 30

[data.validation]
fraction = 0.3

[model]
size = "tiny"

[train]
max_steps = 6

[validation]
every_steps = 3

[sampling]
count_at_end = 2

[sampling.sampler]
num_inference_steps = 4
"""

# Settings that make the shipped configs of clips small.
SMALL = [
    "data.synthetic.phrases=24",
    "data.validation.fraction=0.3",
    "data.batch_size=4",
    "train.max_steps=4",
    "validation.every_steps=0",
    "sampling.sampler.num_inference_steps=4",
]


@pytest.fixture(scope="session")
def binary():
    """The command line that the package is compared with."""
    path = os.environ.get("KINEGRAD_BINARY")
    assert path, "KINEGRAD_BINARY names the command line to compare with; see scripts/test_python"
    return Path(path).resolve()


@pytest.fixture(scope="session")
def command(binary):
    """Runs the command line and returns its output."""

    def run(*arguments, code=0):
        done = subprocess.run(
            [binary, *map(str, arguments)], capture_output=True, text=True, check=False
        )
        assert done.returncode == code, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def runs(tmp_path_factory, command):
    """Folder of the runs `phrases`, `clips` and `paths`, and of `phrases.toml`."""
    folder = tmp_path_factory.mktemp("runs")
    config = folder / "phrases.toml"
    config.write_text(PHRASES)
    command("train", config, "--runs-dir", folder)
    for name, recipe in [("clips", "gmd_motion"), ("paths", "gmd_trajectory")]:
        small = [word for setting in SMALL for word in ("--set", setting)]
        shipped = ROOT / "configs" / f"{recipe}_tiny.toml"
        command("train", shipped, "--runs-dir", folder, "--name", name, *small)
    return folder


@pytest.fixture(scope="session")
def phrases(runs):
    return kinegrad.Run(runs / "phrases")


@pytest.fixture(scope="session")
def clips(runs):
    return kinegrad.Run(runs / "clips")


@pytest.fixture(scope="session")
def song(tmp_path_factory):
    """Four seconds of clicks and a tone, as a wave file."""
    import wave

    rate = 22050
    time = np.arange(4 * rate) / rate
    clicks = (time % 0.5 < 0.02) * np.sin(2 * np.pi * 1000 * time)
    signal = 0.3 * np.sin(2 * np.pi * 220 * time) + 0.6 * clicks
    path = tmp_path_factory.mktemp("song") / "song.wav"
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes((signal * 32000).astype("<i2").tobytes())
    return path
