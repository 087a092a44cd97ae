//! Names and texts from elsewhere: not UTF-8, with control characters, very long.

use std::fs;

use kinegrad_tests::sandbox::{Finished, SMALLEST, Sandbox, finish};

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

/// Rewrites the terminal's title, rings, and begins a line.
const CONTROLS: &str = "x\u{1b}]0;owned\u{7}\nerror: forged";

/// Asserts that the output has no control characters and no forged line.
#[track_caller]
fn is_plain(said: &Finished) {
    for text in [&said.stdout, &said.stderr] {
        let control = |c: char| c.is_control() && c != '\n';
        assert!(!text.contains(control), "{text:?}");
        assert!(
            !text.lines().any(|line| line == "error: forged"),
            "{text:?}"
        );
    }
}

#[cfg(unix)]
#[test]
fn file_names_cannot_control_the_terminal() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --phrases 1 --frames 40 --out set")
        .succeeded();
    let motion = sandbox.path("set/motion/synthetic_00000/trajectory.npy");
    let name = format!("{CONTROLS}.npy");
    fs::copy(&motion, sandbox.path(&name)).expect("copied");
    let out = format!("{CONTROLS}.html");
    for arguments in [
        vec!["check", &name],
        vec!["check", &name, "--json"],
        vec!["view", &name, "--out", &out],
        vec!["view", &name, "--out", &out],
        vec!["plot", &name, "--out", CONTROLS],
        vec!["check", CONTROLS],
        vec!["report", CONTROLS],
        vec!["runs", CONTROLS],
        vec!["data", "inspect", CONTROLS],
        vec!["train", CONTROLS],
        vec!["sample", CONTROLS, "--out", CONTROLS],
        vec!["--", CONTROLS],
        vec!["check", "--profile", CONTROLS],
    ] {
        let said = finish(sandbox.command(&arguments));
        assert!(matches!(said.code, Some(0..=2)), "{arguments:?}: {said:?}");
        is_plain(&said);
    }
    fs::create_dir_all(sandbox.path(format!("runs/{CONTROLS}/checkpoints"))).expect("a folder");
    sandbox.write(&format!("runs/{CONTROLS}/config.toml"), "= none");
    let said = sandbox.run("runs").succeeded();
    is_plain(&said);
    assert!(
        said.stdout
            .contains("x\\u{1b}]0;owned\\u{7}\\nerror: forged"),
        "{said:?}"
    );
}

#[test]
fn texts_of_files_cannot_control_the_terminal() {
    let sandbox = sandbox();
    let key = "\"x\\u001b]0;owned\\u0007\\nerror: forged\"";
    sandbox.write("c.toml", format!("[train]\n{key} = 1\n"));
    sandbox.write("goal.toml", format!("{key} = 1\n"));
    sandbox.write("name.toml", SMALLEST.replace("\"smallest\"", key));
    sandbox.write("path.csv", format!("\"{CONTROLS}\",z\n0,0\n"));
    for (arguments, text) in [
        ("train c.toml", "forged"),
        ("config show c.toml", "forged"),
        ("train name.toml", "`run.name`"),
        ("plot walk.npy --goal goal.toml --out p.svg", "forged"),
        ("warp walk.npy --path path.csv --out w", "path.csv"),
    ] {
        sandbox
            .run("data synth --walks --phrases 4 --frames 60 --out walks")
            .code
            .expect("an end");
        fs::copy(
            sandbox.path("walks/new_joint_vecs/walk_00000.npy"),
            sandbox.path("walk.npy"),
        )
        .expect("copied");
        let said = sandbox.run(arguments).failed(2, &[text]);
        is_plain(&said);
    }
}

#[test]
fn messages_are_bounded() {
    let sandbox = sandbox();
    let long = "k".repeat(20_000);
    sandbox.write("c.toml", format!("{long} = 1\n"));
    for arguments in [
        vec!["train", "c.toml"],
        vec!["train", "--set", &long],
        vec!["check", &long],
    ] {
        let said = finish(sandbox.command(&arguments));
        assert_eq!(said.code, Some(2), "{said:?}");
        let length = said.stderr.len();
        assert!(length < 9_000, "{length} bytes: {arguments:?}");
    }
}

#[cfg(target_os = "linux")]
mod not_utf8 {
    use std::ffi::{OsStr, OsString};
    use std::os::unix::ffi::OsStrExt;
    use std::path::Path;

    use super::*;

    /// A name that is not UTF-8.
    fn odd(ending: &str) -> OsString {
        let mut name = OsStr::from_bytes(b"a\xff").to_owned();
        name.push(ending);
        name
    }

    fn run(sandbox: &Sandbox, arguments: &[&OsStr]) -> Finished {
        let said = finish(sandbox.command(arguments));
        assert!(!said.stderr.contains("panicked"), "{said:?}");
        said
    }

    #[test]
    fn a_run_whose_config_would_name_such_a_folder_is_refused() {
        let sandbox = sandbox();
        sandbox.write("c.toml", SMALLEST);
        let train = "train c.toml --set train.recipe=e2e";
        let runs = odd("");
        let mut arguments: Vec<&OsStr> = train.split_whitespace().map(OsStr::new).collect();
        arguments.extend([OsStr::new("--runs-dir"), runs.as_os_str()]);
        run(&sandbox, &arguments).failed(2, &["the path is not UTF-8", "--runs-dir"]);
    }

    #[test]
    fn samples_have_the_names_that_were_asked_for() {
        let sandbox = sandbox();
        sandbox.write("c.toml", SMALLEST);
        let train = "train c.toml --set train.max_steps=2 --set validation.every_steps=0 \
                     --set sampling.count_at_end=1";
        let runs = odd("");
        let mut arguments: Vec<&OsStr> = train.split_whitespace().map(OsStr::new).collect();
        arguments.extend([OsStr::new("--runs-dir"), &runs, OsStr::new("--json")]);
        run(&sandbox, &arguments).succeeded();
        let run_folder = Path::new(&runs).join("smallest");
        let samples = fs::read_dir(sandbox.path(run_folder.join("samples"))).expect("samples");
        assert_eq!(samples.count(), 3);
        for (out, json) in [("out", false), ("out.npy", true)] {
            let out = odd(out);
            let mut arguments = vec![OsStr::new("sample"), run_folder.as_os_str()];
            arguments.extend([OsStr::new("--out"), &out, OsStr::new("--overwrite")]);
            arguments.extend(json.then_some(OsStr::new("--json")));
            run(&sandbox, &arguments).succeeded();
            for ending in ["out.npy", "out.json"] {
                assert!(sandbox.path(odd(ending)).is_file(), "{ending}");
            }
        }
        let record = fs::read_to_string(sandbox.path(odd("out.json"))).expect("a record");
        assert!(record.contains("a\u{fffd}/smallest"), "{record}");
    }

    #[test]
    fn motions_of_such_names_are_matched_moved_and_shown() {
        let sandbox = sandbox();
        sandbox
            .run("data synth --walks --phrases 4 --frames 60 --out walks")
            .succeeded();
        let (motion, path, out) = (odd(".npy"), odd(".toml"), odd("out"));
        let clip = sandbox.path("walks/new_joint_vecs/walk_00000.npy");
        fs::copy(clip, sandbox.path(&motion)).expect("copied");
        fs::write(
            sandbox.path(&path),
            "points = [[1, 1], [3.4, 4.2]]\ncurve = 'line'\n",
        )
        .expect("written");
        let named = |text: &'static str| OsStr::new(text);
        let bvh = odd("out.bvh");
        let matched = odd("matched.bvh");
        for arguments in [
            vec![
                named("warp"),
                &motion,
                named("--path"),
                &path,
                named("--out"),
                &out,
            ],
            vec![named("match"), &bvh, named("--out"), &matched],
            vec![
                named("match"),
                &bvh,
                named("--out"),
                &matched,
                named("--overwrite"),
                named("--json"),
            ],
            vec![named("check"), &motion, named("--json")],
            vec![named("view"), &motion],
        ] {
            let said = run(&sandbox, &arguments);
            assert!(matches!(said.code, Some(0 | 1)), "{arguments:?}: {said:?}");
        }
        for ending in [
            "out.npy",
            "out.json",
            "matched.bvh",
            "matched.json",
            ".html",
        ] {
            assert!(sandbox.path(odd(ending)).is_file(), "{ending}");
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn threads_are_those_of_the_machine() {
    let sandbox = sandbox();
    let mut command = sandbox.command("data synth --phrases 100 --frames 300 --out set".split(' '));
    let mut running = command
        .env("RAYON_NUM_THREADS", "2000")
        .spawn()
        .expect("a process");
    let status = format!("/proc/{}/status", running.id());
    let mut most = 0;
    while running.try_wait().expect("a status").is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let threads = text.lines().find_map(|line| line.strip_prefix("Threads:"));
        let threads = threads.and_then(|number| number.trim().parse().ok());
        most = most.max(threads.unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(running.wait().expect("an end").success());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    assert!((1..=cores + 8).contains(&most), "{most} threads");
}
