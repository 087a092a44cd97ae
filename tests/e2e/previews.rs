//! Samples during training.

use std::fs;

use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, contents, wait_for};

const FEW_STEPS: &str = "--set sampling.sampler.num_inference_steps=2 \
    --set optim.lr_schedule=constant --set validation.every_steps=0";

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("w.toml", SMALLEST_WALKS);
    sandbox
}

/// Pictures of a step in the event file of a run.
fn pictures(sandbox: &Sandbox, run: &str) -> usize {
    let events = sandbox.path(format!("runs/{run}/events.out.tfevents.kinegrad"));
    let events = fs::read(events).expect("events");
    let tag = b"previews/";
    events
        .windows(tag.len())
        .filter(|found| found == tag)
        .count()
}

#[test]
fn previews_change_no_weight() {
    let sandbox = sandbox();
    for (config, item) in [("c", "synthetic_"), ("w", "walk_")] {
        // Dropout on, and steps between checkpoints.
        let train = format!("train {config}.toml {FEW_STEPS} --set train.max_steps=10");
        sandbox.run(&format!("{train} --name plain")).succeeded();
        let every = "--set sampling.preview_every_steps=3";
        let trained = sandbox
            .run(&format!("{train} {every} --name watched"))
            .succeeded();
        assert!(trained.stderr.contains("preview"), "{}", trained.stderr);
        let weights = |run: &str, file: &str| {
            let folder = sandbox.path(format!("runs/{run}/checkpoints/step-00000010"));
            fs::read(folder.join(file)).expect("a file")
        };
        for file in [
            "model.safetensors",
            "ema.safetensors",
            "optimizer.safetensors",
        ] {
            assert!(weights("plain", file) == weights("watched", file), "{file}");
        }
        assert_eq!(
            sandbox.list("runs/watched/previews"),
            [3, 6, 9].map(|step| format!("step-{step:08}.html"))
        );
        assert!(!sandbox.path("runs/plain/previews").exists());
        assert_eq!(pictures(&sandbox, "plain"), 0);
        let drawn = pictures(&sandbox, "watched");
        assert!(drawn >= 3 && drawn.is_multiple_of(3), "{drawn}");
        let page = sandbox.path("runs/watched/previews/step-00000006.html");
        let page = fs::read_to_string(page).expect("a page");
        assert!(page.contains(item), "{page}");
        fs::remove_dir_all(sandbox.path("runs")).expect("removed");
    }
}

#[test]
fn as_many_are_previewed_as_are_drawn_at_the_end() {
    let sandbox = sandbox();
    for (count, expected) in [(0, 4), (2, 2), (6, 6)] {
        let train = format!(
            "train c.toml {FEW_STEPS} --set train.max_steps=2 --set data.synthetic.phrases=60 \
             --set data.validation.fraction=0.2 --set sampling.preview_every_steps=2 \
             --set sampling.count_at_end={count} --name run{count}"
        );
        sandbox.run(&train).succeeded();
        assert_eq!(pictures(&sandbox, &format!("run{count}")), expected);
    }
}

#[test]
fn a_resumed_run_draws_what_is_missing_and_nothing_twice() {
    let sandbox = sandbox();
    let every = "--set sampling.preview_every_steps=4";
    let train = format!("train c.toml {FEW_STEPS} {every} --set train.max_steps");
    sandbox.run(&format!("{train}=4")).succeeded();
    let once = pictures(&sandbox, "smallest");
    assert!(once > 0);
    let pages = sandbox.path("runs/smallest/previews");
    let before = contents(&pages);
    sandbox.run(&format!("{train}=6 --resume")).succeeded();
    assert_eq!(pictures(&sandbox, "smallest"), once);
    assert!(contents(&pages) == before);
    // The interval may change.
    let later = train.replace("every_steps=4", "every_steps=7");
    sandbox.run(&format!("{later}=7 --resume")).succeeded();
    assert_eq!(pictures(&sandbox, "smallest"), 2 * once);
    // As if the process had ended before sampling.
    fs::remove_file(pages.join("step-00000007.html")).expect("removed");
    sandbox.run(&format!("{later}=8 --resume")).succeeded();
    assert!(pages.join("step-00000007.html").exists());
}

#[test]
fn previews_that_fail_stop_no_training() {
    let sandbox = sandbox();
    let train = format!("train c.toml {FEW_STEPS} --set train.max_steps");
    let mut child = sandbox.start(&format!("{train}=100000"));
    let first = sandbox.path("runs/smallest/checkpoints/step-00000004");
    wait_for(&mut child, "a checkpoint", || first.exists());
    child.kill().expect("a kill");
    child.wait().expect("an end");
    // A file is where the folder would be.
    let mine = sandbox.write("runs/smallest/previews", "mine");
    let every = "--set sampling.preview_every_steps=1 --set checkpoint.every_steps=1000";
    let steps = sandbox.list("runs/smallest/checkpoints");
    let last = steps.iter().filter_map(|name| name.strip_prefix("step-"));
    let last: u64 = last
        .filter_map(|step| step.parse().ok())
        .max()
        .expect("one");
    let trained = sandbox
        .run(&format!("{train}={} {every} --resume", last + 2))
        .succeeded();
    let warned = format!("warning: no preview of step {}", last + 1);
    assert!(trained.stderr.contains(&warned), "{}", trained.stderr);
    assert_eq!(fs::read(mine).expect("a file"), b"mine");
}
