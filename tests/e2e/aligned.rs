//! Aligned audio conditioning (`model.audio_conditioning = "aligned"`) compared with conditioning
//! without time.

use std::fs;
use std::path::Path;

use kinegrad_data::{AudioFeatures, AudioLayout, load_audio, read_motion, write_features};
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};

/// Clips of 10 to 24 frames give batches of different lengths.
const SETTINGS: &str = "--set train.max_steps=12 --set data.augment.min_frames=10";

/// Frames of a sample: no more than in training, because longer ones are sampled in windows, which
/// separate early from late music.
const FRAMES: usize = 23;

/// A sandbox with a run of each conditioning and the features of a phrase, 37 frames long.
fn trained() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    for name in ["ccmotion", "aligned"] {
        sandbox
            .run(&format!(
                "train c.toml --name {name} --set model.audio_conditioning={name} {SETTINGS}"
            ))
            .succeeded();
    }
    sandbox
        .run("data synth --out set --phrases 2 --frames 37")
        .succeeded();
    sandbox
}

/// The features reordered by `order`, as a file.
fn write_ordered(sandbox: &Sandbox, name: &str, order: impl Iterator<Item = usize>) {
    let path = sandbox.path("set/audio_features/synthetic_00001/features.npz");
    let features = load_audio(&path, AudioLayout::CCMOTION)
        .expect("features")
        .slice(0..FRAMES);
    let frames = features.frames();
    let order: Vec<usize> = order.collect();
    assert_eq!(order.len(), frames);
    let values = features.as_slice().chunks(frames);
    let values = values.flat_map(|channel| order.iter().map(|&t| channel[t]));
    let ordered = AudioFeatures::new(frames, values.collect()).expect("as many features");
    write_features(&sandbox.path(name), &ordered).expect("a file");
}

fn apart(one: &Path, other: &Path) -> f32 {
    let [one, other] = [one, other].map(|path| read_motion(path).expect("a motion"));
    assert_eq!((one.frames(), other.frames()), (FRAMES, FRAMES));
    let pairs = one.as_slice().iter().zip(other.as_slice());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn the_order_of_the_music_matters_to_samples_of_aligned_runs_alone() {
    let sandbox = trained();
    write_ordered(&sandbox, "own.npz", 0..FRAMES);
    write_ordered(&sandbox, "reversed.npz", (0..FRAMES).rev());
    write_ordered(
        &sandbox,
        "rolled.npz",
        (0..FRAMES).map(|t| (t + 5) % FRAMES),
    );
    for (run, hears) in [("ccmotion", false), ("aligned", true)] {
        for cond in ["own", "reversed", "rolled"] {
            sandbox
                .run(&format!(
                    "sample runs/{run} --audio-features {cond}.npz --steps 3 --seed 5 --out {run}-{cond} -q"
                ))
                .succeeded();
        }
        let own = sandbox.path(format!("{run}-own.raw.npy"));
        for cond in ["reversed", "rolled"] {
            let changed = apart(&own, &sandbox.path(format!("{run}-{cond}.raw.npy")));
            match hears {
                true => assert!(changed > 1e-2, "{run} {cond}: {changed}"),
                false => assert!(changed < 1e-3, "{run} {cond}: {changed}"),
            }
        }
    }
}

#[test]
fn a_fine_tuning_hears_as_its_base_does() {
    let sandbox = trained();
    let tuning = "train c.toml --name tuned --set train.recipe=e2e --set init.diffusion=runs/aligned \
                  --set init.pretrain.decoder_steps=4 --set decoder.hidden_dim=32 \
                  --set rollout.steps=2 --set train.max_steps=4";
    sandbox
        .run(&format!("{tuning} --set model.audio_conditioning=ccmotion"))
        .failed(2, &["model.audio_conditioning"]);
    sandbox
        .run(&format!("{tuning} --set model.audio_conditioning=aligned"))
        .succeeded();
    sandbox
        .run("sample runs/tuned --steps 2 --frames 31 --out tuned")
        .succeeded();
    let motion = read_motion(&sandbox.path("tuned.npy")).expect("a motion");
    assert_eq!(motion.frames(), 31);
    // An older config lacks the key and keeps its meaning.
    let saved = fs::read_to_string(sandbox.path("runs/ccmotion/config.toml")).expect("a config");
    let older: Vec<&str> = saved
        .lines()
        .filter(|line| !line.starts_with("audio_conditioning"))
        .collect();
    assert!(older.len() < saved.lines().count());
    sandbox.write("runs/ccmotion/config.toml", older.join("\n"));
    sandbox
        .run("train --resume runs/ccmotion --set train.max_steps=14")
        .succeeded();
}
