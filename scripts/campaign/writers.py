"""Files that deviate as those of real programs do are read as they are meant, or refused."""

import array
import math
import re
import statistics
import zipfile
from pathlib import Path

import bvh_frames
import bvh_writers
import wav_writers
from attack import Attack
from case import Case
from judge import INVALID, SUCCESS, pattern
from process import Ended

TOLERANCE = 1e-3
"""Of a place, centimetres."""
SECONDS = 0.011
"""Of the printed length of a song."""
SHARE = 0.05
"""Of the loudness, which is 1 in the loudest part."""
FRAMES = re.compile(r"^Frames:\s*(\d+)\s*$", re.MULTILINE)
TIME = re.compile(r"^Frame Time:\s*(\S+)\s*$", re.MULTILINE)


class Writers(Attack):
    """BVH and WAV files with the deviations of exporters and recorders."""

    name = "writers"
    weight = 4

    def attack(self, case: Case) -> None:
        """A file of each format in turn."""
        (self.motion, self.song)[case.number % 2](case)

    def motion(self, case: Case) -> None:
        """A BVH file comes back with the frames and places that it has."""
        said, written = bvh_writers.written_by(case.random)
        case.label = "bvh"
        (case.folder / "motion.bvh").write_bytes(written.content)
        units = ["--units", "cm", "--up", "y"]
        ended = case.run("view", "motion.bvh", *units, "--bvh", "out.bvh", allowed=(0, 2))
        if self.is_read(case, ended, said, written.must_read, written.may_read):
            wrong = bvh_differs((case.folder / "out.bvh").read_text(), written)
            self.compared(case, ended, said, wrong)

    def song(self, case: Case) -> None:
        """A WAV file has its length and its loudness."""
        said, written = wav_writers.written_by(case.random)
        case.label = "wav"
        (case.folder / "song.wav").write_bytes(written.content())
        ended = case.run("audio", "features", "song.wav", "--out", "out", allowed=(0, 2))
        if self.is_read(case, ended, said, written.must_read, True):
            wrong = wav_differs(ended.stdout, case.folder / "out/song/features.npz", written)
            self.compared(case, ended, said, wrong)

    def compared(self, case: Case, ended: Ended, said: str, wrong: str) -> None:
        """Records a difference of a file with the deviations `said`."""
        if wrong:
            found = f"{said}: {wrong}"
            case.wrong("misread", re.sub(r"\d[\d.]*", "N", wrong), found, "what the file says", ended)

    def is_read(self, case: Case, ended: Ended, said: str, must: bool, may: bool) -> bool:
        """True if a file is read; records what must or must not be."""
        case.counts["read"] += ended.code == SUCCESS
        case.counts["refused"] += ended.code == INVALID
        if must and ended.code == INVALID:
            found = f"{said}: {ended.stderr.strip()[:300]}"
            case.wrong("refused", pattern(ended), found, "it is read", ended)
        if not may and ended.code == SUCCESS:
            case.wrong("accepted", said, f"{said}: exit code 0", "exit code 2 with a reason", ended)
        return may and ended.code == SUCCESS


def bvh_differs(text: str, written: bvh_frames.Written) -> str:
    """The first difference of a BVH file from what was meant; empty if none."""
    head, _, motion = text.partition("MOTION")
    frames, time = int(FRAMES.search(motion)[1]), float(TIME.search(motion)[1])
    if frames not in written.counts:
        return f"{frames} frames, not {' or '.join(map(str, sorted(written.counts)))}"
    if not math.isclose(time, written.frame_time, rel_tol=1e-4):
        return f"a frame time of {time}, not {written.frame_time}"
    if "OFFSET" not in head:
        return "no hierarchy"
    rows = [line.split() for line in motion.splitlines()[3:] if line.strip()]
    for number, (row, place) in enumerate(zip(rows, written.places, strict=False)):
        if any(abs(float(value) - axis) > TOLERANCE for value, axis in zip(row, place)):
            return f"frame {number} begins with {' '.join(row[:3])}, not {place}"
    return ""


def wav_differs(table: str, features: Path, written: wav_writers.Written) -> str:
    """The first difference of the features of a song from what was meant; empty if none."""
    row = next((line.split("|") for line in table.splitlines() if "song.wav" in line), [])
    if len(row) < 3:
        return f"no row of the song in {table[:200]!r}"
    seconds = written.frames / written.rate
    if abs(float(row[1]) - seconds) > SECONDS:
        return f"{row[1].strip()} s, not {seconds:.3f}"
    with zipfile.ZipFile(features) as archive:
        content = archive.read("rms.npy")
    numbers = array.array("f")
    numbers.frombytes(content[10 + int.from_bytes(content[8:10], "little"):])
    # Relative to the loudest part.
    loud = statistics.median(numbers[:len(numbers) // 3])
    quiet = statistics.median(numbers[-len(numbers) // 3:])
    meant = wav_writers.QUIET / wav_writers.LOUD
    if abs(loud - 1) > SHARE or abs(quiet - meant) > SHARE:
        return f"loudnesses of {loud:.4f} and {quiet:.4f}, not 1 and {meant}"
    return ""
