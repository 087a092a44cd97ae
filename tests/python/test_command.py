"""The command line that the wheel installs."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

INSTALLED = Path(sys.executable).with_name("kinegrad")


def ran(*arguments):
    return subprocess.run(
        [INSTALLED, *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_it_is_the_command_line(command, phrases, tmp_path):
    for arguments in [["--help"], ["--version"], ["sample", "--help"], ["devices"]]:
        done = ran(*arguments)
        assert done.returncode == 0 and done.stderr == ""
        if "devices" not in arguments:
            assert done.stdout == command(*arguments)
    module = [sys.executable, "-m", "kinegrad", "--version"]
    assert subprocess.run(module, capture_output=True, check=True).stdout
    assert ran("sample", phrases.path, "--out", tmp_path / "x").returncode == 0
    command("sample", phrases.path, "--out", tmp_path / "y")
    assert (tmp_path / "x.npy").read_bytes() == (tmp_path / "y.npy").read_bytes()


def test_exit_codes(tmp_path):
    done = ran("sample", tmp_path / "none", "--out", tmp_path / "x")
    assert done.returncode == 2 and done.stderr.startswith("error: ")
    assert ran("no-such-command").returncode == 2
    done = ran("train", tmp_path / "none.toml")
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_ctrl_c_ends_it(phrases, runs, tmp_path):
    sampling = ["sample", phrases.path, "--steps", "1000", "--count", "4000"]
    training = ["train", runs / "phrases.toml", "--set", "train.max_steps=100000"]
    training += ["--runs-dir", tmp_path]
    for arguments, codes in [
        ([*sampling, "--out", tmp_path / "x"], (-signal.SIGINT, 130)),
        (training, (130,)),
    ]:
        process = subprocess.Popen(
            [INSTALLED, *map(str, arguments)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(2.5)
        assert process.poll() is None
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(timeout=30) in codes
    steps = list((tmp_path / "phrases" / "checkpoints").glob("step-*"))
    assert steps, "a training that is stopped writes a checkpoint"
