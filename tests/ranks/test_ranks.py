"""Ranks under a real launcher: the same bytes as one process, and the same exit for all."""

import fcntl
import json
import os
import random
import re
import subprocess
import time
import unittest

from job import LAUNCHER, ROOT, Folder, kill, terminate

MICRO = "--set train.gradient_accumulation_steps=4"
PHRASES = (
    f"train {ROOT}/configs/quickstart.toml {MICRO} --set data.batch_size=3 --set data.num_workers=1 "
    "--set data.synthetic.phrases=40 --set sampling.count_at_end=0 --set validation.every_steps=8 "
    "--set checkpoint.every_steps=4 --set train.log_every_steps=1"
)
CLIPS = (
    f"train {ROOT}/configs/gmd_motion_tiny.toml {MICRO} --set data.batch_size=2 "
    "--set data.synthetic.phrases=20 --set sampling.count_at_end=0 --set validation.every_steps=0 "
    "--set train.log_every_steps=1"
)
# Number of kills; 20 for reported figures.
KILLS = int(os.environ.get("KINEGRAD_KILLS", "3"))


class Ranks(unittest.TestCase):
    def setUp(self):
        self.folder = Folder()
        self.addCleanup(self.folder.remove)

    def shim(self, name):
        """A library for LD_PRELOAD, built from the source of that name."""
        library = self.folder.path / f"{name}.so"
        source = ROOT / f"tests/ranks/{name}.c"
        subprocess.run(["cc", "-shared", "-fPIC", "-fno-builtin", source, "-o", library, "-ldl"], check=True)
        return library

    def equal_on(self, line, ranks, reference):
        for count in ranks:
            name = f"on{count}"
            self.folder.run(count, f"{line} --name {name}")
            self.assertEqual(self.folder.hashes(name), reference, f"{count} ranks")

    def test_one_two_and_four_ranks_write_the_same_bytes(self):
        for line in (PHRASES, CLIPS):
            line += " --set train.max_steps=6"
            folder = self.folder = Folder()
            self.addCleanup(folder.remove)
            folder.run(1, f"{line} --name alone")
            self.equal_on(line, (2, 4), folder.hashes("alone"))
            # Each rank has the optimiser states of a part of the parameters.
            sharded = f"{line} --set optim.shard_states=true --name sharded"
            folder.run(4, f"{sharded} --set train.max_steps=6")
            self.assertEqual(folder.hashes("sharded"), folder.hashes("alone"))

    def test_training_through_the_sampler_is_the_same_too(self):
        stages = (
            f"train {ROOT}/configs/e2e_quickstart.toml --name stages --set train.max_steps=1 "
            "--set init.pretrain.diffusion_steps=2 --set init.pretrain.decoder_steps=2 "
            "--set sampling.count_at_end=0 --set validation.every_steps=0"
        )
        self.folder.run(1, stages)
        base = self.folder.path / "runs/stages"
        line = (
            f"train {ROOT}/configs/e2e_quickstart.toml {MICRO} --set train.max_steps=3 "
            f"--set init.diffusion={base}/base --set init.decoder={base}/decoder "
            "--set sampling.count_at_end=0 --set data.batch_size=2 "
            # Two batches of held-out phrases, fewer than there are ranks.
            "--set validation.every_steps=2 --set validation.batch_size=4"
        )
        self.folder.run(1, f"{line} --name alone")
        reference = self.folder.hashes("alone")
        self.assertGreater(reference[1]["best_val_loss"], 0)
        self.equal_on(line, (2, 4), reference)

    def test_the_models_that_fine_tuning_starts_from_are_trained_by_all_ranks(self):
        stages = (
            f"train {ROOT}/configs/e2e_quickstart.toml {MICRO} --set train.max_steps=2 "
            "--set init.pretrain.diffusion_steps=4 --set init.pretrain.decoder_steps=2 "
            "--set sampling.count_at_end=0 --set validation.every_steps=2 --set data.batch_size=2"
        )
        self.folder.run(1, f"{stages} --name alone")
        said = self.folder.run(2, f"{stages} --name on2")
        self.assertEqual(said.count("a base model is trained first"), 1, said)
        for run in ("/base", "/decoder", ""):
            here, there = (self.folder.hashes(f"{name}{run}") for name in ("alone", "on2"))
            # Configs contain paths of models; they are not compared.
            self.assertEqual(there, here, run)

    def test_steps_are_selected_by_the_same_samples(self):
        line = (
            f"{PHRASES} --set train.max_steps=4 --set validation.every_steps=2 "
            "--set validation.select_by=frechet --set validation.select_samples=5 "
            "--set sampling.sampler.num_inference_steps=3"
        )
        self.folder.run(1, f"{line} --name alone")
        reference = self.folder.hashes("alone")
        self.assertGreater(reference[1]["best_score"], 0)
        self.equal_on(line, (2, 4), reference)

    def test_a_run_goes_on_with_another_number_of_ranks(self):
        constant = "--set optim.lr_schedule=constant"
        self.folder.run(1, f"{PHRASES} --name whole --set train.max_steps=12 {constant}")
        part = f"{PHRASES} --name parts {constant}"
        self.folder.run(4, f"{part} --set train.max_steps=4 --set optim.shard_states=true")
        self.folder.run(2, f"{part} --resume --set train.max_steps=8 --set optim.shard_states=true")
        self.folder.run(1, f"{part} --resume --set train.max_steps=12")
        self.assertEqual(self.folder.hashes("parts"), self.folder.hashes("whole"))

    def test_a_rank_that_is_killed_ends_the_job_and_loses_nothing(self):
        line = f"{PHRASES} --set train.max_steps=60"
        self.folder.run(1, f"{line} --name whole")
        expected = self.folder.hashes("whole")
        chance = random.Random(7)
        for number in range(KILLS):
            name = f"killed{number}"
            job = self.folder.start(2, f"{line} --name {name}")
            self.folder.wait_for_step(name, 4 + chance.randrange(30), job)
            time.sleep(chance.random() * 0.05)
            kill(chance.choice(self.folder.ranks_of(job)))
            killed = time.time()
            job.communicate(timeout=60)
            self.assertLess(time.time() - killed, 5.0)
            self.assertNotEqual(job.returncode, 0)
            self.assertEqual(self.folder.ranks_of(job), [])
            self.folder.run(2, f"{line} --name {name} --resume")
            self.assertEqual(self.folder.hashes(name), expected)

    def test_a_signal_to_one_rank_stops_all_at_one_step(self):
        line = f"{PHRASES} --set train.max_steps=4000"
        for rank in (0, 1):
            name = f"stopped{rank}"
            job = self.folder.start(2, f"{line} --name {name}")
            self.folder.wait_for_step(name, 6, job)
            terminate(self.folder.ranks_of(job)[rank])
            said, _ = job.communicate(timeout=30)
            self.assertNotEqual(job.returncode, 0, said)
            self.assertIn("stopped; `kinegrad train --resume", said)
            steps = len([l for l in self.lines(name) if '"loss"' in l])
            newest = self.folder.checkpoints(name)[-1].name
            self.assertEqual(newest, f"step-{steps:08}", said)
            self.assertEqual(said.count("error:"), 0, said)

    def test_a_signal_to_the_launcher_leaves_a_checkpoint_that_goes_on(self):
        line = f"{PHRASES} --set train.max_steps=400 --name told"
        job = self.folder.start(2, line)
        self.folder.wait_for_step("told", 6, job)
        job.terminate()
        said, _ = job.communicate(timeout=30)
        # Ranks return 130; the exit code of MPICH's launcher after a signal to itself is its own.
        if "mpich" not in LAUNCHER[0]:
            self.assertNotEqual(job.returncode, 0, said)
        self.assertIn("stopped; `kinegrad train --resume runs/told` continues", said)
        self.assertTrue(self.folder.checkpoints("told"), said)
        self.folder.run(2, f"{line} --resume --set train.max_steps=400 --set train.log_every_steps=1")

    def test_what_one_rank_alone_meets_ends_all_with_one_message(self):
        self.folder.run(1, "data synth --phrases 24 --frames 40 --out data")
        line = (
            f"{PHRASES} --set data.kind=phrases --set data.source=data --set data.cache.memory_mib=0 "
            "--set data.target_frames=24 --set train.max_steps=4000 --set data.num_workers=0"
        )
        job = self.folder.start(2, f"{line} --name missing")
        self.folder.wait_for_step("missing", 4, job)
        held = set((self.folder.path / "runs/missing/config.toml").read_text().split())
        files = sorted(p for p in (self.folder.path / "data").rglob("*.npy"))
        self.assertTrue(files, held)
        for file in files[: len(files) // 2]:
            file.unlink()
        said, _ = job.communicate(timeout=30)
        self.assertNotEqual(job.returncode, 0, said)
        self.assertEqual(said.count("error:"), 1, said)
        # Earlier progress is kept.
        steps = len([l for l in self.lines("missing") if '"loss"' in l])
        self.assertEqual(self.folder.checkpoints("missing")[-1].name, f"step-{steps:08}", said)

    def test_each_rank_reads_a_part_of_the_dataset(self):
        self.folder.run(1, "data synth --phrases 40 --frames 40 --out data")
        line = (
            f"{PHRASES} --set data.kind=phrases --set data.source=data --set data.target_frames=24 "
            "--set train.max_steps=1 --set data.batch_size=1 --set data.num_workers=0 "
            "--set validation.every_steps=0 --set data.validation.fraction=0.05"
        )
        reads = {}
        for ranks in (1, 4):
            self.folder.run(ranks, f"{line} --name on{ranks}")
            log = self.folder.path / f"runs/on{ranks}/loader.jsonl"
            reads[ranks] = json.loads(log.read_text().splitlines()[-1])["reads"]
        # Motion and audio of each phrase; the others for what is held out and the batches alone.
        self.assertEqual(reads[1], 80)
        self.assertLess(reads[4], 40)
        self.assertEqual(self.folder.hashes("on4"), self.folder.hashes("on1"))
        # The third rank reads the third phrase and alone reports it; the fourth is not the first.
        for broken in sorted((self.folder.path / "data").rglob("*.npy"))[2:4]:
            broken.write_bytes(broken.read_bytes()[:100])
        code, said = self.folder.fails(4, f"{line} --name bad")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.assertIn("phrase `synthetic_00002`", said)
        self.assertFalse((self.folder.path / "runs/bad").exists())
        skips = f"{line} --set data.on_bad_phrase=skip"
        said = self.folder.run(4, f"{skips} --name skips4")
        self.assertEqual(said.count("2 bad items skipped"), 1, said)
        self.folder.run(1, f"{skips} --name skips1")
        self.assertEqual(self.folder.hashes("skips4"), self.folder.hashes("skips1"))

    def test_what_is_no_number_on_one_rank_ends_all(self):
        shim = self.shim("not_a_number")
        flag = self.folder.path / "break"
        line = f"{PHRASES} --set train.max_steps=4000 --set validation.every_steps=0 --name broken"
        job = self.folder.start_apart(line, line, LD_PRELOAD=shim, BREAK=flag)
        self.folder.wait_for_step("broken", 10, job)
        flag.touch()
        said, _ = job.communicate(timeout=30)
        self.assertNotEqual(job.returncode, 0, said)
        self.assertEqual(said.count("error:"), 1, said)
        steps = len([l for l in self.lines("broken") if '"loss"' in l])
        found = re.search(r"error: step (\d+): (.*) is not finite; last good checkpoint: (\S+)", said)
        self.assertTrue(found, said)
        self.assertEqual(int(found[1]), steps + 1, said)
        # The step before the last checkpoint is valid, and the run resumes.
        good = self.folder.checkpoints("broken")[-1]
        self.assertEqual(found[3], f"runs/broken/checkpoints/{good.name}")
        self.assertLess(steps - int(good.name[5:]), 4)
        self.folder.run(2, f"{PHRASES} --resume --name broken --set train.max_steps={steps + 2}")

    def test_a_full_disk_of_the_first_rank_ends_all(self):
        line = f"{PHRASES} --name full"
        self.folder.run(2, f"{line} --set train.max_steps=4")
        full = {"LD_PRELOAD": self.shim("full_disk"), "FULL_FILE": "metrics.jsonl"}
        code, said = self.folder.fails(2, f"{line} --resume --set train.max_steps=400", **full)
        self.assertEqual(said.count("error:"), 1, said)
        self.assertIn("metrics.jsonl", said)
        self.assertEqual(code, 1, said)

    def test_numbers_that_do_not_divide_and_loops_that_break(self):
        code, said = self.folder.fails(3, f"{PHRASES} --set train.max_steps=4")
        self.assertEqual(code, 2, said)
        self.assertEqual(said.count("`train.gradient_accumulation_steps` is 4"), 1, said)
        code, said = self.folder.fails(2, f"{PHRASES} --set train.max_steps=4 --dry-run")
        self.assertIn("`--dry-run` with 2 ranks", said)
        line = f"{PHRASES} --set train.max_steps=40 --set optim.learning_rate=1e30 --name broken"
        code, said = self.folder.fails(2, f"{line} --set optim.warmup_steps=0")
        self.assertEqual((code, said.count("error:")), (1, 1), said)

    def test_a_preview_that_cannot_be_recorded_ends_all(self):
        line = (
            f"{PHRASES} --name seen --set train.log_every_steps=1000 --set validation.every_steps=0 "
            "--set sampling.preview_every_steps=4"
        )
        self.folder.run(2, f"{line} --set train.max_steps=2")
        full = {"LD_PRELOAD": self.shim("full_disk"), "FULL_FILE": "events.out.tfevents"}
        code, said = self.folder.fails(2, f"{line} --resume --set train.max_steps=12", **full)
        self.assertEqual((code, said.count("error:")), (1, 1), said)
        self.assertIn("events.out.tfevents", said)

    def test_ranks_that_are_not_about_the_same_are_refused(self):
        line = f"{PHRASES} --set train.max_steps=4 --name apart"
        code, said = self.folder.fails_apart(line, f"{line} --set train.max_grad_norm=0.5")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.assertIn("rank 1 has another config than rank 0", said)
        code, said = self.folder.fails_apart(line, line, KINEGRAD_KERNELS="composed")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        # Burn's operations may depend on threads too: either message is accepted.
        self.assertRegex(said, "rank 1 has another (value of KINEGRAD_KERNELS|number of threads)")
        self.assertFalse((self.folder.path / "runs/apart").exists())

    def test_bytes_do_not_depend_on_the_threads_of_ranks(self):
        for line in (PHRASES, CLIPS):
            folder = self.folder = Folder()
            self.addCleanup(folder.remove)
            line += " --set train.max_steps=4"
            folder.run(1, f"{line} --name alone")
            apart = f"{line} --name apart"
            job = folder.start_apart(apart, apart, RAYON_NUM_THREADS=3)
            said, _ = job.communicate(timeout=120)
            self.assertEqual(job.returncode, 0, said)
            self.assertEqual(folder.hashes("apart"), folder.hashes("alone"))

    def test_what_fails_before_ranks_have_met_is_said_once(self):
        line = f"{PHRASES} --set train.max_steps=4 --name held"
        self.folder.run(1, line)
        more = f"{line} --resume --set train.max_steps=8"
        with open(self.folder.path / "runs/held/lock", "r+") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            code, said = self.folder.fails(2, more)
            self.assertEqual((code, said.count("error:")), (2, 1), said)
            self.assertIn("another process is using the run folder", said)
        for bad, expected in (
            ("--set run.device=abacus", "there is no such device"),
            ("--set train.max_steps=soon", "train.max_steps"),
            ("--resume-nothing", "unexpected argument"),
        ):
            good = line.replace("held", "fresh")
            for first in (good, f"{good} {bad}"):
                code, said = self.folder.fails_apart(first, f"{good} {bad}")
                self.assertIn(expected, said)
                self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.folder.run(2, more)

    def test_commands_that_one_process_runs_refuse_several(self):
        code, said = self.folder.fails(2, "data synth --out made")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.assertIn("a launcher has started 2 processes, and each would do the same", said)
        self.assertFalse((self.folder.path / "made").exists())

    def test_a_launcher_that_is_not_understood_is_refused(self):
        # The message of another MPI's mpirun, for which this program was not built.
        line = f"{PHRASES} --set train.max_steps=4"
        code, said = self.folder.fails(1, line, OMPI_COMM_WORLD_SIZE="2")
        self.assertEqual(code, 2, said)
        self.assertIn("a launcher has started 2 processes, and this program finds 1", said)

    def lines(self, name):
        return (self.folder.path / "runs" / name / "metrics.jsonl").read_text().splitlines()


if __name__ == "__main__":
    unittest.main()
