"""A job of several ranks in its own folder."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BINARY = os.environ["KINEGRAD_BINARY"]
LAUNCHER = os.environ.get("KINEGRAD_MPIRUN", "mpirun").split()
# One core is enough for a rank.
ENVIRONMENT = os.environ | {"RAYON_NUM_THREADS": "1"}
# Files that are equal for any number of ranks.
SAME = ("model.safetensors", "ema.safetensors", "optimizer.safetensors")


class Folder:
    """Runs in a temporary folder."""

    def __init__(self):
        self.path = Path(tempfile.mkdtemp(prefix="ranks-"))

    def remove(self):
        shutil.rmtree(self.path, ignore_errors=True)

    def command(self, ranks, arguments):
        launcher = [*LAUNCHER, "-n", str(ranks)] if ranks > 1 else []
        return [*launcher, BINARY, *arguments.split()]

    def start(self, ranks, arguments, **environment):
        """A job of ranks that do the same."""
        return self.launch(self.command(ranks, arguments), environment)

    def launch(self, command, environment):
        """A job, in a process group of its own."""
        return subprocess.Popen(
            command,
            cwd=self.path,
            env=ENVIRONMENT | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def run(self, ranks, arguments):
        """A job that must succeed; returns its output."""
        job = self.start(ranks, arguments)
        said, _ = job.communicate(timeout=600)
        assert job.returncode == 0, f"{ranks} ranks, {arguments}: {job.returncode}\n{said}"
        return said

    def fails(self, ranks, arguments, **environment):
        """A job that must fail; returns its exit code and output."""
        return self.must_fail(self.start(ranks, arguments, **environment))

    def fails_apart(self, first, second, **environment):
        """A job of two ranks with arguments of their own, which must fail."""
        return self.must_fail(self.start_apart(first, second, **environment))

    def start_apart(self, first, second, **environment):
        """A job of two ranks with separate arguments, the second with its own environment."""
        one = [BINARY, *first.split()]
        variables = [f"{name}={value}" for name, value in environment.items()]
        other = ["env", *variables, BINARY, *second.split()]
        return self.launch([*LAUNCHER, "-n", "1", *one, ":", "-n", "1", *other], {})

    def must_fail(self, job):
        said, _ = job.communicate(timeout=120)
        assert job.returncode != 0, said
        return job.returncode, said

    def checkpoints(self, run):
        return sorted((self.path / "runs" / run / "checkpoints").glob("step-*"))

    def hashes(self, run):
        """Checksums of the newest checkpoint of a run, and what validation has found so far."""
        newest = self.checkpoints(run)[-1]
        digest = lambda name: hashlib.sha256((newest / name).read_bytes()).hexdigest()
        progress = json.loads((newest / "state.json").read_text())["progress"]
        return newest.name, progress, *(digest(name) for name in SAME)

    def ranks_of(self, job):
        """Processes of the binary below a job, by their arguments."""
        found = []
        for entry in Path("/proc").iterdir():
            try:
                target = os.readlink(entry / "exe")
                environment = (entry / "environ").read_bytes()
                place = os.readlink(entry / "cwd")
            except (OSError, ValueError):
                continue
            if target == BINARY and place == str(self.path) and b"_RANK=" in environment:
                found.append(int(entry.name))
        return sorted(found)

    def wait_for_step(self, run, step, job):
        """Waits until a run has logged a number of steps."""
        log = self.path / "runs" / run / "metrics.jsonl"
        until = time.time() + 120
        while time.time() < until and job.poll() is None:
            if log.exists() and log.read_text().count('"loss"') >= step:
                return
            time.sleep(0.02)
        raise AssertionError(f"{run} has not come to step {step}: {job.poll()}")


def kill(process):
    os.kill(process, signal.SIGKILL)


def terminate(process):
    os.kill(process, signal.SIGTERM)
