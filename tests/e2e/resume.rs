//! A run that is killed and resumed ends with the same bytes as an uninterrupted one.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::text_motion::EVALUATOR;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, wait_for};
use serde_json::{Map, Value};

const KILLS: usize = 5;
const CLOCK: [&str; 3] = ["time", "elapsed_seconds", "steps_per_second"];

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

/// The bytes of the tensors of the last checkpoint, and the metrics without times.
#[derive(PartialEq)]
struct Result {
    tensors: Vec<(String, Vec<u8>)>,
    metrics: Vec<Map<String, Value>>,
}

fn result(run: &Path) -> Result {
    let mut checkpoints: Vec<PathBuf> = fs::read_dir(run.join("checkpoints"))
        .expect("checkpoints")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.is_dir())
        .collect();
    checkpoints.sort();
    let last = checkpoints.last().expect("a checkpoint");
    let tensors = ["model", "ema", "optimizer"].map(|name| {
        let file = format!("{name}.safetensors");
        let bytes = fs::read(last.join(&file)).expect("a file of tensors");
        (
            format!("{}/{file}", last.file_name().expect("a name").display()),
            bytes,
        )
    });
    let text = fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    let metrics = text
        .lines()
        .map(|line| {
            let mut line: Map<String, Value> = serde_json::from_str(line).expect("a JSON line");
            CLOCK.iter().for_each(|key| drop(line.remove(*key)));
            line
        })
        .collect();
    Result {
        tensors: tensors.to_vec(),
        metrics,
    }
}

#[track_caller]
fn assert_same(one: &Result, other: &Result) {
    for ((name, bytes), (other_name, other_bytes)) in one.tensors.iter().zip(&other.tensors) {
        assert_eq!(name, other_name);
        assert!(bytes == other_bytes, "{name} differs");
    }
    assert_eq!(one.metrics, other.metrics);
}

/// A number in 0..1 that differs between runs: the moment of a kill is random on purpose.
fn chance() -> f64 {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .expect("a clock");
    f64::from(now.subsec_nanos() % 1_000_003) / 1_000_003.0
}

/// Trains with `arguments` in `runs`, killing the process at least [`KILLS`] times.
fn train_with_kills(sandbox: &Sandbox, arguments: &str, runs: &str, uninterrupted: Duration) {
    let mut longest = uninterrupted / 3;
    for attempt in 0..8 {
        let runs = format!("{runs}-{attempt}");
        let mut kills = 0;
        while kills < KILLS {
            let run = sandbox.path(&runs).join("smallest");
            let resume = if run.exists() { "--resume" } else { "" };
            let mut child = sandbox.start(&format!("{arguments} --runs-dir {runs} {resume}"));
            // A process killed before its run's folder exists leaves nothing to resume.
            while !run.exists() && child.try_wait().expect("a status").is_none() {
                sleep(Duration::from_millis(1));
            }
            sleep(longest.mul_f64(chance()));
            if child.try_wait().expect("a status").is_some() {
                break;
            }
            child.kill().expect("a kill");
            child.wait().expect("an end");
            kills += 1;
        }
        if kills < KILLS {
            longest = longest.mul_f64(0.7);
            continue;
        }
        sandbox
            .run(&format!("{arguments} --runs-dir {runs} --resume"))
            .succeeded();
        fs::rename(sandbox.path(&runs), sandbox.path("killed")).expect("a rename");
        return;
    }
    panic!("the run ended before {KILLS} kills, eight times");
}

fn check_kills(settings: &str) {
    check_kills_in(&sandbox(), settings);
}

fn check_kills_in(sandbox: &Sandbox, settings: &str) {
    let arguments = format!("train c.toml {settings}");
    let started = Instant::now();
    sandbox
        .run(&format!("{arguments} --runs-dir whole"))
        .succeeded();
    train_with_kills(sandbox, &arguments, "attempt", started.elapsed());
    let whole = result(&sandbox.path("whole/smallest"));
    assert_same(&whole, &result(&sandbox.path("killed/smallest")));
    assert!(whole.metrics.len() > 8, "losses and validations");
}

#[test]
fn killed_run_ends_the_same_without_workers() {
    check_kills("--set data.num_workers=0");
}

#[test]
fn killed_run_ends_the_same_with_a_worker_and_accumulation() {
    check_kills("--set data.num_workers=1 --set train.gradient_accumulation_steps=2");
}

#[test]
fn killed_run_ends_the_same_with_states_beside_the_networks_and_narrow_products() {
    check_kills("--set optim.offload=device --set train.precision=bf16");
}

#[test]
fn killed_run_ends_the_same_with_style() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let labels = "[data.labels]\n\"*1\" = \"tango\"\n\"*5\" = \"waltz\"\n";
    sandbox.write("c.toml", format!("{SMALLEST}\n{labels}"));
    let style = "--set model.style=both --set diffusion.style_drop_prob=0.25";
    check_kills_in(&sandbox, style);
}

#[test]
fn killed_run_ends_the_same_with_four_workers() {
    check_kills("--set data.num_workers=4");
}

/// Fine-tuning, with the trainings before it, which are killed and resumed too.
const FINE_TUNING: &str = "--set train.recipe=e2e --set train.max_steps=16 \
    --set init.pretrain.diffusion_steps=8 --set init.pretrain.decoder_steps=6 \
    --set decoder.hidden_dim=32 --set decoder.coherence=projection --set rollout.steps=3 \
    --set data.augment.audio_replace_prob=0.3";

/// Prediction targets, normalisation, weight decay and the criterion of the best step.
const TARGETS: &str = "--set model.phase_target=sin_cos --set model.orientation_target=rotation_6d \
    --set data.statistics=crops --set optim.weight_decay_groups=matrices \
    --set validation.select_by=frechet --set validation.select_samples=2 \
    --set data.validation.fraction=0.4 --set sampling.sampler.num_inference_steps=2";

#[test]
fn killed_run_with_other_targets_ends_the_same() {
    check_kills(TARGETS);
}

#[test]
fn killed_fine_tuning_with_other_targets_ends_the_same() {
    check_kills(&format!("{FINE_TUNING} {TARGETS}"));
}

/// A network with aligned audio, on clips of 10 to 24 frames.
const ALIGNED: &str = "--set model.audio_conditioning=aligned --set data.augment.min_frames=10 \
    --set data.audio_features=[\"ccmotion\",\"beats\"]";

#[test]
fn killed_run_with_aligned_conditioning_ends_the_same() {
    check_kills(&format!("{ALIGNED} --set data.num_workers=1"));
}

#[test]
fn killed_fine_tuning_with_aligned_conditioning_ends_the_same() {
    check_kills(&format!("{FINE_TUNING} {ALIGNED} --set lora.rank=2"));
}

/// A network that tracks beats, predicts harmonics of the bar, and is trained on masked music at
/// other speeds.
const TRACKED: &str = "--set model.audio_conditioning=aligned --set model.beats=tracked \
    --set data.audio_features=[\"ccmotion\",\"beats\"] --set model.phase_target=harmonics \
    --set model.orientation_target=rotation_6d --set data.augment.speed=0.25 \
    --set data.augment.audio_masks=2 --set data.augment.bar_drop_prob=0.5 \
    --set data.augment.rotate_yaw=true --set data.augment.mirror=true";

#[test]
fn killed_run_of_a_network_that_tracks_beats_ends_the_same() {
    check_kills(&format!("{TRACKED} --set data.num_workers=1"));
}

#[test]
fn killed_fine_tuning_of_a_network_that_tracks_beats_ends_the_same() {
    // The last coherence that is given counts.
    check_kills(&format!(
        "{FINE_TUNING} {TRACKED} --set decoder.coherence=full --set decoder.hidden_dim=34"
    ));
}

#[test]
fn killed_fine_tuning_ends_the_same() {
    check_kills(FINE_TUNING);
}

#[test]
fn killed_fine_tuning_with_adapters_and_accumulation_ends_the_same() {
    check_kills(&format!(
        "{FINE_TUNING} --set lora.rank=2 --set train.gradient_accumulation_steps=2 \
         --set rollout.mode=last_k --set rollout.last_k=2"
    ));
}

#[test]
fn killed_run_ends_the_same_with_a_tensor_that_the_backend_sums_in_any_order() {
    // 2056 squared is above 4,194,304, where the backend's own sum depends on the threads.
    check_kills(
        "--set model.time_embed_dim=2056 --set train.max_steps=12 --set checkpoint.every_steps=3",
    );
}

#[test]
fn killed_runs_on_clips_end_the_same() {
    for recipe in ["gmd_motion --set emphasis.kind=gaussian", "gmd_trajectory"] {
        let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
        sandbox.write("c.toml", SMALLEST_WALKS);
        check_kills_in(
            &sandbox,
            &format!("--set train.recipe={recipe} --set data.num_workers=1"),
        );
    }
}

#[test]
fn killed_runs_of_flows_end_the_same() {
    let sandbox = crate::flow::sandbox();
    check_kills_in(&sandbox, "--name smallest --set data.num_workers=1");
}

#[test]
fn killed_runs_of_compositions_end_the_same() {
    let sandbox = crate::compose::sandbox();
    check_kills_in(&sandbox, "--name smallest --set data.num_workers=1");
}

#[test]
fn killed_runs_of_evaluators_end_the_same() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", EVALUATOR);
    check_kills_in(&sandbox, "--name smallest --set data.num_workers=1");
}

#[test]
fn a_run_killed_before_its_best_step_was_recorded_records_it() {
    let sandbox = sandbox();
    let train = "train c.toml --set train.max_steps=20 --runs-dir runs";
    sandbox.run(train).succeeded();
    let record = sandbox.path("runs/smallest/checkpoints/best.json");
    let best = fs::read(&record).expect("a best step");
    fs::remove_file(&record).expect("a record");
    sandbox.run(&format!("{train} --resume")).succeeded();
    assert_eq!(fs::read(&record).expect("a best step"), best);
}

#[test]
fn the_number_of_workers_changes_nothing() {
    let sandbox = sandbox();
    let results = [0, 1, 4].map(|workers| {
        let settings = format!("--set data.num_workers={workers} --set train.max_steps=10");
        sandbox
            .run(&format!("train c.toml {settings} --runs-dir w{workers}"))
            .succeeded();
        result(&sandbox.path(format!("w{workers}/smallest")))
    });
    assert_same(&results[0], &results[1]);
    assert_same(&results[0], &results[2]);
}

#[test]
fn the_seed_decides_the_weights() {
    let sandbox = sandbox();
    let train = |runs: &str, seed: u64| {
        let settings = format!("--set run.seed={seed} --set train.max_steps=6");
        sandbox
            .run(&format!("train c.toml {settings} --runs-dir {runs}"))
            .succeeded();
        result(&sandbox.path(format!("{runs}/smallest")))
    };
    let (one, same, other) = (train("a", 1), train("b", 1), train("c", 2));
    assert_same(&one, &same);
    assert!(
        one.tensors[0].1 != other.tensors[0].1,
        "another seed gives other weights"
    );
}

#[test]
fn a_longer_run_continues_a_finished_one() {
    let sandbox = sandbox();
    let constant = "--set optim.lr_schedule=\"constant\"";
    sandbox.run(&format!(
        "train c.toml {constant} --set train.max_steps=30 --runs-dir a"
    ));
    let again = format!("train c.toml {constant} --set train.max_steps=30 --runs-dir a --resume");
    let finished = sandbox.run(&again).succeeded();
    assert!(
        finished.stdout.contains("finished before"),
        "{}",
        finished.stdout
    );
    sandbox
        .run("train --resume a/smallest --set train.max_steps=40")
        .succeeded();
    sandbox
        .run(&format!("train c.toml {constant} --runs-dir b"))
        .succeeded();
    let (continued, whole) = (
        result(&sandbox.path("a/smallest")),
        result(&sandbox.path("b/smallest")),
    );
    assert!(continued.tensors == whole.tensors);
}

#[test]
fn interrupt_writes_a_checkpoint_and_exits_with_130() {
    let sandbox = sandbox();
    let settings = "--set train.max_steps=100000 --set checkpoint.every_steps=100000 \
                    --set validation.every_steps=0";
    let mut child = sandbox.start(&format!("train c.toml {settings}"));
    let metrics = sandbox.path("runs/smallest/metrics.jsonl");
    let steps = || {
        fs::read_to_string(&metrics)
            .unwrap_or_default()
            .lines()
            .count()
    };
    wait_for(&mut child, "three steps", || steps() >= 3);
    let id = child.id().to_string();
    let sent = std::process::Command::new("kill")
        .args(["-INT", &id])
        .status()
        .expect("kill runs");
    assert!(sent.success());
    assert_eq!(child.wait().expect("an end").code(), Some(130));
    let checkpoints = sandbox.list("runs/smallest/checkpoints");
    assert_eq!(checkpoints.len(), 1, "{checkpoints:?}");
    let step: usize = checkpoints[0]
        .trim_start_matches("step-")
        .parse()
        .expect("a step");
    assert_eq!(step, steps(), "the checkpoint is of the last step");
}
