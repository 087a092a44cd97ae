//! Autoregressive motion: training, sampling from histories and texts, evaluation.

use std::fs;

use kinegrad_data::{read_array, write_values};
use kinegrad_tests::sandbox::{Finished, Sandbox, finish};
use serde_json::Value;

/// Walks with a few captions; the model learns an embedding of each.
pub const FLOW: &str = r#"
[run]
name = "flow"
device = "cpu"
[data]
kind = "humanml3d"
source = "walks"
target_frames = 60
batch_size = 8
num_workers = 0
[data.humanml3d]
text = "labels"
[model]
size = "tiny"
joint_dim = 8
context_dim = 8
gru_dim = 8
decoder_dim = 16
latent_dim = 16
ff_size = 16
[pose]
history_frames = 6
history_noise_std = 0.02
target = "displacement"
[optim]
learning_rate = 3e-3
warmup_steps = 5
[train]
recipe = "flow"
max_steps = 60
[ema]
decay = 0.9
[checkpoint]
every_steps = 15
[validation]
every_steps = 20
[sampling.sampler]
num_inference_steps = 4
[evaluation]
rollouts = 3
frames = 40
"#;

/// Writes the config and its walks.
pub fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("data synth --walks --phrases 40 --frames 48 --out walks")
        .succeeded();
    sandbox.write("c.toml", FLOW);
    sandbox
}

fn trained() -> Sandbox {
    let sandbox = sandbox();
    sandbox.run("train c.toml").succeeded();
    sandbox
}

fn values(sandbox: &Sandbox, name: &str) -> Vec<f32> {
    read_array(&sandbox.path(name)).expect("an array").values
}

/// A caption of the run.
fn captions(sandbox: &Sandbox) -> Vec<String> {
    let config = fs::read_to_string(sandbox.path("runs/flow/config.toml")).expect("a config");
    let config: toml::Table = config.parse().expect("TOML");
    let known = config["text"]["captions"].as_array().expect("captions");
    known
        .iter()
        .map(|caption| caption.as_str().expect("text").to_owned())
        .collect()
}

/// `sample runs/flow` with arguments in which `FIRST` and `SECOND` are captions.
fn said(sandbox: &Sandbox, arguments: &str, captions: &[String]) -> Finished {
    let command = ["sample", "runs/flow", "--overwrite"];
    let arguments = arguments.split_whitespace().map(|argument| match argument {
        "FIRST" => captions[0].as_str(),
        "SECOND" => captions[1].as_str(),
        other => other,
    });
    finish(sandbox.command(command.into_iter().chain(arguments)))
}

#[test]
fn a_motion_goes_on_from_its_history_as_the_texts_say() {
    let sandbox = trained();
    let captions = captions(&sandbox);
    let [first, second] = [&captions[0], &captions[1]];
    let draw = |arguments: &str| said(&sandbox, arguments, &captions).succeeded();
    // From a clip of the dataset, for two seconds: 40 frames.
    draw("--item walk_00003 --seconds 2 --out start");
    let array = read_array(&sandbox.path("start.npy")).expect("an array");
    assert_eq!(array.shape, [40, 22, 3]);
    assert!(array.values.iter().all(|value| value.is_finite()));
    let record = fs::read_to_string(sandbox.path("start.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["rollout"]["evaluations_per_frame"], 4.0);

    let on = |settings: &str| {
        draw(&format!(
            "--history start.npy --frames 9 --out on {settings}"
        ));
        values(&sandbox, "on.npy")
    };
    // The history may be a capture.
    sandbox.write("line.toml", "points = [[0, 0], [0, 3]]\n");
    sandbox
        .run("warp walks/new_joint_vecs/walk_00003.npy --path line.toml --along own --out walk")
        .succeeded();
    draw("--history walk.bvh --frames 9 --text FIRST --out capture");
    assert_eq!(values(&sandbox, "capture.npy").len(), 9 * 66);

    let same = on("--text FIRST");
    assert_eq!(same, on("--text FIRST"), "the same draw again");
    let record = fs::read_to_string(sandbox.path("on.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["condition"]["history"], "start.npy");
    assert_eq!(record["condition"]["text"]["text"], first.as_str());
    assert_eq!(record["rollout"]["same_noise"], false);
    assert_eq!(record["rollout"]["said"][0]["text"], first.as_str());
    // It starts where the history ends.
    let last = &array.values[39 * 66..];
    let apart = last.iter().zip(&same[..66]).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 0.5, "a jump at the first frame");
    for other in [
        "--text SECOND",
        "--text FIRST --seed 1",
        "--text FIRST --steps 2",
        "--text FIRST --set sampling.sampler.kind=midpoint",
        "--text FIRST --guidance-scale 2",
        "--text FIRST --set evaluation.constant_bones=false",
        "--text FIRST --set evaluation.same_noise=true",
        "",
    ] {
        assert_ne!(on(other), same, "{other} changes nothing");
    }
    // Another history gives another motion, not only another position.
    draw("--item walk_00005 --seconds 2 --out start");
    let other = on("--text FIRST");
    let about_root = |values: &[f32]| -> Vec<f32> {
        let frames = values.chunks_exact(66);
        frames
            .flat_map(|frame| {
                frame
                    .chunks_exact(3)
                    .flat_map(|at| [at[0] - frame[0], at[1]])
            })
            .collect()
    };
    assert_ne!(about_root(&other), about_root(&same));

    // A sequence of prompts: up to the change, frames equal those of the first prompt alone.
    let plan = format!(
        "[[step]]\nseconds = 0.5\ntext = \"{first}\"\n[[step]]\nseconds = 0.5\ntext = \"{second}\"\n"
    );
    sandbox.write("plan.toml", &plan);
    draw("--history start.npy --prompts plan.toml --out planned");
    draw("--history start.npy --frames 20 --text FIRST --out alone");
    let (planned, alone) = (
        values(&sandbox, "planned.npy"),
        values(&sandbox, "alone.npy"),
    );
    assert_eq!(planned.len(), 20 * 66);
    assert_eq!(planned[..10 * 66], alone[..10 * 66]);
    assert_ne!(planned[10 * 66..], alone[10 * 66..]);

    // Without a history, it continues a held-out clip with the caption, if there is one.
    let held_out = fs::read_to_string(sandbox.path("walks/val.txt")).expect("a list of clips");
    let texts = held_out.lines().map(|clip| {
        fs::read_to_string(sandbox.path(format!("walks/texts/{clip}.txt"))).expect("captions")
    });
    let texts: Vec<String> = texts.collect();
    let mut begun = 0;
    for caption in &captions {
        let known = [caption.clone(), first.clone()];
        let drawn = said(&sandbox, "--text FIRST --frames 1 --out begun", &known).succeeded();
        let record = fs::read_to_string(sandbox.path("begun.json")).expect("a record");
        let record: Value = serde_json::from_str(&record).expect("JSON");
        let clip = record["condition"]["item"]["id"].as_str().expect("a clip");
        assert!(drawn.stderr.contains(clip), "{}", drawn.stderr);
        let does = |text: &String| {
            text.lines()
                .any(|line| line.starts_with(&format!("{caption}#")))
        };
        if texts.iter().any(does) {
            let text = sandbox.path(format!("walks/texts/{clip}.txt"));
            assert!(
                does(&fs::read_to_string(text).expect("captions")),
                "{caption}: {clip}"
            );
            begun += 1;
        }
    }
    assert!(begun > 1, "no caption of held-out clips");

    // A prompt may be empty.
    let silent = format!("{plan}[[step]]\nseconds = 0.2\n");
    sandbox.write("silent.toml", &silent);
    draw("--history start.npy --prompts silent.toml --out quiet");
    let quiet = values(&sandbox, "quiet.npy");
    assert_eq!(quiet.len(), 24 * 66);

    // An unusable option is refused by name, and nothing is written.
    write_values(&sandbox.path("short.npy"), &[6, 22, 3], &[0.5; 6 * 66]).expect("written");
    write_values(&sandbox.path("wide.npy"), &[9, 21, 3], &[0.5; 9 * 63]).expect("written");
    let mut broken = vec![0.5; 9 * 66];
    broken[70] = f32::NAN;
    write_values(&sandbox.path("broken.npy"), &[9, 22, 3], &broken).expect("written");
    let start = values(&sandbox, "start.npy");
    let frames = start.len() / 66;
    for (name, factor) in [("far", 1e6), ("flat", 0.0), ("centimetres", 100.0)] {
        let scaled: Vec<f32> = start.iter().map(|value| value * factor).collect();
        let path = sandbox.path(format!("{name}.npy"));
        write_values(&path, &[frames, 22, 3], &scaled).expect("written");
    }
    // A frame without a body, and bodies above the ground.
    let mut holed = start.clone();
    let frame = frames - 3;
    holed[frame * 66..(frame + 1) * 66].fill(0.0);
    let up = start.iter().enumerate();
    let floating = up.map(|(at, value)| if at % 3 == 1 { value + 50.0 } else { *value });
    for (name, values) in [("holed", holed), ("floating", floating.collect())] {
        let path = sandbox.path(format!("{name}.npy"));
        write_values(&path, &[frames, 22, 3], &values).expect("written");
    }
    sandbox.write("empty.toml", "step = []\n");
    sandbox.write("odd.toml", "[[step]]\nseconds = -1.0\n");
    sandbox.write(
        "unknown.toml",
        "[[step]]\nseconds = 1.0\ntext = \"nobody says this\"\n",
    );
    for (arguments, texts) in [
        (
            "--history short.npy",
            ["short.npy: 6 frames", "7 frames or more"],
        ),
        ("--history wide.npy", ["wide.npy", "[T, 22, 3]"]),
        ("--history broken.npy", ["frame 1", "NaN"]),
        ("--history far.npy", ["far.npy", "at most 10000 m"]),
        ("--history flat.npy", ["flat.npy", "is 0.0000 m long"]),
        (
            "--history centimetres.npy",
            ["centimetres.npy", "allowed: 0.005 to 3"],
        ),
        ("--history holed.npy", ["in frame 37", "is 0.0000 m long"]),
        (
            "--history floating.npy",
            [
                "floating.npy: the lowest joint",
                "the floor, which is where y is 0",
            ],
        ),
        ("--history nowhere.npy", ["nowhere.npy", ""]),
        (
            "--history start.npy --item walk_00003",
            ["`--history` with `--item`", ""],
        ),
        (
            "--prompts empty.toml",
            ["empty.toml: it has no step", "[[step]]"],
        ),
        ("--prompts odd.toml", ["step[0].seconds", "more than 0"]),
        (
            "--prompts unknown.toml",
            ["unknown.toml: step[0]", "nobody says this"],
        ),
        (
            "--prompts plan.toml --frames 3",
            ["`--prompts` with a length", ""],
        ),
        ("--text nobody", ["`nobody` is not a caption", ""]),
        ("--goal plan.toml", ["`--goal` with", "--history"]),
        (
            "--set sampling.sampler.kind=ddim",
            ["sampling.sampler.kind", "euler"],
        ),
        (
            "--set sampling.sampler.tolerance=0.01",
            ["sampling.sampler.tolerance", "dopri5"],
        ),
    ] {
        let refused = format!("sample runs/flow --out no {arguments}");
        sandbox.run(&refused).failed(2, &texts);
        assert!(!sandbox.path("no.npy").exists(), "{arguments}");
    }
}

#[test]
fn rollouts_are_measured_beside_what_follows_in_held_out_clips() {
    let sandbox = trained();
    let report = |settings: &str| {
        let said = sandbox.run(&format!("eval runs/flow --json {settings}"));
        let report: Value = serde_json::from_str(&said.succeeded().stdout).expect("JSON");
        report["evaluations"][0].clone()
    };
    let number = |report: &Value, side: &str, name: &str| {
        let value = report[side][name].as_f64();
        value.unwrap_or_else(|| panic!("{side}.{name}: {report}"))
    };
    let with = report("");
    assert_eq!(with["evaluations_per_frame"], 4.0);
    assert!(number(&with, "sampled", "bone_change") < 1e-3);
    // The effect of a text is measured against another text.
    for texts in ["own_texts", "other_texts"] {
        assert!(number(&with, texts, "speed_error") > 0.0);
        assert!(number(&with, texts, "turn_error") > 0.0);
    }
    assert_ne!(with["own_texts"], with["other_texts"]);
    // After 60 training steps, bone lengths are not constant by themselves.
    let without = report("--set evaluation.constant_bones=false");
    assert!(number(&without, "sampled", "bone_change") > 0.01);
    for name in ["jerk", "speed", "turn_rate", "lowest_joint", "height_drift"] {
        number(&with, "sampled", name);
        number(&with, "real", name);
    }
    assert!(number(&with, "real", "bone_change") < 1e-3);
    assert!(number(&with, "sampled", "frechet_distance") > 0.0);
    let solver = report("--set sampling.sampler.kind=dopri5 --steps 2");
    assert_eq!(solver["evaluations_per_frame"], 12.0);
    sandbox
        .run("eval runs/flow --trajectory-run runs/flow")
        .failed(2, &["--trajectory-run"]);
    // Diverging samples are not an input error.
    let away = "sampling.sampler.guidance_scale=1e38";
    sandbox
        .run(&format!("eval runs/flow --set {away}"))
        .failed(1, &["after clip `", "frame 0", "not finite"]);
    let adaptive = "--set sampling.sampler.kind=dopri5 --set sampling.sampler.tolerance=1e-3";
    sandbox
        .run(&format!("eval runs/flow --set {away} {adaptive}"))
        .failed(1, &["after clip `", "frame 0", "not finite"]);
    sandbox
        .run(&format!("sample runs/flow --out away --set {away}"))
        .failed(1, &["sample", "frame 0", "not finite"]);
    // At the end of training too.
    let train = "train c.toml --name at_end --set train.max_steps=2 --set sampling.count_at_end=2";
    sandbox.run(train).succeeded();
    let samples = fs::read_dir(sandbox.path("runs/at_end/samples")).expect("samples");
    let names = samples.map(|entry| entry.expect("an entry").file_name());
    let arrays = names.filter(|name| name.to_string_lossy().ends_with(".npy"));
    assert_eq!(arrays.count(), 2);
}

#[test]
fn clips_too_short_to_go_on_from_are_not_measured() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let clips =
        "[data.synthetic]\nphrases = 300\nframes = 16\n[data.validation]\nfraction = 0.25\n";
    let config = FLOW
        .replace(
            "kind = \"humanml3d\"\nsource = \"walks\"",
            "kind = \"synthetic_walks\"",
        )
        .replace("[data.humanml3d]", "[data.humanml3d]\nmin_frames = 10");
    sandbox.write("c.toml", format!("{config}{clips}"));
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    let measured = sandbox.run("eval runs/flow");
    measured.failed(
        2,
        &["no held-out clip of", "has more than 16 frames", "--source"],
    );
}

#[test]
fn settings_that_cannot_work_are_refused_by_name() {
    let sandbox = sandbox();
    for (settings, texts) in [
        (
            "data.humanml3d.root=absolute",
            ["data.humanml3d.root", "relative"],
        ),
        (
            "pose.history_frames=39",
            ["data.humanml3d.min_frames", "41"],
        ),
        ("pose.history_frames=0", ["pose.history_frames", "1"]),
        ("pose.cond_drop_prob=2", ["pose.cond_drop_prob", "0 to 1"]),
        ("pose.history_noise_std=-1", ["pose.history_noise_std", "0"]),
        ("pose.target=nowhere", ["pose.target", "displacement"]),
        (
            "sampling.sampler.kind=ddim",
            ["sampling.sampler.kind", "euler"],
        ),
        ("sampling.clip=six", ["sampling.clip", "none"]),
        (
            "steering.padding=sampled",
            ["steering.padding", "gmd_motion"],
        ),
        ("steering.scale=3", ["steering", "gmd_motion"]),
        (
            "sampling.sampler.recompute_epsilon=false",
            ["sampling.sampler.recompute_epsilon", "ddim"],
        ),
        ("data.crop=leading", ["data.crop", "random"]),
        ("evaluation.frames=3", ["evaluation.frames", "16"]),
        ("diffusion.loss_type=l1", ["diffusion", ""]),
    ] {
        let train = format!("train c.toml --set {settings}");
        sandbox.run(&train).failed(2, &texts);
    }
    assert!(!sandbox.path("runs").exists());
    // A flow solver is no sampler of a diffusion process.
    sandbox.write(
        "d.toml",
        "[data]\nkind = \"synthetic\"\n[sampling.sampler]\nkind = \"euler\"\n",
    );
    sandbox
        .run("train d.toml")
        .failed(2, &["sampling.sampler.kind", "ddim"]);
}
