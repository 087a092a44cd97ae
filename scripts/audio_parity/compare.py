"""Compares features.npz files with librosa 0.11 under CC-MotionGen's definitions.

compare.py KINEGRAD SONG...  Runs `KINEGRAD audio features` and librosa in turn, librosa once
beforehand on noise so that its compilation is not counted. kinegrad's time is that of the whole
process, including start and output; librosa's begins with loading the song.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import librosa
import numpy as np

SR, HOP, N_FFT = 44100, 1470, 2048
EPSILON = 1e-8


def min_max(x):
    return (x - x.min()) / (x.max() - x.min() + EPSILON)


def reference(y):
    """The seven features, tempo and beat times, each computed on its own as CC-MotionGen does."""
    frames = dict(sr=SR, hop_length=HOP)
    mel = librosa.feature.melspectrogram(y=y, n_mels=128, fmin=20, fmax=8000, n_fft=N_FFT, **frames)
    chroma = librosa.feature.chroma_cqt(y=y, **frames)
    mfcc = librosa.feature.mfcc(y=y, n_mfcc=20, n_fft=N_FFT, **frames)
    rms = librosa.feature.rms(y=y, frame_length=N_FFT, hop_length=HOP)[0]
    centroid = librosa.feature.spectral_centroid(y=y, n_fft=N_FFT, **frames)[0]
    onset = librosa.onset.onset_strength(y=y, **frames)
    tempo, beats = librosa.beat.beat_track(y=y, **frames)
    mean, std = mfcc.mean(1, keepdims=True), mfcc.std(1, keepdims=True)
    return {
        "mel": min_max(librosa.power_to_db(mel, ref=np.max)),
        "chroma": chroma,
        "mfcc": (mfcc - mean) / (std + EPSILON),
        "rms": rms / (rms.max() + EPSILON),
        "spectral_centroid": min_max(centroid),
        "onset_strength": onset / (onset.max() + EPSILON),
        "tempo": float(np.atleast_1d(tempo)[0]),
        "beat_times": librosa.frames_to_time(beats, **frames),
    }


def differences(ours, theirs):
    """One line for each feature: mean and largest difference, correlation."""
    for name, expected in theirs.items():
        found = ours[name]
        if name == "tempo":
            print(f"  {name:18} {float(found[0]):9.4f} {expected:9.4f}")
        elif name == "beat_times":
            equal = found.shape == expected.shape and np.allclose(found, expected, atol=1e-6)
            print(f"  {name:18} {len(found)} and {len(expected)} beats, {'equal' if equal else 'different'}")
        else:
            assert found.shape == expected.shape, (name, found.shape, expected.shape)
            difference = np.abs(found - expected)
            correlation = np.corrcoef(found.ravel(), expected.ravel())[0, 1]
            print(
                f"  {name:18} mean {difference.mean():.2e}  max {difference.max():.2e}"
                f"  correlation {correlation:.7f}"
            )


def main():
    kinegrad, songs = sys.argv[1], sys.argv[2:]
    reference(np.random.default_rng(0).normal(0, 0.1, 4 * SR).astype(np.float32))
    with tempfile.TemporaryDirectory() as folder:
        for song in songs:
            npz = Path(folder) / Path(song).stem / "features.npz"
            command = [kinegrad, "audio", "features", song, "--out", folder]
            start = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            ours = time.perf_counter() - start

            start = time.perf_counter()
            y, _ = librosa.load(song, sr=SR, mono=True)
            theirs = reference(y)
            librosas = time.perf_counter() - start
            seconds = len(y) / SR

            print(f"{Path(song).name}: {seconds:.1f} s")
            differences(np.load(npz), theirs)
            print(
                f"  {seconds / ours:.0f} x real time, librosa {seconds / librosas:.1f} x:"
                f" {librosas / ours:.1f} times as fast"
            )


if __name__ == "__main__":
    main()
