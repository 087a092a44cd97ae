//! From captures and songs to training datasets: `data prepare`, `audio features`, `data inspect
//! --where`, `sample --audio`.

use std::fs;

use kinegrad_data::AudioLayout;
use kinegrad_tests::captures::{self, PLAN, bvh, wav};
use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox, contents, finish, wait_for};
use kinegrad_tests::servers;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

fn with_captures() -> Sandbox {
    let sandbox = sandbox();
    captures::write(&sandbox);
    sandbox
}

/// The final weights of a short training on `source`.
fn weights(
    sandbox: &Sandbox,
    name: &str,
    arguments: &str,
    environment: &[(&str, &str)],
) -> Vec<u8> {
    let all = format!(
        "train c.toml --name {name} --set data.kind=phrases --set train.max_steps=6 \
         --set sampling.count_at_end=1 {arguments}"
    );
    let mut command = sandbox.command(all.split_whitespace());
    command.envs(environment.iter().copied());
    finish(command).succeeded();
    let checkpoints = sandbox.list(&format!("runs/{name}/checkpoints"));
    let last = checkpoints
        .iter()
        .rfind(|name| name.starts_with("step-"))
        .expect("a checkpoint");
    let run = sandbox.path(format!("runs/{name}/checkpoints/{last}"));
    fs::read(run.join("model.safetensors")).expect("weights")
}

#[test]
fn captures_and_songs_become_a_dataset_that_trains() {
    let sandbox = with_captures();
    let prepared = sandbox.run("data prepare plan.toml").succeeded();
    for text in [
        "one",
        "two",
        "alone",
        "the song has ended",
        "0 of 3 takes unchanged",
    ] {
        assert!(
            prepared.stdout.contains(text),
            "no `{text}` in {}",
            prepared.stdout
        );
    }
    let before = contents(&sandbox.path("set"));
    let again = sandbox.run("data prepare plan.toml").succeeded();
    assert!(
        again.stdout.contains("3 of 3 takes unchanged"),
        "{}",
        again.stdout
    );
    let data = |all: Vec<(String, Vec<u8>)>| -> Vec<_> {
        all.into_iter()
            .filter(|(name, _)| name != "prepare/report.json")
            .collect()
    };
    assert_eq!(data(before), data(contents(&sandbox.path("set"))));

    let inspected = sandbox.run("data inspect set").succeeded();
    assert!(
        !inspected.stdout.contains("unusable)"),
        "{}",
        inspected.stdout
    );
    let chosen = |condition: &str| {
        let mut command =
            sandbox.command(["data", "inspect", "set", "--json", "--where", condition]);
        command.stdin(std::process::Stdio::null());
        let found = finish(command).succeeded().stdout;
        serde_json::from_str::<Vec<String>>(&found).expect("a list of ids")
    };
    let all = chosen("frames = 40");
    assert!(all.contains(&"one_00015".to_string()), "{all:?}");
    assert!(all.contains(&"alone_00000".to_string()), "{all:?}");
    assert!(
        chosen("split = validation")
            .iter()
            .all(|id| id.starts_with("two_"))
    );
    assert_eq!(
        chosen("flags like *no_audio*"),
        chosen("id like alone_*"),
        "the take without a song"
    );
    assert_eq!(
        chosen("tempo = 120 and not id like alone_*").len(),
        chosen("not id like alone_*").len()
    );
    sandbox.run("data inspect set --plot tempo.png").succeeded();
    assert!(
        fs::read(sandbox.path("tempo.png"))
            .expect("a picture")
            .starts_with(b"\x89PNG")
    );
    sandbox
        .run("data inspect set --where speed>3")
        .failed(2, &["no column `speed`", "hint:"]);

    weights(&sandbox, "trained", "--set data.source=set", &[]);
    let log = fs::read_to_string(sandbox.path("runs/trained/loader.jsonl")).expect("a log");
    let line: serde_json::Value =
        serde_json::from_str(log.lines().last().expect("a line")).expect("JSON");
    assert_eq!(line["samples"], 24);
    for key in [
        "samples_per_second",
        "wait_share",
        "memory_hits",
        "disk_hits",
        "reads",
    ] {
        assert!(line[key].is_number(), "{key}: {line}");
    }
}

#[test]
fn a_bucket_trains_like_the_folder_cold_and_warm() {
    for (service, scheme) in [("gcs", "gs"), ("s3", "s3")] {
        let emulator = match service {
            "gcs" => servers::gcs(),
            _ => servers::s3(),
        };
        let endpoint = emulator.endpoint();
        let environment = [
            ("STORAGE_EMULATOR_HOST", endpoint.as_str()),
            ("AWS_ENDPOINT_URL", endpoint.as_str()),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_ACCESS_KEY_ID", "test"),
            ("AWS_SECRET_ACCESS_KEY", "test"),
            ("AWS_REGION", "us-east-1"),
        ];
        let sandbox = with_captures();
        sandbox.run("data prepare plan.toml").succeeded();
        let uri = format!("{scheme}://bucket/dances");
        match service {
            "gcs" => {
                for (path, bytes) in contents(&sandbox.path("set")) {
                    emulator.upload(&format!("dances/{path}"), &bytes);
                }
            }
            _ => {
                let mut command = sandbox.command(["data", "prepare", "plan.toml", "--out", &uri]);
                command.envs(environment);
                finish(command).succeeded();
            }
        }
        let local = weights(&sandbox, "local", "--set data.source=set", &[]);
        let source = format!("--set data.source={uri}");
        let cold = weights(&sandbox, "cold", &source, &environment);
        assert_eq!(cold, local, "{service}, cold");
        let warm = weights(&sandbox, "warm", &source, &environment);
        assert_eq!(warm, local, "{service}, warm");
        let log = fs::read_to_string(sandbox.path("runs/warm/loader.jsonl")).expect("a log");
        let line: serde_json::Value =
            serde_json::from_str(log.lines().last().expect("a line")).expect("JSON");
        assert!(line["disk_hits"].as_u64() > Some(0), "{line}");
        assert_eq!(line["reads"], 1, "the manifest alone: {line}");
        let bare = weights(
            &sandbox,
            "bare",
            &format!("{source} --set data.cache.memory_mib=0 --set data.cache.disk_mib=0"),
            &environment,
        );
        assert_eq!(bare, local, "{service}, without any cache");
    }
}

#[test]
fn a_resumed_run_refuses_another_dataset() {
    let sandbox = with_captures();
    sandbox.run("data prepare plan.toml").succeeded();
    weights(&sandbox, "run", "--set data.source=set", &[]);
    let resume = "train c.toml --name run --set data.kind=phrases --set data.source=set \
                  --set train.max_steps=8 --set sampling.count_at_end=1 --resume";
    sandbox.write("captures/two.bvh", bvh(120));
    sandbox.run("data prepare plan.toml").succeeded();
    sandbox
        .run(resume)
        .failed(2, &["not the one trained on so far", "hint:"]);
    sandbox.write("captures/two.bvh", bvh(300));
    sandbox.run("data prepare plan.toml").succeeded();
    // The same files with another held-out split.
    sandbox.write("plan.toml", PLAN.replace("two_*", "one_*"));
    sandbox.run("data prepare plan.toml").succeeded();
    sandbox
        .run(resume)
        .failed(2, &["not the one trained on so far"]);
    sandbox.write("plan.toml", PLAN);
    sandbox.run("data prepare plan.toml").succeeded();
    // The dataset may have moved.
    fs::rename(sandbox.path("set"), sandbox.path("moved")).expect("moved");
    let moved = resume.replace("data.source=set", "data.source=moved");
    sandbox.run(&moved).succeeded();
}

#[test]
fn a_phrase_that_changes_during_a_run_stops_it_after_a_checkpoint() {
    let sandbox = with_captures();
    sandbox.run("data prepare plan.toml").succeeded();
    let arguments = "train c.toml --set data.kind=phrases --set data.source=set \
                     --set train.max_steps=100000 --set data.cache.memory_mib=0";
    let mut child = {
        let mut command = sandbox.command(arguments.split_whitespace());
        command.stderr(fs::File::create(sandbox.path("log")).expect("a log"));
        command.stdout(std::process::Stdio::null());
        command.spawn().expect("the binary starts")
    };
    wait_for(&mut child, "a checkpoint", || {
        !sandbox.list("runs/smallest/checkpoints").is_empty()
    });
    for id in sandbox.list("set/motion") {
        let path = sandbox.path(format!("set/motion/{id}/trajectory.npy"));
        let mut bytes = fs::read(&path).expect("a file");
        bytes[200] ^= 1;
        fs::write(path, bytes).expect("written");
    }
    let status = child.wait().expect("it ends");
    let log = fs::read_to_string(sandbox.path("log")).expect("a log");
    assert_eq!(status.code(), Some(2), "{log}");
    for text in [
        "trajectory.npy",
        "when the dataset was opened",
        "saved runs/smallest",
        "hint:",
    ] {
        assert!(log.contains(text), "no `{text}` in {log}");
    }
}

#[test]
fn songs_become_features_pictures_and_motion() {
    let sandbox = sandbox();
    sandbox.write("songs/a.wav", wav(6));
    let tones = workspace().join("data_fixtures/audio/tones.mp3");
    let heard = sandbox
        .run(&format!(
            "audio features songs/a.wav {} --out features --plot",
            tones.display()
        ))
        .succeeded();
    assert!(heard.stdout.contains("120.0"), "{}", heard.stdout);
    let features = kinegrad_data::load_audio(
        &sandbox.path("features/a/features.npz"),
        AudioLayout::CCMOTION,
    );
    assert_eq!(features.expect("features").frames(), 181);
    let cut = "--start 1.5 --duration 2 --out cut --plot";
    sandbox
        .run(&format!("audio features songs/a.wav {cut}"))
        .succeeded();
    let read = |file: &str| {
        kinegrad_data::load_audio(&sandbox.path(file), AudioLayout::CCMOTION).expect("features")
    };
    let whole = read("features/a/features.npz");
    assert_eq!(read("cut/a/features.npz"), whole.slice(45..105));
    for (wrong, found) in [
        ("--start 60", "6.0 seconds"),
        ("--start -5", "`--start` is -5, allowed: 0 seconds or more"),
        (
            "--duration 0",
            "`--duration` is 0, allowed: more than 0 seconds\n",
        ),
        ("--duration -1", "`--duration` is -1, allowed: more than 0"),
    ] {
        let line = format!("audio features songs/a.wav {wrong} --out wrong");
        sandbox.run(&line).failed(2, &[found, "hint:"]);
    }
    assert!(!sandbox.path("wrong").exists());
    // Existing files stay unless they are to be replaced, with two songs too.
    let kept = fs::read(sandbox.path("cut/a/features.npz")).expect("features");
    sandbox.write("songs/b.wav", wav(3));
    let again = "audio features songs/b.wav songs/a.wav --out cut";
    sandbox
        .run(again)
        .failed(2, &["cut/a/features.npz exists already", "`--overwrite`"]);
    assert_eq!(sandbox.list("cut"), ["a"]);
    assert!(kept == fs::read(sandbox.path("cut/a/features.npz")).expect("features"));
    fs::remove_file(sandbox.path("features/a/features.npz")).expect("removed");
    sandbox
        .run("audio features songs/a.wav --out features --plot")
        .failed(2, &["features/a/features.png exists already"]);
    sandbox
        .run("audio features songs/a.wav --out features --plot --overwrite")
        .succeeded();
    sandbox.run(&format!("{again} --overwrite")).succeeded();
    assert_eq!(read("cut/a/features.npz"), whole);
    for name in ["a", "tones"] {
        let picture = fs::read(sandbox.path(format!("features/{name}/features.png")));
        assert!(picture.expect("a picture").starts_with(b"\x89PNG"));
    }
    sandbox
        .run("train c.toml --set train.max_steps=4")
        .succeeded();
    sandbox
        .run("sample runs/smallest --audio songs/a.wav --start 2.5 --out dance --steps 2")
        .succeeded();
    let motion = kinegrad_data::read_motion(&sandbox.path("dance.npy")).expect("motion");
    assert_eq!(motion.frames(), 106, "all that is left of the song");
    sandbox
        .run("sample runs/smallest --audio songs/a.wav --start 60 --out dance")
        .failed(2, &["--start", "hint:"]);
    sandbox.write("songs/bad.mp3", "no song at all");
    sandbox
        .run("audio features songs/bad.mp3 songs/a.wav --out more")
        .failed(2, &["bad.mp3", "hint:"]);
    assert_eq!(sandbox.list("more"), ["a"], "the others are done");
}

#[cfg(unix)]
#[test]
fn links_out_of_the_dataset_and_zip_bombs_are_refused() {
    use std::os::unix::fs::symlink;
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 4 --frames 30")
        .succeeded();
    let train = "train c.toml --set data.kind=phrases --set data.source=set";
    let motion = sandbox.path("set/motion/synthetic_00001/trajectory.npy");
    fs::rename(&motion, sandbox.path("outside.npy")).expect("moved");
    symlink(sandbox.path("outside.npy"), &motion).expect("a link");
    sandbox.run(train).failed(
        2,
        &["symbolic link", "synthetic_00001/trajectory.npy", "hint:"],
    );
    let inspected = sandbox.run("data inspect set").failed(1, &[]);
    assert!(
        inspected.stdout.contains("symbolic link"),
        "{}",
        inspected.stdout
    );
    fs::remove_file(&motion).expect("removed");
    fs::rename(sandbox.path("outside.npy"), &motion).expect("back");

    let python = workspace().join("target/emulators/bin/python");
    let bomb = "import zipfile, sys\n\
                with zipfile.ZipFile(sys.argv[1], 'w', zipfile.ZIP_DEFLATED) as z:\n    \
                    with z.open('mel.npy', 'w', force_zip64=True) as f:\n        \
                        for _ in range(400): f.write(bytes(1 << 20))\n";
    let target = sandbox.path("set/audio_features/synthetic_00002/features.npz");
    let made = std::process::Command::new(python)
        .args(["-c", bomb])
        .arg(&target)
        .status()
        .expect("python runs");
    assert!(made.success());
    assert!(fs::metadata(&target).expect("a file").len() < 1 << 20);
    sandbox.run(train).failed(
        2,
        &[
            "synthetic_00002/features.npz",
            "mel",
            "bytes unpacked",
            "hint:",
        ],
    );
}

#[test]
fn a_dataset_written_with_numpy_as_documented_trains() {
    let docs = fs::read_to_string(workspace().join("docs/dataset.md")).expect("the page");
    let (_, rest) = docs.split_once("```python\n").expect("an example");
    let (example, _) = rest.split_once("```").expect("its end");
    let sandbox = sandbox();
    sandbox.write("write.py", example);
    let python = workspace().join("target/emulators/bin/python");
    let written = std::process::Command::new(python)
        .arg("write.py")
        .current_dir(sandbox.path(""))
        .status()
        .expect("python runs");
    assert!(written.success());
    let inspected = sandbox.run("data inspect DATASET").succeeded();
    assert!(
        inspected.stdout.contains("240"),
        "two phrases: {}",
        inspected.stdout
    );
    weights(
        &sandbox,
        "numpy",
        "--set data.source=DATASET --set data.validation.fraction=0.0",
        &[],
    );
}
