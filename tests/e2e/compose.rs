//! Motion composed of several prompts: training, sampling, evaluation.

use std::fs;

use kinegrad_data::read_array;
use kinegrad_tests::sandbox::Sandbox;
use serde_json::Value;

/// Walks with a few captions; the model learns an embedding of each. Clips, training length and
/// padding differ.
pub const COMPOSE: &str = r#"
[run]
name = "bpe"
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
kind = "bpe_transformer"
latent_dim = 24
num_layers = 2
num_heads = 1
ff_size = 40
horizon = 12
[optim]
learning_rate = 3e-3
warmup_steps = 5
[train]
recipe = "bpe_motion"
max_steps = 40
[ema]
decay = 0.9
[checkpoint]
every_steps = 10
[validation]
every_steps = 20
[sampling]
count_at_end = 0
[sampling.sampler]
num_inference_steps = 6
[evaluation]
compositions = 2
texts = 3
transition_frames = 20
"#;

/// Writes the config and its walks.
pub fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("data synth --walks --phrases 40 --frames 48 --out walks")
        .succeeded();
    sandbox.write("c.toml", COMPOSE);
    sandbox
}

fn trained() -> Sandbox {
    let sandbox = sandbox();
    sandbox.run("train c.toml").succeeded();
    sandbox
}

fn captions(sandbox: &Sandbox) -> Vec<String> {
    let config = fs::read_to_string(sandbox.path("runs/bpe/config.toml")).expect("a config");
    let config: toml::Table = config.parse().expect("TOML");
    let known = config["text"]["captions"].as_array().expect("captions");
    let text = |caption: &toml::Value| caption.as_str().expect("text").to_owned();
    known.iter().map(text).collect()
}

fn plan(steps: &[(f64, &str)]) -> String {
    let step = |(seconds, text): &(f64, &str)| {
        format!("[[step]]\nseconds = {seconds}\ntext = \"{text}\"\n")
    };
    steps.iter().map(step).collect()
}

#[test]
fn a_plan_is_drawn_as_one_motion_and_its_texts_matter() {
    let sandbox = trained();
    let known = captions(&sandbox);
    let draw = |name: &str, steps: &[(f64, &str)]| {
        sandbox.write(&format!("{name}.toml"), plan(steps));
        let line = format!("sample runs/bpe --prompts {name}.toml --seed 5 --out {name}");
        sandbox.run(&line).succeeded();
        let array = read_array(&sandbox.path(format!("{name}.features.npy"))).expect("features");
        assert_eq!(array.shape[1], 263);
        array
    };
    let (a, b) = (known[0].as_str(), known[3].as_str());
    let first = draw("first", &[(2.0, a), (1.5, b), (1.0, a)]);
    assert_eq!(first.shape[0], 90);
    let joints = read_array(&sandbox.path("first.npy")).expect("joints");
    assert_eq!(joints.shape, [90, 22, 3]);
    let again = draw("again", &[(2.0, a), (1.5, b), (1.0, a)]);
    assert_eq!(first, again, "the same to the bit");
    // Another last text changes the last frames most; far before them, only relative steps have an
    // effect.
    let other = draw("other", &[(2.0, a), (1.5, b), (1.0, b)]);
    let change = |from: usize, to: usize| {
        let pairs = first.values.iter().zip(&other.values).enumerate();
        let within = pairs.filter(|(place, _)| (from..to).contains(&(place / 263)));
        within.fold(0.0f32, |most, (_, (a, b))| most.max((a - b).abs()))
    };
    assert!(change(70, 90) > 1e-3, "{}", change(70, 90));
    assert!(
        change(0, 20) < 0.2 * change(70, 90),
        "{} {}",
        change(0, 20),
        change(70, 90)
    );
    // All positions absolute: segments are independent.
    let line = "sample runs/bpe --seed 5 --set evaluation.bpe_denoising_step=-1 --prompts";
    for name in ["first", "other"] {
        let line = format!("{line} {name}.toml --out apart-{name}");
        sandbox.run(&line).succeeded();
    }
    let read = |name: &str| {
        let path = sandbox.path(format!("apart-{name}.features.npy"));
        read_array(&path).expect("features").values
    };
    let (first, other) = (read("first"), read("other"));
    assert_eq!(first[..70 * 263], other[..70 * 263]);
    assert_ne!(first[70 * 263..], other[70 * 263..]);
    let record = fs::read_to_string(sandbox.path("apart-first.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    let said = record["composition"]["said"].as_array().expect("texts");
    assert_eq!(said.len(), 3);
    assert_eq!(said[1]["from"], 40);
    assert_eq!(record["composition"]["bpe_denoising_step"], -1);
}

#[test]
fn compositions_are_evaluated_beside_real_clips() {
    let sandbox = trained();
    let line = "eval runs/bpe --json";
    let output = sandbox.run(line).succeeded();
    let found: Value = serde_json::from_str(&output.stdout).expect("JSON");
    let text = found.to_string();
    for name in [
        "peak_jerk",
        "area_under_jerk",
        "foot_skating",
        "frechet_distance",
    ] {
        assert!(text.contains(name), "{name}: {text}");
    }
    for (line, expected) in [
        (
            "sample runs/bpe --goal g.toml --out x",
            "`--goal` with a run of recipe `bpe_motion`",
        ),
        (
            "sample runs/bpe --history h.npy --out x",
            "`--history` with a run of recipe `bpe_motion`",
        ),
        (
            "sample runs/bpe --text nothing --out x",
            "`nothing` is not a caption of the run",
        ),
        ("eval runs/bpe --audio-ablation", "`--audio-ablation` with"),
        (
            "sample runs/bpe --set evaluation.bpe_denoising_step=1001 --out x",
            "`evaluation.bpe_denoising_step` is 1001",
        ),
    ] {
        sandbox.run(line).failed(2, &[expected]);
    }
    sandbox.write("long.toml", plan(&[(1.0, "nothing"), (1.0, "nothing")]));
    let line = "sample runs/bpe --prompts long.toml --out x";
    sandbox
        .run(line)
        .failed(2, &["long.toml: step[0]: `nothing` is not a caption"]);
    assert!(!sandbox.path("x.npy").exists());
}

#[test]
fn a_trained_network_is_taught_to_follow_paths() {
    let sandbox = trained();
    for (name, points) in [
        ("left", "[[0.0, 0.0], [1.0, 1.0], [3.0, 1.0]]"),
        ("right", "[[0.0, 0.0], [-1.0, 1.0], [-3.0, 1.0]]"),
    ] {
        sandbox.write(&format!("{name}.toml"), format!("points = {points}\n"));
    }
    let features = |line: String, name: &str| {
        let line = format!("sample {line} --frames 50 --seed 5 --out {name} --allow-unusable");
        sandbox.run(&line).succeeded();
        let path = sandbox.path(format!("{name}.features.npy"));
        read_array(&path).expect("features").values
    };
    // With a learning rate of zero, the path layers stay at zero.
    let adapt = "train c.toml --set train.recipe=path_adapter --set init.diffusion=runs/bpe";
    let line = format!("{adapt} --set run.name=told --set optim.learning_rate=1e-30");
    sandbox.run(&line).succeeded();
    let free = features("runs/bpe".into(), "free");
    assert_eq!(features("runs/told".into(), "untold"), free, "to the bit");
    let told = |run: &str, path: &str| {
        let line = format!("{run} --path {path}.toml --method tokens");
        features(line, &format!("{}-{path}", run.replace('/', "-")))
    };
    assert_eq!(told("runs/told", "left"), told("runs/told", "right"));
    // After training, two paths differ; without a path the samples are those of the base.
    let line = format!("{adapt} --set run.name=taught --set optim.learning_rate=1e-2");
    sandbox.run(&line).succeeded();
    // Stopped halfway and resumed, the bytes are the same.
    let line = line.replace("=taught", "=halves");
    let half = format!("{line} --set train.max_steps=20 --set optim.lr_schedule=constant");
    let whole = half.replace("=halves", "=whole").replace("=20", "=40");
    sandbox.run(&half).succeeded();
    sandbox.run(&whole).succeeded();
    let on = "train runs/halves/config.toml --resume --set train.max_steps=40";
    sandbox.run(on).succeeded();
    let weights = |run: &str| {
        let path = format!("runs/{run}/checkpoints/step-00000040/model.safetensors");
        fs::read(sandbox.path(path)).expect("weights")
    };
    assert_eq!(weights("halves"), weights("whole"));
    let (left, right) = (told("runs/taught", "left"), told("runs/taught", "right"));
    let apart = left.iter().zip(&right).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) > 1e-3);
    assert_eq!(features("runs/taught".into(), "taught"), free);
    let line = "runs/taught --path left.toml --method tokens_guidance".to_owned();
    assert_ne!(features(line, "guided"), left);
    for (line, expected) in [
        (
            "sample runs/bpe --path left.toml --method tokens --out x".to_owned(),
            "a run whose network has no path condition",
        ),
        (
            format!("{adapt} --set run.name=x --set adapter.last_layers=3"),
            "`adapter.last_layers` is 3, allowed: 0 to 2",
        ),
        (
            "train c.toml --set run.name=x --set adapter.last_layers=1".to_owned(),
            "`adapter.last_layers` is 1, allowed: 0 for recipe `bpe_motion`",
        ),
        (
            format!("{adapt} --set run.name=x --set model.path=false"),
            "`model.path` is false, allowed: true for recipe `path_adapter`",
        ),
    ] {
        sandbox.run(&line).failed(2, &[expected]);
    }
}
