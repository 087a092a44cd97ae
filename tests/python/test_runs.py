"""Runs from Python equal those of the command line, byte for byte."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import kinegrad

from conftest import ROOT


def files(folder):
    """The files of a folder by name, without paths and times."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def same_files(made, expected):
    made, expected = files(made), files(expected)
    assert list(made) == list(expected)
    for name, contents in expected.items():
        assert made[name] == contents, name
    return expected


def compare(command, run, folder, options, **arguments):
    """Samples by the command line and from Python, and compares the files; the samples."""
    (folder / "cli").mkdir()
    (folder / "python").mkdir()
    command("sample", run.path, "--out", folder / "cli" / "x", *options)
    samples = run.sample(progress=False, **arguments)
    saved = [path for sample in samples for path in sample.save(folder / "python" / "x")]
    assert sorted(path.name for path in saved) == sorted(files(folder / "python"))
    same_files(folder / "python", folder / "cli")
    return samples


def test_samples_of_phrases(command, phrases, tmp_path):
    options = ["--count", "2", "--seed", "7", "--steps", "3", "--guidance-scale", "1.5"]
    samples = compare(
        command, phrases, tmp_path, options, count=2, seed=7, steps=3, guidance_scale=1.5
    )
    assert [sample.name for sample in samples] == ["-000", "-001"]
    for index, sample in enumerate(samples):
        stem = tmp_path / "cli" / f"x-00{index}"
        for array, ending in [(sample.motion, ".npy"), (sample.raw, ".raw.npy")]:
            expected = np.load(f"{stem}{ending}")
            assert array.dtype == np.float32 and array.shape == (30, 25)
            assert array.tobytes() == expected.tobytes()
        assert sample.features is None and sample.path is None
        assert sample.record["seed"] == 7 and sample.record["index"] == index
    with pytest.raises(kinegrad.UsageError, match="no skeleton"):
        samples[0].bvh()


def test_the_best_of_several_samples(command, phrases, tmp_path):
    options = ["--best-of", "3", "--select-by", "beat,checks", "--steps", "2"]
    by = ["beat", "checks"]
    (best,) = compare(command, phrases, tmp_path, options, best_of=3, select_by=by, steps=2)
    selection = best.record["selection"]
    assert selection["by"] == by and len(selection["scores"]) == 3
    assert selection["selected"] == min(range(3), key=selection["scores"].__getitem__)
    with pytest.raises(kinegrad.UsageError, match="skating"):
        phrases.sample(progress=False, best_of=3, select_by=["skating"])


def test_samples_of_which_frames_are_given(command, phrases, song, tmp_path):
    first = tmp_path / "first.npy"
    np.save(first, phrases.sample(steps=2, seed=3, progress=False)[0].motion)
    (tmp_path / "kept").mkdir()
    (tmp_path / "more").mkdir()
    options = ["--keep", "0..4,9..12", "--keep-from", first, "--steps", "2"]
    (sample,) = compare(
        command,
        phrases,
        tmp_path / "kept",
        [*options, "--postprocess", "none"],
        keep=[(0, 4), (9, 12)],
        keep_from=first,
        steps=2,
        postprocess="none",
    )
    given = np.load(first)
    assert (sample.motion[9:12] == given[9:12]).all() and (sample.motion[5] != given[5]).any()
    assert sample.record["condition"]["known_frames"]["frames"] == [[0, 4], [9, 12]]
    (sample,) = compare(
        command,
        phrases,
        tmp_path / "more",
        ["--audio", song, "--continue-from", first, "--steps", "2"],
        audio=song,
        continue_from=first,
        steps=2,
    )
    length = sample.record["condition"]["known_frames"]["frames"][0][1]
    assert (sample.motion[:length] == given[-length:]).all()
    assert sample.record["windows"]["count"] > 1
    for bad in [
        {"keep": "0..3"},
        {"keep_from": first},
        {"keep": "0..3", "keep_from": first, "continue_from": first},
        {"postprocess": "some"},
    ]:
        with pytest.raises(kinegrad.UsageError):
            phrases.sample(progress=False, **bad)


def test_samples_of_a_style(command, phrases, runs, tmp_path):
    settings = ["model.style=both", 'data.labels={"*_0000*" = "waltz", "*_0001*" = "tango"}']
    settings = [word for setting in settings for word in ("--set", setting)]
    command("train", runs / "phrases.toml", "--runs-dir", tmp_path, "--name", "styled", *settings)
    styled = kinegrad.Run(tmp_path / "styled")
    numbers = [0.8, -0.1, 0.5, 0.1, 1, 0.2, 0, 1e-5]
    for name, style, text in [
        ("label", "waltz", "waltz"),
        ("numbers", numbers, "0.8,-0.1,0.5,0.1,1,0.2,0,1e-5"),
        ("array", np.array(numbers), "0.8,-0.1,0.5,0.1,1,0.2,0,1e-5"),
    ]:
        (tmp_path / name).mkdir()
        options = ["--style", text, "--steps", "2"]
        (sample,) = compare(command, styled, tmp_path / name, options, style=style, steps=2)
        said = sample.record["condition"]["style"]
        assert said == ("waltz" if name == "label" else numbers)
    for bad, message in [
        ("foxtrot", "`tango`, `waltz`"),
        (numbers[:7], "7 numbers"),
        ([*numbers, 1], "9 numbers"),
        ([*numbers[:7], float("nan")], "not finite"),
    ]:
        with pytest.raises(kinegrad.UsageError, match=message):
            styled.sample(progress=False, style=bad)
    with pytest.raises(kinegrad.UsageError, match="model.style"):
        phrases.sample(progress=False, style="waltz")


def test_samples_of_songs_and_their_features(command, phrases, song, tmp_path):
    options = ["--audio", song, "--start", "1.5", "--frames", "20", "--no-ema"]
    (sample,) = compare(
        command, phrases, tmp_path, options, audio=song, start=1.5, frames=20, weights="model"
    )
    assert sample.motion.shape == (20, 25)

    command("audio", "features", song, "--out", tmp_path / "features")
    written = tmp_path / "features" / "song" / "features.npz"
    features = kinegrad.audio_features(song)
    features.save(tmp_path / "own.npz")
    assert (tmp_path / "own.npz").read_bytes() == written.read_bytes()
    arrays = np.load(written)
    parts = ["mel", "chroma", "mfcc", "rms", "spectral_centroid", "onset_strength"]
    stacked = np.concatenate([np.atleast_2d(arrays[name]) for name in parts])
    assert features.features.tobytes() == stacked.tobytes()
    assert features.features.shape == (163, 121) and len(features.channels) == 163
    np.testing.assert_allclose(features.beat_times, arrays["beat_times"], rtol=1e-6)
    assert arrays["tempo"].shape == ()
    assert features.tempo == pytest.approx(float(arrays["tempo"])) and features.seconds == 4.0

    (tmp_path / "npz").mkdir()
    compare(command, phrases, tmp_path / "npz", ["--audio-features", written], audio_features=written)


def test_samples_of_clips(command, clips, runs, tmp_path):
    goal = ROOT / "configs" / "goal.toml"
    options = ["--goal", goal, "--trajectory-run", runs / "paths", "--seed", "2"]
    (sample,) = compare(
        command,
        clips,
        tmp_path,
        options,
        goal=goal,
        trajectory_run=kinegrad.Run(runs / "paths"),
        seed=2,
    )
    assert sample.motion.shape == (64, 22, 3) and sample.features.shape == (64, 263)
    assert sample.path.shape == (64, 2)
    assert sample.bvh() == (tmp_path / "cli" / "x.bvh").read_text()
    assert set(sample.arrays) == {".npy", ".features.npy", ".path.npy"}


def test_evaluation(command, phrases, tmp_path):
    settings = {"evaluation.phrases": 2, "evaluation.seeds": 1}
    options = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    text = command("eval", phrases.path, *options, "--out", tmp_path, "--json")
    (expected,) = json.loads(text)["evaluations"]
    assert phrases.evaluate(settings=settings, progress=False) == expected
    assert phrases.evaluate(settings=settings, seed=1, progress=False) != expected
    text = command("eval", phrases.path, "--num-samples", "3", "--num-frames", "16", "--json")
    (expected,) = json.loads(text)["evaluations"]
    assert phrases.evaluate(num_samples=3, num_frames=16, progress=False) == expected
    with pytest.raises(kinegrad.Error, match="nowhere"):
        phrases.evaluate(songs=tmp_path / "nowhere", progress=False)


def test_training(runs, phrases, tmp_path, capfd):
    steps = []
    run = kinegrad.train(
        runs / "phrases.toml", runs_dir=tmp_path, on_step=lambda step: steps.append(step)
    )
    assert [step["step"] for step in steps] == [1, 2, 3, 4, 5, 6]
    assert run.step == phrases.step and run.config["train"]["max_steps"] == 6
    for part in ["model.safetensors", "ema.safetensors"]:
        assert (run.checkpoint / part).read_bytes() == (phrases.checkpoint / part).read_bytes()
    same = ["step", "loss", "grad_norm", "lr", "val_loss"]
    made, expected = run.metrics(), phrases.metrics()
    for name in same:
        np.testing.assert_array_equal(made[name], expected[name])
    assert made["step"].dtype == np.int64 and np.isnan(made["val_loss"]).any()
    arrays = sorted(path.name for path in (tmp_path / "phrases" / "samples").glob("*.npy"))
    assert len(arrays) == 4
    for name in arrays:
        expected_bytes = (runs / "phrases" / "samples" / name).read_bytes()
        assert (tmp_path / "phrases" / "samples" / name).read_bytes() == expected_bytes
    out, _ = capfd.readouterr()
    assert out == "", "the library prints no results"


def test_a_training_ended_by_its_callback_is_resumed(runs, phrases, tmp_path):
    def end(step):
        if step["step"] == 4:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        kinegrad.train(runs / "phrases.toml", runs_dir=tmp_path, on_step=end)
    run = kinegrad.train(runs / "phrases.toml", runs_dir=tmp_path, resume=True)
    weights = (run.checkpoint / "model.safetensors").read_bytes()
    assert weights == (phrases.checkpoint / "model.safetensors").read_bytes()


def test_progress_is_told_and_ends_the_call(phrases):
    told = []
    phrases.sample(steps=3, frames=10, progress=lambda *step: told.append(step))
    assert told == [("", 1, 3), ("", 2, 3), ("", 3, 3)]

    def end(stage, done, total):
        told.append(done)
        raise LookupError(f"after {done}")

    told.clear()
    with pytest.raises(LookupError, match="after 1"):
        phrases.sample(steps=50, frames=10, progress=end)
    assert told == [1]
    with pytest.raises(LookupError):
        phrases.evaluate(settings={"evaluation.phrases": 2}, progress=end)


def test_ctrl_c_interrupts_soon(phrases):
    def press():
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press)
    presser.start()
    with pytest.raises(KeyboardInterrupt):
        phrases.sample(steps=1000, count=4000, progress=False)
    presser.join()
    assert phrases.sample(steps=1, progress=False), "and the next call works"


def test_a_bar_is_shown_on_a_terminal(phrases):
    import pty

    code = f"import kinegrad; kinegrad.Run({str(phrases.path)!r}).sample(steps=3, frames=24)"
    ours, theirs = pty.openpty()
    done = subprocess.run([sys.executable, "-c", code], stderr=theirs, check=True)
    os.close(theirs)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert done.returncode == 0 and "3/3 denoising steps" in shown
    # A model of three steps moves unlike its training phrases, which is a warning.
    command = [sys.executable, "-W", "ignore", "-c", code]
    quiet = subprocess.run(command, capture_output=True, check=True)
    assert quiet.stdout == b"" and quiet.stderr == b""


def test_errors_are_those_of_the_command_line(binary, phrases, runs, tmp_path):
    def said(*arguments):
        done = subprocess.run(
            [binary, *map(str, arguments)], capture_output=True, text=True, check=False
        )
        return done.returncode, done.stderr

    cases = [
        (
            kinegrad.UsageError,
            lambda: phrases.sample(item="nobody"),
            ["sample", phrases.path, "--item", "nobody", "--out", tmp_path / "x"],
        ),
        (
            kinegrad.CheckpointError,
            lambda: kinegrad.Run(tmp_path / "none").sample(),
            ["sample", tmp_path / "none", "--out", tmp_path / "x"],
        ),
        (
            kinegrad.ConfigError,
            lambda: kinegrad.train(runs / "phrases.toml", {"optim.lerning_rate": 1}),
            ["train", runs / "phrases.toml", "--set", "optim.lerning_rate=1"],
        ),
        (
            kinegrad.DataError,
            lambda: kinegrad.audio_features(tmp_path / "none.mp3"),
            ["audio", "features", tmp_path / "none.mp3", "--out", tmp_path],
        ),
        (
            kinegrad.UsageError,
            lambda: phrases.sample(goal="goal.toml"),
            ["sample", phrases.path, "--goal", "goal.toml", "--out", tmp_path / "x"],
        ),
    ]
    for kind, call, arguments in cases:
        with pytest.raises(kind) as raised:
            call()
        code, text = said(*arguments)
        assert raised.value.exit_code == code == 2, arguments
        # The command line shows options as flags.
        text = re.sub(r"`--([a-z-]+)", lambda flag: "`" + flag[1].replace("-", "_"), text)
        assert raised.value.message in text and raised.value.hint in text
        assert isinstance(raised.value, kinegrad.Error)
        assert str(raised.value) == f"{raised.value.message}\nhint: {raised.value.hint}"
    for bad in [{"count": 0}, {"frames": 0}, {"start": 2.0}, {"weights": "none"}]:
        with pytest.raises(ValueError):
            phrases.sample(**bad)
    assert not list(tmp_path.iterdir()), "nothing was written"


def test_files_that_cannot_be_written(phrases, tmp_path):
    (sample,) = phrases.sample(steps=1)
    (tmp_path / "file").write_text("")
    with pytest.raises(kinegrad.Error) as raised:
        sample.save(tmp_path / "file" / "x")
    assert raised.value.exit_code in (1, 2)
    sample.save(tmp_path / "x")
    with pytest.raises(kinegrad.UsageError, match="x.npy exists already"):
        sample.save(tmp_path / "x")
    sample.save(tmp_path / "x", overwrite=True)
    with pytest.raises(kinegrad.UsageError, match="names no file"):
        sample.save(str(tmp_path) + "/")
