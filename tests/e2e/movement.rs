//! The strict checks: intentionally broken motions, samples of an untrained decoder, and runs
//! without stored movement statistics.

use std::fs;

use kinegrad_data::{Digest, motion_path, read_motion, synthetic, write_motion};
use kinegrad_motion::phrase::{ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, VELOCITY};
use kinegrad_motion::{FPS, Phrase, Quaternion, derive};
use kinegrad_random::{Key, Purpose};
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};
use serde_json::Value;

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

fn parsed(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

/// Names of the checks that a file of a `check --json` fails.
fn failed(file: &Value) -> Vec<&str> {
    let checks = file["checks"].as_array().expect("checks").iter();
    let failed = checks.filter(|check| check["passed"] == false);
    failed
        .map(|check| check["name"].as_str().expect("a name"))
        .collect()
}

/// The phrase with other poses and consistent channels.
fn posed(
    motion: &Phrase,
    pose: impl Fn(usize, [f64; 3], Quaternion, f64) -> ([f64; 3], Quaternion, f64),
) -> Phrase {
    let frames = 0..motion.frames();
    let phase = |t| f64::from(motion.frame(t)[PHASE]);
    let poses: Vec<_> = frames
        .map(|t| {
            pose(
                t,
                motion.vector(t, POSITION),
                motion.quaternion(t),
                phase(t),
            )
        })
        .collect();
    let positions: Vec<_> = poses.iter().map(|pose| pose.0).collect();
    let quaternions: Vec<_> = poses.iter().map(|pose| pose.1).collect();
    let phases: Vec<_> = poses.iter().map(|pose| pose.2).collect();
    let style = vec![[0.0; 8]; poses.len()];
    derive(&positions, &quaternions, &phases, &style).expect("a phrase")
}

/// Broken variants of the phrase: name, motion, checks it must fail.
fn broken(good: &Phrase) -> Vec<(&'static str, Phrase, Vec<&'static str>)> {
    let (place, still) = (good.vector(0, POSITION), good.quaternion(0));
    let noise = Key::new(5, Purpose::Noise).normals(3 * good.frames());
    let shaken = |t: usize, place: [f64; 3]| {
        [0, 1, 2].map(|axis| place[axis] + 0.01 * f64::from(noise[3 * t + axis]))
    };
    let mut lying = posed(good, |t, p, q, phase| (shaken(t, p), q, phase));
    let mut turning = good.clone();
    for t in 0..good.frames() {
        for channels in [VELOCITY, ACCELERATION] {
            lying.set_vector(t, channels.clone(), good.vector(t, channels));
        }
        let turned = good.vector(t, ANGULAR_VELOCITY);
        turning.set_vector(t, ANGULAR_VELOCITY, turned.map(|rate| -rate));
    }
    let yaw = Quaternion::from_yaw;
    let about = |angle: f64| move |p, q: Quaternion, phase| (p, yaw(angle) * q, phase);
    vec![
        (
            "frozen",
            posed(good, |_, _, _, phase| (place, still, phase)),
            vec!["path_speed", "path_acceleration", "path_jerk", "turn_rate"],
        ),
        (
            "stopped altogether",
            posed(good, |_, _, _, _| (place, still, 0.3)),
            vec!["path_speed", "turn_rate", "phase_rate"],
        ),
        (
            "noise of a centimetre",
            posed(good, |t, p, q, phase| (shaken(t, p), q, phase)),
            vec!["path_acceleration", "path_jerk"],
        ),
        (
            "heading flips",
            posed(good, |t, p, q, phase| {
                about(if t % 24 < 12 { 0.0 } else { 3.0 })(p, q, phase)
            }),
            vec!["largest_turn", "turn_acceleration"],
        ),
        (
            "spinning",
            posed(good, |t, p, q, phase| {
                about(t as f64 * 18.0 / FPS)(p, q, phase)
            }),
            vec!["turn_rate"],
        ),
        (
            "trembling in its rotation",
            posed(good, |t, p, q, phase| {
                about(0.2 * f64::from(noise[t]))(p, q, phase)
            }),
            vec!["turn_rate", "turn_acceleration"],
        ),
        (
            "upside down",
            posed(good, |_, p, q, phase| {
                (p, q * Quaternion::new(0.0, 0.0, 0.0, 1.0), phase)
            }),
            vec!["largest_tilt"],
        ),
        (
            "phase that stands",
            posed(good, |_, p, q, _| (p, q, 0.5)),
            vec!["phase_rate"],
        ),
        (
            "phase that never wraps",
            posed(good, |t, p, q, _| {
                (p, q, 0.17 + 0.71 * t as f64 / good.frames() as f64)
            }),
            vec!["phase_rate"],
        ),
        (
            "phase that runs backwards",
            posed(good, |_, p, q, phase| (p, q, 1.0 - phase)),
            vec!["phase_direction", "phase_rate"],
        ),
        (
            "phase that leaps over a third of the bar",
            posed(good, |_, p, q, phase| (p, q, 0.17 + 0.66 * phase)),
            vec!["largest_phase_step"],
        ),
        (
            "carried off",
            posed(good, |t, [x, y, z], q, phase| {
                ([x + 0.2 * t as f64, y, z], q, phase)
            }),
            vec!["path_speed", "travel"],
        ),
        (
            "channels that lie about the path",
            lying,
            vec!["velocity_coherence", "path_jerk"],
        ),
        (
            "channels that lie about the turning",
            turning,
            vec!["rotation_coherence"],
        ),
    ]
}

#[test]
fn motions_broken_on_purpose_fail_by_name_and_real_ones_pass() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --out set --phrases 40 --frames 120 --seed 4")
        .succeeded();
    let passed = sandbox
        .run("check set/motion --profile strict --source set")
        .succeeded();
    assert!(passed.stdout.contains("40 of 40 pass"), "{}", passed.stdout);

    fs::create_dir(sandbox.path("broken")).expect("a folder");
    for index in [3, 17] {
        let path = sandbox.path(format!("set/{}", motion_path(&synthetic::id(index))));
        let good = read_motion(&path).expect("a phrase");
        let all = broken(&good);
        for (name, motion, _) in &all {
            let file = sandbox.path(format!("broken/{}.npy", name.replace(' ', "-")));
            write_motion(&file, motion).expect("written");
        }
        let found = sandbox
            .run("check broken --profile strict --source set --json")
            .failed(1, &[]);
        let found = parsed(&found.stdout);
        assert_eq!(found["passed"], 0, "{index}: {found:#}");
        for (name, _, expected) in all {
            let path = format!("broken/{}.npy", name.replace(' ', "-"));
            let files = found["files"].as_array().expect("files");
            let file = files.iter().find(|file| file["path"] == path.as_str());
            let failed = failed(file.expect("checked"));
            for check in expected {
                assert!(failed.contains(&check), "{index} {name}: {failed:?}");
            }
        }
        // The channel checks pass most of them.
        let document = sandbox.run("check broken --profile ccmotion --json");
        let document = parsed(&document.stdout);
        assert_eq!(document["passed"], 14, "{document:#}");
    }
}

#[test]
fn construction_is_not_learning() {
    let sandbox = sandbox();
    sandbox.write("c.toml", SMALLEST);
    sandbox
        .run("train c.toml --name base --set train.max_steps=8")
        .succeeded();
    // The warm-up starts at zero, so the single step does not change the decoder.
    sandbox
        .run(
            "train c.toml --name untrained --set train.recipe=decoder \
             --set init.diffusion=runs/base --set decoder.hidden_dim=32 \
             --set decoder.coherence=projection --set rollout.steps=3 --set train.max_steps=1",
        )
        .succeeded();
    let evaluated = sandbox
        .run("eval runs/untrained --steps 4 --json")
        .succeeded();
    let evaluation = &parsed(&evaluated.stdout)["evaluations"][0];
    let strict = &evaluation["raw"]["strict"];
    let rate = |name: &str| {
        let checks = strict["checks"].as_array().expect("checks");
        let check = checks.iter().find(|check| check["name"] == name);
        check.expect(name)["pass_rate"].as_f64().expect("a rate")
    };
    for by_construction in [
        "finite",
        "quaternion_norm",
        "quaternion_sign",
        "velocity_coherence",
        "accel_coherence",
        "rotation_coherence",
    ] {
        assert_eq!(rate(by_construction), 1.0, "{by_construction}: {strict:#}");
    }
    assert_eq!(strict["pass_rate"], 0.0, "{strict:#}");
    for of_motion in ["phase_direction", "turn_acceleration"] {
        assert_eq!(rate(of_motion), 0.0, "{of_motion}: {strict:#}");
    }
}

/// Removes the movement from the statistics of every checkpoint of a run.
fn forget_movement(sandbox: &Sandbox, run: &str) {
    for step in sandbox.list(&format!("{run}/checkpoints")) {
        let path = sandbox.path(format!("{run}/checkpoints/{step}/state.json"));
        let Ok(text) = fs::read_to_string(&path) else {
            continue;
        };
        let begins = text.find("    \"movement\": {").expect("movement");
        let ends = begins + text[begins..].find("\n    }").expect("its end") + "\n    }".len();
        // It is the last of the statistics, after a comma.
        let before = text[..begins].trim_end();
        let (before, after) = match text[ends..].strip_prefix(',') {
            Some(after) => (before, after),
            None => (before.trim_end_matches(','), &text[ends..]),
        };
        let whole = format!("{before}{after}");
        let seal = ",\n  \"state_sha256\": \"";
        let body = &whole[..whole.rfind(seal).expect("a seal")];
        let sealed = format!("{body}{seal}{}\"\n}}\n", Digest::of(body.as_bytes()));
        fs::write(path, sealed).expect("written");
    }
}

#[test]
fn runs_of_before_the_movement_was_measured_say_what_to_do() {
    let sandbox = sandbox();
    sandbox.write("c.toml", SMALLEST);
    sandbox
        .run("data synth --out set --phrases 12 --frames 40")
        .succeeded();
    let data = "--set sampling.count_at_end=2 --set data.kind=phrases --set data.source=set \
                --set data.validation.patterns=[\"*_00000\",\"*_00001\"]";
    sandbox
        .run(&format!(
            "train c.toml --name old {data} --set train.max_steps=8"
        ))
        .succeeded();
    let evaluate = "eval runs/old --steps 3 --json";
    let before = parsed(&sandbox.run(evaluate).succeeded().stdout);
    forget_movement(&sandbox, "runs/old");

    let said = sandbox.run("check set/motion --run runs/old").stdout;
    assert!(said.contains("captured people"), "{said}");
    // An evaluation can read the training phrases.
    let after = parsed(&sandbox.run(evaluate).succeeded().stdout);
    assert_eq!(after, before);
    let printed = sandbox.run("eval runs/old --steps 3").succeeded().stdout;
    assert!(
        printed.contains("those of its dataset's 10 training phrases"),
        "{printed}"
    );
    let resumed = sandbox
        .run(&format!(
            "train c.toml --name old {data} --set train.max_steps=10 --resume"
        ))
        .succeeded();
    let table = resumed.stdout.lines().find(|line| line.contains("_00000"));
    let verdict = table.and_then(|line| line.split('|').nth(2)).map(str::trim);
    assert_eq!(verdict, Some("FAIL"), "{}", resumed.stdout);
    // A run initialised from it has the statistics again.
    let tuned = sandbox
        .run(&format!(
            "train c.toml --name tuned {data} --set train.recipe=decoder \
             --set init.diffusion=runs/old --set decoder.hidden_dim=32 --set rollout.steps=3 \
             --set train.max_steps=2"
        ))
        .succeeded();
    assert!(tuned.stdout.contains("FAIL"), "{}", tuned.stdout);
    let said = sandbox.run("check set/motion --profile strict --run runs/tuned");
    said.succeeded();
    sandbox.run("report runs/old").succeeded();
}
