//! Run folders and folders of motions from elsewhere: links in them are neither written through nor
//! followed out of them.

#![cfg(unix)]

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use kinegrad_tests::sandbox::{SMALLEST, Sandbox};

/// Neither validation nor samples.
const PLAIN: &str = "--set validation.every_steps=0 --set sampling.count_at_end=0";

const SECRET: &str = "-----BEGIN OPENSSH PRIVATE KEY-----";

/// A run of two steps, and a file outside of it.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
        .run(&format!("train c.toml --set train.max_steps=4 {PLAIN}"))
        .succeeded();
    sandbox.write("mine", SECRET);
    sandbox
}

/// Replaces a file of the sandbox by a link to `mine`.
fn link(sandbox: &Sandbox, name: &str) {
    let path = sandbox.path(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
    let _ = fs::remove_file(&path);
    symlink(sandbox.path("mine"), path).expect("a link");
}

fn is_mine(sandbox: &Sandbox) -> bool {
    fs::read_to_string(sandbox.path("mine")).expect("a file") == SECRET
}

fn is_file(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| found.is_file())
}

#[test]
fn outputs_replace_links_and_leave_their_targets() {
    let sandbox = sandbox();
    let reports = "runs/smallest/reports";
    for name in ["report.partial", "report.html", ".writing-config.toml"] {
        link(&sandbox, &format!("runs/smallest/{name}"));
    }
    let stem = "eval-phrases=1-num_inference_steps=1";
    for ending in ["partial", "csv"] {
        link(&sandbox, &format!("{reports}/{stem}.{ending}"));
    }
    link(&sandbox, "notes.partial");
    link(&sandbox, "losses.svg");
    let plot = "plot runs/smallest --out losses.svg";
    sandbox
        .run(plot)
        .failed(2, &["losses.svg exists already", "--overwrite"]);
    for command in [
        "report runs/smallest",
        "report runs/smallest --out notes.html",
        "eval runs/smallest --steps 1 --set evaluation.phrases=1",
        &format!("{plot} --overwrite"),
        &format!("train c.toml --resume --set train.max_steps=6 {PLAIN}"),
    ] {
        sandbox.run(command).succeeded();
        assert!(is_mine(&sandbox), "{command}");
    }
    let csv = format!("{reports}/{stem}.csv");
    for written in [
        "runs/smallest/report.html",
        "notes.html",
        "losses.svg",
        &csv,
    ] {
        assert!(is_file(&sandbox.path(written)), "{written}");
    }
    let left = sandbox.list("runs/smallest");
    let unfinished =
        |name: &String| name.starts_with(".writing-") && name != ".writing-config.toml";
    assert!(!left.iter().any(unfinished), "{left:?}");
}

#[test]
fn a_run_whose_logs_are_links_is_not_continued() {
    let sandbox = sandbox();
    let resume = &format!("train c.toml --resume --set train.max_steps=6 {PLAIN}");
    let run = "runs/smallest";
    for log in [
        "metrics.jsonl",
        "environment.jsonl",
        "events.out.tfevents.kinegrad",
        "lock",
    ] {
        let path = sandbox.path(format!("{run}/{log}"));
        let kept = fs::read(&path).expect("a log");
        link(&sandbox, &format!("{run}/{log}"));
        let said = sandbox.run(resume);
        assert!(matches!(said.code, Some(1 | 2)), "{log}: {said:?}");
        assert!(said.stderr.contains(log), "{}", said.stderr);
        assert!(said.stderr.contains("symbolic link"), "{}", said.stderr);
        assert!(is_mine(&sandbox), "{log}");
        fs::remove_file(&path).expect("removed");
        fs::write(&path, kept).expect("written");
    }
    sandbox.run(resume).succeeded();
}

#[test]
fn folders_of_a_run_that_are_links_are_not_written_to() {
    let sandbox = sandbox();
    let resume = &format!("train c.toml --resume --set train.max_steps=6 {PLAIN}");
    let eval = "eval runs/smallest --steps 1 --set evaluation.phrases=1";
    fs::create_dir(sandbox.path("elsewhere")).expect("a folder");
    for (name, command) in [
        ("reports", eval),
        ("checkpoints", resume),
        ("samples", resume),
        ("previews", resume),
    ] {
        let path = sandbox.path(format!("runs/smallest/{name}"));
        let kept = sandbox.path("kept");
        let was_there = fs::rename(&path, &kept).is_ok();
        for target in ["elsewhere", "nowhere"] {
            symlink(sandbox.path(target), &path).expect("a link");
            sandbox
                .run(command)
                .failed(2, &[name, "leads out of the run"]);
            assert_eq!(sandbox.list("elsewhere").len(), 0, "{name}");
            fs::remove_file(&path).expect("removed");
        }
        if was_there {
            fs::rename(&kept, &path).expect("put back");
        }
    }
    sandbox.run(eval).succeeded();
    // The contents of a config of elsewhere are not shown.
    let config = sandbox.path("runs/smallest/config.toml");
    fs::rename(&config, sandbox.path("kept")).expect("moved");
    link(&sandbox, "runs/smallest/config.toml");
    let said = sandbox.run(resume);
    let said = said.failed(2, &["config.toml", "leads out of the run"]);
    assert!(!said.stderr.contains("OPENSSH"), "{}", said.stderr);
    fs::remove_file(&config).expect("removed");
    fs::rename(sandbox.path("kept"), &config).expect("put back");
    sandbox.run(resume).succeeded();
}

#[test]
fn reports_contain_no_file_from_outside_of_the_run() {
    let sandbox = sandbox();
    let run = "runs/smallest";
    for name in [
        "reports/eval.json",
        "reports/eval.csv",
        "previews/step-00000004.html",
    ] {
        link(&sandbox, &format!("{run}/{name}"));
    }
    sandbox.write("runs/smallest/reports/own.json", "{\"own\": 1}");
    let page = |name: &str| {
        sandbox
            .run(&format!("report runs/smallest --out {name}"))
            .succeeded();
        fs::read_to_string(sandbox.path(name)).expect("a page")
    };
    let shown = page("one.html");
    assert!(!shown.contains("OPENSSH"), "the linked file");
    for text in ["eval.json leads out of the run", "&quot;own&quot;"] {
        assert!(shown.contains(text), "{text}");
    }
    link(&sandbox, "runs/smallest/config.toml");
    let shown = page("two.html");
    assert!(!shown.contains("OPENSSH"), "the linked config");
    assert!(shown.contains("link that leads out of the run"));
    let listed = sandbox.run("runs").succeeded();
    assert!(!listed.stderr.contains("OPENSSH"), "{}", listed.stderr);
    // Metrics of another run.
    let metrics = sandbox.path(format!("{run}/metrics.jsonl"));
    fs::rename(&metrics, sandbox.path("others.jsonl")).expect("moved");
    symlink(sandbox.path("others.jsonl"), &metrics).expect("a link");
    let link = "metrics.jsonl is a symbolic link that leads out of the run";
    let plotted = sandbox.run(&format!("plot {run} --out outside.svg"));
    plotted.failed(2, &[link]);
    let reported = sandbox.run(&format!("report {run} --out outside.html"));
    let reported = reported.succeeded();
    assert!(reported.stderr.contains(link), "{}", reported.stderr);
    let shown = fs::read_to_string(sandbox.path("outside.html")).expect("a page");
    assert!(
        !shown.contains("steps per second"),
        "the curves of the linked metrics"
    );
}

#[test]
fn reports_into_one_file_do_not_meet() {
    let sandbox = sandbox();
    let report = || {
        let mut command = sandbox.command("report runs/smallest --out page.html".split(' '));
        command
            .stdout(std::process::Stdio::null())
            .spawn()
            .expect("a process")
    };
    for _ in 0..10 {
        let all = [(); 4].map(|()| report());
        for mut process in all {
            assert!(process.wait().expect("an end").success());
        }
    }
    let page = fs::read_to_string(sandbox.path("page.html")).expect("a page");
    assert!(page.trim_end().ends_with("</html>"));
    assert!(
        !sandbox
            .list(".")
            .iter()
            .any(|name| name.starts_with(".writing-"))
    );
}

#[test]
fn walks_follow_no_links_and_check_a_file_once() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("data synth --phrases 2 --frames 40 --out set")
        .succeeded();
    symlink(sandbox.path("set"), sandbox.path("set/motion/loop")).expect("a link");
    symlink(sandbox.path("set/motion"), sandbox.path("set/again")).expect("a link");
    fs::create_dir(sandbox.path("outside")).expect("a folder");
    let motion = sandbox.path("set/motion/synthetic_00000/trajectory.npy");
    fs::copy(&motion, sandbox.path("outside/copy.npy")).expect("copied");
    symlink(sandbox.path("outside"), sandbox.path("set/outside")).expect("a link");
    symlink(&motion, sandbox.path("set/same.npy")).expect("a link");
    let raw = sandbox.path("set/motion/synthetic_00001/trajectory.raw.npy");
    symlink(sandbox.path("outside/copy.npy"), raw).expect("a link");
    let checked = sandbox
        .run("check set --raw --profile ccmotion --json")
        .succeeded();
    let report: serde_json::Value = serde_json::from_str(&checked.stdout).expect("JSON");
    let files = report["files"].as_array().expect("files");
    let paths: Vec<&str> = files
        .iter()
        .filter_map(|file| file["path"].as_str())
        .collect();
    let expected = [0, 1].map(|n| format!("set/motion/synthetic_0000{n}/trajectory.npy"));
    assert_eq!(paths, expected);
    sandbox.run("view set --out page.html").succeeded();
}
