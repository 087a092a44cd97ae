"""Evaluations with samples shared by ranks: the same numbers as with one process."""

import json
import unittest

from job import ROOT, Folder

TRAINED = (
    "--set train.max_steps=2 --set sampling.count_at_end=0 --set validation.every_steps=0 "
    "--set data.batch_size=4 --set data.synthetic.phrases=300 --set data.validation.fraction=0.03 --name run"
)
STEPS = "--set sampling.sampler.num_inference_steps=3"
# Config, options of the evaluation, and its report. Counts are not divisible by the ranks.
EVALUATIONS = {
    "phrases": (
        "quickstart",
        f"--set evaluation.phrases=5 --set evaluation.seeds=2 {STEPS}",
        "eval.json",
    ),
    "audio_ablation": (
        "quickstart",
        f"--audio-ablation --guidance-scale 1,2 --set evaluation.phrases=5 --set evaluation.seeds=1 {STEPS}",
        "eval-audio-ablation.json",
    ),
    "clips": (
        "gmd_motion_tiny",
        "--set evaluation.batch_size=2 --set evaluation.keyframes=2 --set evaluation.replications=2 "
        f"--set evaluation.variety_clips=2 --set evaluation.variety_repeats=3 {STEPS}",
        "eval-goals.json",
    ),
    "compositions": (
        "bpe_tiny",
        "--set evaluation.compositions=3 --set evaluation.texts=2 --set evaluation.num_paths=2 "
        f"{STEPS}",
        "eval-compositions.json",
    ),
    "rollouts": (
        "flow_tiny",
        "--set evaluation.rollouts=3 --set evaluation.frames=20 "
        "--set sampling.sampler.num_inference_steps=2",
        "eval-rollouts.json",
    ),
    "text": ("text_motion", "", "eval-text-motion.json"),
}


def without_times(value):
    """A report without times."""
    if isinstance(value, dict):
        return {key: without_times(each) for key, each in value.items() if key != "seconds"}
    if isinstance(value, list):
        return [without_times(each) for each in value]
    return value


class Evaluations(unittest.TestCase):
    def test_all_systems_are_evaluated_alike_by_one_two_and_four_ranks(self):
        for name, (config, options, report) in EVALUATIONS.items():
            folder = Folder()
            self.addCleanup(folder.remove)
            made = "--set data.kind=synthetic_walks" if name == "text" else ""
            folder.run(1, f"train {ROOT}/configs/{config}.toml {TRAINED} {made}")
            found = {}
            for ranks in (1, 2, 4):
                said = folder.run(ranks, f"eval runs/run {options} --out on{ranks}")
                self.assertEqual(said.count(report), 1, said)
                text = (folder.path / f"on{ranks}" / report).read_text()
                found[ranks] = without_times(json.loads(text))
                table = report.replace(".json", ".csv")
                self.assertTrue((folder.path / f"on{ranks}" / table).exists())
            for ranks in (2, 4):
                self.assertEqual(found[ranks], found[1], f"{name}, {ranks} ranks")

    def test_what_one_rank_meets_ends_all_with_one_message(self):
        folder = Folder()
        self.addCleanup(folder.remove)
        folder.run(1, f"train {ROOT}/configs/quickstart.toml {TRAINED}")
        code, said = folder.fails(2, "eval runs/nothing")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        (folder.path / "taken").write_text("no folder")
        code, said = folder.fails(2, f"eval runs/run {STEPS} --out taken")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        code, said = folder.fails_apart(f"eval runs/run {STEPS}", f"eval runs/run {STEPS} --seed 1")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.assertIn("rank 1 has another command than rank 0", said)
        other = TRAINED.replace("--name run", "--name other --set run.seed=7")
        folder.run(1, f"train {ROOT}/configs/quickstart.toml {other}")
        code, said = folder.fails_apart(f"eval runs/run {STEPS}", f"eval runs/other {STEPS}")
        self.assertEqual((code, said.count("error:")), (2, 1), said)
        self.assertIn("rank 1 has another run than rank 0", said)
        code, said = folder.fails(2, "eval")
        self.assertEqual((code, said.count("error:")), (2, 1), said)


if __name__ == "__main__":
    unittest.main()
