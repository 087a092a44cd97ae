//! Damaged checkpoints, full disks, locks, non-finite losses.

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, finish, wait_for};

const TRAIN: &str = "train c.toml --set train.max_steps=12";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn checkpoint(sandbox: &Sandbox, step: u64) -> PathBuf {
    sandbox.path(format!("runs/smallest/checkpoints/step-{step:08}"))
}

/// Flips one bit in the middle of a file.
fn flip(path: &PathBuf) {
    let mut bytes = fs::read(path).expect("bytes");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(path, bytes).expect("written");
}

fn truncate(path: &PathBuf) {
    let bytes = fs::read(path).expect("bytes");
    fs::write(path, &bytes[..bytes.len() / 2]).expect("written");
}

#[test]
fn a_damaged_checkpoint_is_skipped_for_the_one_before() {
    let files = [
        "model.safetensors",
        "ema.safetensors",
        "optimizer.safetensors",
        "state.json",
    ];
    for (file, damage) in files
        .iter()
        .flat_map(|f| [(f, flip as fn(&PathBuf)), (f, truncate)])
    {
        let sandbox = sandbox();
        sandbox.run(TRAIN).succeeded();
        let whole = fs::read(checkpoint(&sandbox, 12).join("model.safetensors")).expect("bytes");
        damage(&checkpoint(&sandbox, 12).join(file));
        let finished = sandbox.run(&format!("{TRAIN} --resume")).succeeded();
        assert!(
            finished.stderr.contains("step-00000012 is damaged"),
            "{}",
            finished.stderr
        );
        assert!(
            finished.stderr.contains("continuing after step 10"),
            "{}",
            finished.stderr
        );
        let again = fs::read(checkpoint(&sandbox, 12).join("model.safetensors")).expect("bytes");
        assert!(whole == again, "{file}: the steps repeated end the same");
    }
}

#[test]
fn a_missing_file_makes_a_checkpoint_damaged_too() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    fs::remove_file(checkpoint(&sandbox, 12).join("optimizer.safetensors")).expect("removed");
    let finished = sandbox.run(&format!("{TRAIN} --resume")).succeeded();
    assert!(
        finished.stderr.contains("optimizer.safetensors"),
        "{}",
        finished.stderr
    );
}

#[test]
fn no_good_checkpoint_left_exits_with_2() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    for name in sandbox.list("runs/smallest/checkpoints") {
        let path = sandbox.path(format!("runs/smallest/checkpoints/{name}/state.json"));
        if path.exists() {
            flip(&path);
        }
    }
    let texts = [
        "no good checkpoint is left",
        "step-00000012",
        "step-00000008",
    ];
    sandbox.run(&format!("{TRAIN} --resume")).failed(2, &texts);
    sandbox
        .run("sample runs/smallest --out s")
        .failed(2, &["no good checkpoint"]);
}

#[test]
fn checkpoints_that_cannot_be_listed_or_read_are_no_empty_folder_and_not_damaged() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    let metrics = sandbox.path("runs/smallest/metrics.jsonl");
    let before = fs::read(&metrics).expect("bytes");
    let state = checkpoint(&sandbox, 12).join("state.json");
    fs::rename(&state, sandbox.path("state.json")).expect("moved");
    fs::create_dir(&state).expect("a folder in its place");
    let resume = format!("{TRAIN} --resume");
    sandbox
        .run(&resume)
        .failed(1, &["cannot read", "step-00000012"]);
    fs::remove_dir(&state).expect("removed");
    fs::rename(sandbox.path("state.json"), &state).expect("moved back");

    let folder = sandbox.path("runs/smallest/checkpoints");
    fs::rename(&folder, sandbox.path("kept")).expect("moved");
    fs::write(&folder, "a file").expect("written");
    sandbox
        .run(&resume)
        .failed(1, &["cannot list", "checkpoints"]);
    fs::remove_file(&folder).expect("removed");
    fs::rename(sandbox.path("kept"), &folder).expect("moved back");
    assert!(before == fs::read(&metrics).expect("bytes"));
    sandbox.run(&resume).succeeded();
}

#[test]
fn what_kills_left_behind_stops_no_run() {
    let sandbox = sandbox();
    let half = "train c.toml --set train.max_steps=6";
    sandbox.run(half).succeeded();
    let folder = "runs/smallest/checkpoints";
    for name in [
        ".writing-00000008",
        ".writing-removed-step-00000004",
        ".writing-removed-step-00000006",
        ".writing-removed-.writing-00000008",
    ] {
        fs::create_dir_all(sandbox.path(format!("{folder}/{name}"))).expect("a folder");
        sandbox.write(&format!("{folder}/{name}/model.safetensors"), "half");
    }
    sandbox.run(&format!("{TRAIN} --resume")).succeeded();
    let left = sandbox.list(folder);
    assert!(!left.iter().any(|name| name.starts_with('.')), "{left:?}");
}

#[test]
fn a_run_killed_after_its_last_checkpoint_is_completed() {
    let sandbox = sandbox();
    let train = format!("{TRAIN} --set sampling.count_at_end=1");
    sandbox.run(&train).succeeded();
    let samples = sandbox.list("runs/smallest/samples");
    fs::remove_dir_all(sandbox.path("runs/smallest/samples")).expect("removed");
    let doomed = "runs/smallest/checkpoints/.writing-removed-step-00000002";
    fs::create_dir(sandbox.path(doomed)).expect("a folder");
    sandbox.write(&format!("{doomed}/model.safetensors"), "half");
    let said = sandbox.run(&format!("{train} --resume")).succeeded();
    assert!(said.stdout.contains("finished before"), "{}", said.stdout);
    assert_eq!(sandbox.list("runs/smallest/samples"), samples);
    assert!(!sandbox.path(doomed).exists());
}

#[test]
fn a_run_killed_before_its_first_checkpoint_starts_again() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    let whole = fs::read(checkpoint(&sandbox, 12).join("model.safetensors")).expect("bytes");
    fs::remove_dir_all(sandbox.path("runs/smallest/checkpoints")).expect("removed");
    sandbox.run(&format!("{TRAIN} --resume")).succeeded();
    let again = fs::read(checkpoint(&sandbox, 12).join("model.safetensors")).expect("bytes");
    assert!(whole == again);
}

#[test]
fn a_run_is_not_overwritten_and_a_changed_config_is_refused_by_name() {
    let sandbox = sandbox();
    sandbox
        .run(&format!("{TRAIN} --resume"))
        .failed(2, &["no run", "--resume"]);
    sandbox.run(TRAIN).succeeded();
    sandbox
        .run(TRAIN)
        .failed(2, &["`smallest` exists already", "--resume"]);
    let changed = format!("{TRAIN} --resume --set optim.weight_decay=0.5");
    sandbox
        .run(&changed)
        .failed(2, &["`optim.weight_decay` is 0.5", "0.0001"]);
    let architecture = format!("{TRAIN} --resume --set model.model_channels=64");
    sandbox
        .run(&architecture)
        .failed(2, &["`model.model_channels` is 64", "32"]);
    let allowed = "train c.toml --resume --set train.max_steps=14 --set checkpoint.keep_last=1 \
                   --set validation.draws=1";
    sandbox.run(allowed).succeeded();
}

#[test]
fn weights_put_under_another_state_are_refused() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    sandbox
        .run(&format!(
            "{TRAIN} --name wide --set model.model_channels=64"
        ))
        .succeeded();
    let other = sandbox.path("runs/wide/checkpoints/step-00000012/ema.safetensors");
    fs::copy(other, checkpoint(&sandbox, 12).join("ema.safetensors")).expect("copied");
    let path = "runs/smallest/checkpoints/step-00000012";
    sandbox
        .run(&format!("sample {path} --out s"))
        .failed(2, &["ema.safetensors", "checksum"]);
    assert!(
        sandbox.list("").iter().all(|name| !name.ends_with(".npy")),
        "nothing is written"
    );
    // The trained weights are untouched.
    sandbox
        .run(&format!("sample {path} --out s --no-ema"))
        .succeeded();
}

#[test]
fn a_checkpoint_stands_alone() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    fs::rename(checkpoint(&sandbox, 12), sandbox.path("moved")).expect("moved");
    fs::remove_dir_all(sandbox.path("runs")).expect("removed");
    sandbox
        .run("sample moved --out s.npy --count 2 --seed 3")
        .succeeded();
    assert_eq!(
        sandbox
            .list("")
            .iter()
            .filter(|name| name.starts_with("s-"))
            .count(),
        6
    );
}

#[test]
fn a_full_disk_leaves_the_last_good_checkpoint() {
    let sandbox = sandbox();
    sandbox
        .run(&format!("{TRAIN} --set optim.lr_schedule=constant"))
        .succeeded();
    // A limit on the size of files replaces the full disk: smaller than the weights, larger than
    // the metrics. The signal that would end the process is ignored, so writing fails instead.
    let size = fs::metadata(checkpoint(&sandbox, 12).join("model.safetensors"))
        .expect("size")
        .len();
    let blocks = size / 512 / 2;
    let binary = env!("CARGO_BIN_EXE_kinegrad");
    let more = "train c.toml --set optim.lr_schedule=constant --set train.max_steps=20 --resume";
    let mut command = Command::new("bash");
    let script = format!(
        "trap '' XFSZ; ulimit -f {}; exec {binary} {more}",
        blocks.div_ceil(2)
    );
    command.args(["-c", &script]).current_dir(sandbox.path(""));
    finish(command).failed(1, &["cannot write", "hint: free some space"]);

    let checkpoints = sandbox.list("runs/smallest/checkpoints");
    assert!(
        checkpoints.contains(&"step-00000012".to_string()),
        "{checkpoints:?}"
    );
    assert!(
        !checkpoints.iter().any(|name| name.starts_with(".writing")),
        "{checkpoints:?}"
    );
    let finished = sandbox.run(more).succeeded();
    assert!(
        finished.stderr.contains("continuing after step 12"),
        "{}",
        finished.stderr
    );
}

#[test]
fn a_second_process_on_the_same_run_is_refused() {
    let sandbox = sandbox();
    let long = "train c.toml --set train.max_steps=100000";
    let mut child = sandbox.start(long);
    let metrics = sandbox.path("runs/smallest/metrics.jsonl");
    wait_for(&mut child, "metrics", || metrics.exists());
    sandbox
        .run(&format!("{long} --resume"))
        .failed(2, &["another process is using"]);
    child.kill().expect("a kill");
    child.wait().expect("an end");
    // The lock ended with its process.
    let mut again = sandbox.start(&format!("{long} --resume"));
    sleep(Duration::from_millis(300));
    assert!(
        again.try_wait().expect("a status").is_none(),
        "the resumed run trains"
    );
    again.kill().expect("a kill");
    again.wait().expect("an end");
}

#[test]
fn a_loss_that_is_no_number_stops_with_step_tensor_and_last_good_checkpoint() {
    let sandbox = sandbox();
    let wild = "train c.toml --set optim.learning_rate=1e30 --set optim.warmup_steps=6 \
                --set train.max_grad_norm=0.0 --set validation.every_steps=0 \
                --set checkpoint.every_steps=1";
    let finished = sandbox
        .run(wild)
        .failed(1, &["is not finite", "last good checkpoint"]);
    let text = finished.stderr;
    assert!(
        text.contains("step 2: ") || text.contains("step 3: "),
        "{text}"
    );
    assert!(
        text.contains("runs/smallest/checkpoints/step-0000000"),
        "{text}"
    );
}

#[test]
fn samples_that_are_not_finite_are_failures_of_the_sampler() {
    let sandbox = sandbox();
    sandbox.write("walks.toml", SMALLEST_WALKS);
    // A schedule that adds no noise, which DDIM divides by.
    sandbox
        .run(
            "train walks.toml --set train.recipe=gmd_motion --set train.max_steps=1 \
             --set diffusion.beta_max=1e-300",
        )
        .succeeded();
    sandbox
        .run("sample runs/smallest --steps 1 --set sampling.sampler.kind=ddim --out d --count 2")
        .failed(1, &["the sample 1 of 2 is not finite", "hint:"]);
    assert!(!sandbox.path("d-000.npy").exists());
}

#[test]
fn weights_that_are_not_finite_are_never_a_good_checkpoint() {
    let sandbox = sandbox();
    let settings = "--set optim.learning_rate=1e39 --set optim.warmup_steps=0 \
                    --set train.max_grad_norm=0.0 --set validation.every_steps=0 \
                    --set checkpoint.every_steps=1";
    let texts = [
        "step 1: the parameter `",
        "is not finite; last good checkpoint: none yet",
    ];
    sandbox
        .run(&format!("train c.toml {settings}"))
        .failed(1, &texts);
    let written = sandbox.list("runs/smallest/checkpoints");
    assert!(written.is_empty(), "{written:?}");
}

#[test]
fn only_the_newest_and_the_best_checkpoints_are_kept() {
    let sandbox = sandbox();
    let settings = "--set checkpoint.keep_last=2 --set validation.every_steps=4";
    sandbox.run(&format!("train c.toml {settings}")).succeeded();
    let names = sandbox.list("runs/smallest/checkpoints");
    let best = fs::read_to_string(sandbox.path("runs/smallest/checkpoints/best.json"));
    let best: serde_json::Value = serde_json::from_str(&best.expect("best.json")).expect("JSON");
    let best = format!("step-{:08}", best["step"].as_u64().expect("a step"));
    let mut expected = vec![
        "best.json".to_string(),
        best,
        "step-00000036".into(),
        "step-00000040".into(),
    ];
    expected.sort();
    expected.dedup();
    assert_eq!(names, expected);
}

#[test]
fn damaged_weights_of_any_length_are_found_without_reading_them_into_memory() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    let weights = checkpoint(&sandbox, 12).join("ema.safetensors");
    let file = fs::File::options().write(true).open(weights);
    file.and_then(|file| file.set_len(2 << 30)).expect("longer");
    let binary = env!("CARGO_BIN_EXE_kinegrad");
    let mut command = Command::new("bash");
    let script = format!(
        "ulimit -v {}; exec {binary} sample runs/smallest/checkpoints/step-00000012 --out d",
        2 << 20
    );
    command
        .args(["-c", &script])
        .env("RAYON_NUM_THREADS", "1")
        .current_dir(sandbox.path(""));
    finish(command).failed(
        2,
        &["ema.safetensors: 2147483648 bytes found, its header states"],
    );
}

#[test]
fn weights_larger_than_the_memory_are_not_read() {
    let sandbox = sandbox();
    sandbox.run(TRAIN).succeeded();
    let folder = checkpoint(&sandbox, 12);
    // A file of 10 TB with a matching header.
    let header =
        r#"{"x":{"dtype":"F32","shape":[2500000000000],"data_offsets":[0,10000000000000]}}"#;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    let weights = folder.join("ema.safetensors");
    fs::write(&weights, &bytes).expect("written");
    let file = fs::File::options().write(true).open(&weights);
    let length = bytes.len() as u64 + 10_000_000_000_000;
    file.and_then(|file| file.set_len(length)).expect("longer");
    sandbox
        .run("sample runs/smallest/checkpoints/step-00000012 --out d")
        .failed(
            1,
            &[
                "ema.safetensors: reading it needs 18626.5 GiB",
                "of memory are free",
            ],
        );
}
