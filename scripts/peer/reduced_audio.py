"""The reference clips in fewer bytes: recordings as FLAC, without large tensors whose stage another
tensor of the same clip covers.

One clip of several seconds, `chords`, and the two shortest keep all tensors.
"""

import shutil
from pathlib import Path

import numpy as np
import soundfile
from safetensors.torch import save_file

from golden import Golden

SMALL = 8192
"""Size of an unchanged recording, bytes."""

POWER = ["mel_power"]
"""`mel_db` is the same in decibels."""
MEL = ["mel_power", "mel_db"]
"""The first 128 rows of `stacked` are `mel_db` scaled to 0..1."""
SPECTRUM = ["stft_mag_frames", "stft_mag_frames_idx"]
"""`mel_full_db` or `stacked` is computed from it."""
CQT = ["cqt_mag"]
"""`chroma_unnorm` is its sum over octaves."""
STAGES = [*SPECTRUM, *MEL, *CQT, "mel_full_db", "mfcc_raw", "chroma_unnorm"]
"""All of these end in `stacked`."""

LEFT_OUT = {
    "chords": [],
    "drum120": MEL + CQT,
    "edge_dc": STAGES,
    "edge_padded_silence": MEL + CQT,
    "edge_quiet": POWER + CQT,
    "edge_short": [],
    "edge_silence": POWER + CQT,
    "edge_single_frame": [],
    "mono22k_detuned": MEL + CQT,
    "stereo48k": MEL + CQT,
    "sweep": MEL,
}
"""Of each clip."""


def reduce(source: Path, folder: Path) -> None:
    """Writes all clips."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, left_out in LEFT_OUT.items():
        tensors = dict(Golden(source, name).tensors)
        for key in left_out:
            del tensors[key]
        path = folder / f"{name}.safetensors"
        save_file(tensors, path)
        path.chmod(0o644)
        pack(source / f"{name}.wav", folder)


def pack(wav: Path, folder: Path) -> None:
    """Writes a recording as FLAC and reads it again: no sample may change."""
    if wav.stat().st_size <= SMALL:
        shutil.copyfile(wav, folder / wav.name)
        return
    form = soundfile.info(wav)
    assert form.subtype == "PCM_16", f"{wav.name} has samples of {form.subtype}"
    samples, rate = soundfile.read(wav, dtype="int16", always_2d=True)
    flac = folder / f"{wav.stem}.flac"
    soundfile.write(flac, samples, rate, subtype="PCM_16", compression_level=1.0)
    again, again_rate = soundfile.read(flac, dtype="int16", always_2d=True)
    assert again_rate == rate and np.array_equal(samples, again), f"{flac.name} is not {wav.name}"
