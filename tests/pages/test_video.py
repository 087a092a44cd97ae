"""Videos of ffmpeg, read by ffprobe."""

import json
import subprocess

import material


def probed(path):
    words = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return {stream["codec_type"]: stream for stream in json.loads(done.stdout)["streams"]}


def test_a_video_is_as_long_as_the_motion_and_has_its_song(kinegrad, tmp_path):
    kinegrad("data", "synth", "--out", "data", "--phrases", 1, "--frames", 90, cwd=tmp_path)
    motion = next((tmp_path / "data" / "motion").rglob("trajectory.npy"))
    material.write_song(tmp_path / "song.wav", seconds=8)
    kinegrad("view", motion, "--mp4", "silent.mp4", cwd=tmp_path)
    kinegrad("view", motion, "--audio", "song.wav", "--start", 2, "--mp4", "song.mp4", cwd=tmp_path)
    silent, sung = probed(tmp_path / "silent.mp4"), probed(tmp_path / "song.mp4")
    assert set(silent) == {"video"} and set(sung) == {"video", "audio"}
    for streams in (silent, sung):
        assert abs(float(streams["video"]["duration"]) - 3.0) < 0.1
    assert abs(float(sung["audio"]["duration"]) - 3.0) < 0.2
    assert list(tmp_path.glob("*.tmp")) == []
