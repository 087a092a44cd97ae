//! Other contents of a run's folder: foreign files, damaged metrics, samples.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use kinegrad_tests::sandbox::{SMALLEST, Sandbox, contents, wait_for};

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

#[test]
fn a_folder_that_is_no_run_is_left_as_it_is() {
    let sandbox = sandbox();
    for name in ["metrics.jsonl", "checkpoints/mine.txt"] {
        let file = sandbox.write(&format!("runs/mine/{name}"), "my own\n");
        for resume in ["", "--resume"] {
            let texts = [
                "runs/mine exists and is not a run",
                "choose another `--name`",
            ];
            sandbox
                .run(&format!("train c.toml --name mine {resume}"))
                .failed(2, &texts);
        }
        assert_eq!(fs::read_to_string(file).expect("a file"), "my own\n");
        assert_eq!(sandbox.list("runs/mine").len(), 1, "nothing is added");
        fs::remove_dir_all(sandbox.path("runs/mine")).expect("removed");
    }
    sandbox.write("runs/mine", "a file");
    sandbox
        .run("train c.toml --name mine")
        .failed(2, &["runs/mine cannot be a run's folder"]);
}

#[test]
fn what_an_early_kill_leaves_stops_no_run() {
    let sandbox = sandbox();
    let unfinished = ".writing-0123456789.tmp";
    for name in ["lock", ".writing-config.toml", unfinished] {
        sandbox.write(&format!("runs/smallest/{name}"), "");
    }
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    assert!(!sandbox.path("runs/smallest").join(unfinished).exists());
}

#[test]
fn one_damaged_line_of_metrics_takes_no_other_with_it() {
    let sandbox = sandbox();
    let train = "train c.toml --set optim.lr_schedule=constant --set train.max_steps";
    sandbox.run(&format!("{train}=8")).succeeded();
    let path = sandbox.path("runs/smallest/metrics.jsonl");
    let lines = || -> Vec<String> {
        let text = fs::read_to_string(&path).expect("metrics");
        text.lines().map(String::from).collect()
    };
    let mut damaged = lines();
    damaged[2] = "{\"step\":3,\"lo".into();
    fs::write(&path, damaged.join("\n") + "\n").expect("written");
    let resumed = sandbox.run(&format!("{train}=10 --resume")).succeeded();
    let said = "metrics.jsonl: line 3 is damaged: it stays as it is";
    assert!(resumed.stderr.contains(said), "{}", resumed.stderr);
    let after = lines();
    assert_eq!(after[..damaged.len()], damaged, "nothing is lost");
    assert!(after.len() > damaged.len());
    let plotted = sandbox
        .run("plot runs/smallest --out losses.svg")
        .succeeded();
    assert!(
        plotted.stderr.contains("line 3 is damaged"),
        "{}",
        plotted.stderr
    );
}

#[test]
fn a_run_without_metrics_is_not_plotted() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    let path = sandbox.path("runs/smallest/metrics.jsonl");
    fs::write(&path, "").expect("emptied");
    let plot = "plot runs/smallest --out losses.svg";
    let texts = ["metrics.jsonl has no line that can be plotted", "log_every"];
    sandbox.run(plot).failed(2, &texts);
    fs::remove_file(path).expect("removed");
    let texts = ["the run runs/smallest has no metrics.jsonl", "merged"];
    sandbox.run(plot).failed(2, &texts);
    assert!(!sandbox.path("losses.svg").exists());
}

/// A training of two steps whose samples take a while.
const DRAWN: &str = "train c.toml --set train.max_steps=2 --set validation.every_steps=0 \
    --set sampling.count_at_end=1 --set sampling.sampler.kind=ddpm \
    --set sampling.sampler.num_inference_steps=1000 --set data.target_frames=36";

/// Starts a training and waits until it samples.
fn drawing(sandbox: &Sandbox, arguments: &str) -> Child {
    let mut child = sandbox.start(arguments);
    let begun = sandbox.path("runs/smallest/.writing-samples");
    wait_for(&mut child, "samples", || begun.exists());
    child
}

fn stop(mut child: Child) -> Option<i32> {
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-TERM", &id]).status();
    assert!(sent.expect("kill runs").success());
    child.wait().expect("an end").code()
}

fn samples(sandbox: &Sandbox) -> Vec<PathBuf> {
    let names = sandbox.list("runs/smallest/samples");
    names.into_iter().map(PathBuf::from).collect()
}

#[test]
fn a_signal_while_samples_are_drawn_ends_the_run_and_resuming_draws_them() {
    let sandbox = sandbox();
    let child = drawing(&sandbox, DRAWN);
    let resume = format!("{DRAWN} --resume");
    // The sampling process locks the run.
    sandbox
        .run(&resume)
        .failed(2, &["another process is using the run folder"]);
    assert_eq!(stop(child), Some(130));
    assert!(!sandbox.path("runs/smallest/samples").exists());

    sandbox.run(&resume).succeeded();
    assert_eq!(samples(&sandbox).len(), 3);
    assert!(!sandbox.path("runs/smallest/.writing-samples").exists());
}

#[test]
fn samples_are_added_to_what_the_folder_holds() {
    let sandbox = sandbox();
    let train = "train c.toml --set sampling.count_at_end=1 --set optim.lr_schedule=constant \
                 --set sampling.sampler.num_inference_steps=2 --set train.max_steps";
    sandbox.run(&format!("{train}=2")).succeeded();
    let drawn = samples(&sandbox);
    let bytes = || fs::read(sandbox.path("runs/smallest/samples").join(&drawn[1])).expect("bytes");
    // The second file is the motion; the first is its record.
    let before = bytes();
    let mine = sandbox.write("runs/smallest/samples/notes.txt", "mine");
    sandbox.run(&format!("{train}=4 --resume")).succeeded();
    assert_eq!(fs::read_to_string(mine).expect("notes"), "mine");
    assert!(bytes() != before, "drawn again");
    assert_eq!(samples(&sandbox).len(), drawn.len() + 1);
    assert!(!sandbox.path("runs/smallest/.writing-samples").exists());
}

#[test]
fn samples_need_a_name() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    fs::create_dir(sandbox.path("made")).expect("a folder");
    for (out, instead) in [
        ("made/", "`--out made/sample`"),
        ("made/.npy", "`--out made/sample`"),
        ("made/..", "`--out made/../sample`"),
        (".npy", "`--out ./sample`"),
    ] {
        for count in ["", "--count 2"] {
            sandbox
                .run(&format!(
                    "sample runs/smallest --steps 2 --out {out} {count}"
                ))
                .failed(2, &["names no file", instead]);
        }
    }
    assert!(sandbox.list("made").is_empty());
    sandbox
        .run("sample runs/smallest --steps 2 --out made/one.npy")
        .succeeded();
    assert_eq!(sandbox.list("made"), ["one.json", "one.npy", "one.raw.npy"]);
}

#[test]
fn a_slow_start_does_not_overwrite_a_run_that_was_begun_meanwhile() {
    let sandbox = sandbox();
    // A dataset that takes seconds to generate, before the run's folder exists.
    let slow = sandbox
        .command(
            "train c.toml --set data.synthetic.phrases=12000 --set data.validation.fraction=0.001"
                .split(' '),
        )
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    sandbox
        .run("train c.toml --set train.max_steps=4")
        .succeeded();
    let before = contents(&sandbox.path("runs"));
    let slow = slow.wait_with_output().expect("an end");
    let said = String::from_utf8_lossy(&slow.stderr);
    assert_eq!(slow.status.code(), Some(2), "{said}");
    assert!(said.contains("exists already"), "{said}");
    assert!(contents(&sandbox.path("runs")) == before);
}

#[test]
fn samples_of_an_earlier_end_are_drawn_again_after_a_kill() {
    let sandbox = sandbox();
    let train = "train c.toml --set sampling.count_at_end=1 --set validation.every_steps=0";
    sandbox
        .run(&format!("{train} --set train.max_steps=4"))
        .succeeded();
    let samples = sandbox.path("runs/smallest/samples");
    let first = contents(&samples);
    assert!(!first.is_empty());
    let mut child = sandbox.start(&format!("{train} --set train.max_steps=100000 --resume"));
    let later = sandbox.path("runs/smallest/checkpoints/step-00000008");
    wait_for(&mut child, "a later checkpoint", || later.exists());
    child.kill().expect("a kill");
    child.wait().expect("an end");
    // The run already has as many steps, so it ends at once.
    sandbox
        .run(&format!("{train} --set train.max_steps=5 --resume"))
        .succeeded();
    let second = contents(&samples);
    assert_eq!(second.len(), first.len());
    assert!(second != first, "samples of other weights");
    assert!(!sandbox.path("runs/smallest/.writing-samples").exists());
    // A file in the folder's place is named, and nothing is lost.
    fs::remove_dir_all(&samples).expect("removed");
    fs::write(&samples, "mine").expect("written");
    fs::create_dir(sandbox.path("runs/smallest/.writing-samples")).expect("a folder");
    sandbox
        .run(&format!("{train} --set train.max_steps=5 --resume"))
        .failed(2, &["samples is not a folder", "move it away"]);
    assert_eq!(fs::read(&samples).expect("a file"), b"mine");
    // A link to a folder that is gone is named as well.
    fs::remove_file(&samples).expect("removed");
    std::os::unix::fs::symlink(sandbox.path("gone"), &samples).expect("a link");
    sandbox
        .run(&format!("{train} --set train.max_steps=5 --resume"))
        .failed(2, &["samples is a symbolic link that leads out of the run"]);
}
