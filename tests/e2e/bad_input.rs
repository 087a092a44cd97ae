//! Wrong configs and datasets: a clear error, exit code 2, and nothing written.

use std::fs;

use kinegrad_data::{AudioFeatures, AudioLayout, write_features, write_motion};
use kinegrad_motion::Phrase;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox, finish};

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
}

/// Asserts that training with `settings` is refused and leaves no run folder.
#[track_caller]
fn refused(sandbox: &Sandbox, settings: &str, texts: &[&str]) {
    sandbox
        .run(&format!("train c.toml {settings}"))
        .failed(2, texts);
    assert!(
        !sandbox.path("runs").exists(),
        "a refused run wrote something"
    );
}

#[test]
fn unknown_key_names_line_and_the_nearest_valid_one() {
    let sandbox = sandbox();
    sandbox.write("c.toml", "[optim]\n# a comment\nlearning_rat = 1e-3\n");
    refused(
        &sandbox,
        "",
        &[
            "c.toml:3",
            "unknown key `optim.learning_rat`",
            "did you mean `optim.learning_rate`?",
        ],
    );
}

#[test]
fn wrong_types_and_choices_name_the_key() {
    let sandbox = sandbox();
    let cases: [(&str, &[&str]); 4] = [
        (
            "--set train.max_steps=many",
            &[
                "--set train.max_steps=many",
                "`train.max_steps`",
                "a whole number",
            ],
        ),
        ("--set train.max_steps=-1", &["`train.max_steps`"]),
        (
            "--set diffusion.prediction_type=noise",
            &["`diffusion.prediction_type`", "epsilon"],
        ),
        ("--set run", &["`--set run` is not KEY=VALUE"]),
    ];
    for (settings, texts) in cases {
        refused(&sandbox, settings, texts);
    }
}

#[test]
fn values_out_of_range_name_key_value_and_range() {
    let sandbox = sandbox();
    let cases: [(&str, &[&str]); 13] = [
        (
            "train.max_steps=0",
            &["`train.max_steps` is 0", "1 or more"],
        ),
        ("optim.warmup_steps=-1", &["`optim.warmup_steps`"]),
        (
            "optim.learning_rate=inf",
            &["`optim.learning_rate`", "inf is not a finite number"],
        ),
        (
            "optim.betas=[0.9,nan]",
            &["`optim.betas[1]`", "NaN is not a finite number"],
        ),
        // A key without effect in this recipe.
        ("loss.w_diff=nan", &["`loss.w_diff`", "finite"]),
        (
            "optim.learning_rate=-1.0",
            &["`optim.learning_rate` is -1", "0 or more"],
        ),
        (
            "optim.betas=[0.9,1.0]",
            &["`optim.betas` is 1", "0 to below 1"],
        ),
        (
            "model.model_channels=48",
            &[
                "`model.model_channels` is 48",
                "32 groups",
                "multiple of 32",
            ],
        ),
        ("model.num_heads=7", &["`model.num_heads` is 7"]),
        ("data.batch_size=0", &["data.batch_size", "0"]),
        (
            "sampling.sampler.num_inference_steps=2000",
            &["num_inference_steps", "2000", "1000"],
        ),
        (
            "sampling.sampler.kind=heun --set sampling.sampler.timestep_spacing=trailing \
             --set diffusion.rescale_betas_zero_snr=true --set diffusion.prediction_type=sample",
            &[
                "`sampling.sampler.kind` is \"heun\"",
                "rescale_betas_zero_snr",
            ],
        ),
        (
            "diffusion.num_train_timesteps=1",
            &["num_train_timesteps", "1"],
        ),
    ];
    for (setting, texts) in cases {
        refused(&sandbox, &format!("--set {setting}"), texts);
    }
}

#[test]
fn lists_in_the_place_of_tables_are_named() {
    let sandbox = sandbox();
    for (settings, key) in [
        ("optim=[0.5]", "`optim`"),
        ("optim=[]", "`optim`"),
        ("data.synthetic=[64]", "`data.synthetic`"),
        ("sampling.sampler=[\"ddim\"]", "`sampling.sampler`"),
        ("init=[\"runs/x\"]", "`init`"),
        ("diffusion=[1000]", "`diffusion`"),
    ] {
        let texts = [key, "a list of", "allowed: a table"];
        refused(&sandbox, &format!("--set {settings}"), &texts);
    }
    sandbox.write(
        "c.toml",
        format!("optim = [0.5]\n{SMALLEST}").replace("[optim]", "[ema]"),
    );
    refused(&sandbox, "", &["c.toml"]);
    sandbox.write(
        "c.toml",
        "ema.decay = 0.5\noptim = [0.5]\n[run]\nname = \"x\"\n",
    );
    refused(&sandbox, "", &["c.toml:2: `optim`: a list of 1 values"]);
}

#[test]
fn a_warm_up_longer_than_the_run_only_warns() {
    let sandbox = sandbox();
    let settings = "--set train.max_steps=2 --set optim.warmup_steps=50";
    let finished = sandbox.run(&format!("train c.toml {settings}")).succeeded();
    assert!(
        finished
            .stderr
            .contains("warning: `optim.warmup_steps` (50)"),
        "{}",
        finished.stderr
    );
}

#[test]
fn missing_config_and_device_are_named() {
    let sandbox = sandbox();
    sandbox
        .run("train nowhere.toml")
        .failed(2, &["nowhere.toml", "hint:"]);
    refused(
        &sandbox,
        "--device warp",
        &["`run.device` is \"warp\"", "cpu"],
    );
    refused(&sandbox, "--device cuda:x", &["cuda:x"]);
}

#[test]
fn unknown_kernels_in_the_environment_are_named() {
    let sandbox = sandbox();
    let mut train = sandbox.command(["train", "c.toml"]);
    train.env("KINEGRAD_KERNELS", "fast");
    finish(train).failed(2, &["KINEGRAD_KERNELS", "fast", "fused", "composed"]);
    assert!(
        !sandbox.path("runs").exists(),
        "a refused run wrote something"
    );
}

/// Writes a valid phrase of `frames`, then lets `spoil` change its files.
fn phrase(sandbox: &Sandbox, id: &str, frames: usize) {
    let mut frame = [0.0f32; 25];
    frame[9] = 1.0;
    let motion = Phrase::new(frame.repeat(frames)).expect("a motion");
    for kind in ["motion", "audio_features"] {
        fs::create_dir_all(sandbox.path(format!("set/{kind}/{id}"))).expect("folders");
    }
    write_motion(
        &sandbox.path(format!("set/motion/{id}/trajectory.npy")),
        &motion,
    )
    .expect("npy");
    let features = sandbox.path(format!("set/audio_features/{id}/features.npz"));
    write_features(
        &features,
        &AudioFeatures::silence(AudioLayout::CCMOTION, frames),
    )
    .expect("npz");
}

const PHRASES: &str = "--set data.kind=phrases --set data.source=set";

#[test]
fn missing_and_empty_datasets_are_named() {
    let sandbox = sandbox();
    refused(&sandbox, "--set data.kind=phrases", &["data.source"]);
    refused(&sandbox, PHRASES, &["set", "hint:"]);
    fs::create_dir_all(sandbox.path("set/motion")).expect("folders");
    fs::create_dir_all(sandbox.path("set/audio_features")).expect("folders");
    refused(&sandbox, PHRASES, &["no phrase"]);
}

/// Changes one number of every frame of a phrase's motion, and one of its audio features.
fn enlarge(sandbox: &Sandbox, id: &str, position: f32, mel: f32) {
    let path = sandbox.path(format!("set/motion/{id}/trajectory.npy"));
    let mut motion = kinegrad_data::read_motion(&path).expect("a motion");
    (0..motion.frames()).for_each(|frame| motion.frame_mut(frame)[0] = position);
    write_motion(&path, &motion).expect("npy");
    let path = sandbox.path(format!("set/audio_features/{id}/features.npz"));
    let audio = std::fs::read(&path).expect("features");
    let audio = kinegrad_data::parse_features(&audio, "features.npz", AudioLayout::CCMOTION)
        .expect("features");
    let mut values = audio.as_slice().to_vec();
    values[..audio.frames()].fill(mel);
    let audio = AudioFeatures::new(audio.frames(), values).expect("as many");
    write_features(&path, &audio).expect("npz");
}

#[test]
fn numbers_too_large_to_train_on_are_named_and_smaller_ones_train() {
    let sandbox = sandbox();
    let train = format!("{PHRASES} --set train.max_steps=3");
    let largest = kinegrad_data::LARGEST;
    for index in 0..6 {
        phrase(&sandbox, &format!("p{index}"), 30);
    }
    enlarge(&sandbox, "p3", 1e30, 0.0);
    let texts = [
        "`p3`",
        "trajectory.npy",
        "channel position.x",
        "from -1e6 to 1e6",
    ];
    refused(&sandbox, &train, &texts);
    enlarge(&sandbox, "p3", 0.0, 1e19);
    let texts = ["`p3`", "features.npz", "channel mel[0]", "from -1e6 to 1e6"];
    refused(&sandbox, &train, &texts);

    for index in 0..6 {
        enlarge(&sandbox, &format!("p{index}"), largest, largest);
    }
    sandbox
        .run(&format!("train c.toml {train} --name constant"))
        .succeeded();
    for index in 0..3 {
        enlarge(&sandbox, &format!("p{index}"), -largest, -largest);
    }
    let through_sampler = "--set train.recipe=e2e --set init.pretrain.diffusion_steps=2 \
        --set init.pretrain.decoder_steps=2 --set decoder.hidden_dim=32 --set rollout.steps=2";
    for settings in ["--name one", through_sampler] {
        sandbox
            .run(&format!("train c.toml {train} {settings}"))
            .succeeded();
    }
}

#[test]
fn bad_phrases_are_named_by_id_and_channel_or_skipped_and_counted() {
    let sandbox = sandbox();
    for index in 0..6 {
        phrase(&sandbox, &format!("good_{index}"), 30);
    }
    let train = format!("{PHRASES} --set train.max_steps=2 --set data.validation.fraction=0.0");

    // NaN in one channel of one frame.
    phrase(&sandbox, "nan", 30);
    let mut frame = [0.0f32; 25];
    frame[9] = 1.0;
    let mut values = frame.repeat(30);
    values[7 * 25 + 4] = f32::NAN;
    let motion = Phrase::new(values).expect("a motion");
    write_motion(&sandbox.path("set/motion/nan/trajectory.npy"), &motion).expect("npy");
    refused(&sandbox, &train, &["`nan`", "velocity.y", "7"]);
    fs::remove_dir_all(sandbox.path("set/motion/nan")).expect("removed");
    fs::remove_dir_all(sandbox.path("set/audio_features/nan")).expect("removed");

    // Another shape, another dtype, a truncated archive.
    let write = |id: &str, dtype: &str, shape: &[u64]| {
        phrase(&sandbox, id, 30);
        let header = format!(
            "{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({},), }}",
            shape
                .iter()
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        );
        let header = format!("{header:<117}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        let size = dtype[2..].parse::<u64>().expect("a size");
        bytes.resize(
            bytes.len() + (size * shape.iter().product::<u64>()) as usize,
            0,
        );
        fs::write(
            sandbox.path(format!("set/motion/{id}/trajectory.npy")),
            bytes,
        )
        .expect("npy");
    };
    let remove = |id: &str| {
        for kind in ["motion", "audio_features"] {
            fs::remove_dir_all(sandbox.path(format!("set/{kind}/{id}"))).expect("removed");
        }
    };
    write("wide", "<f4", &[30, 26]);
    refused(&sandbox, &train, &["`wide`", "[30, 26]", "25"]);
    remove("wide");
    write("whole", "<i4", &[30, 25]);
    refused(&sandbox, &train, &["`whole`", "<i4", "float32"]);
    remove("whole");
    phrase(&sandbox, "torn", 30);
    let archive = sandbox.path("set/audio_features/torn/features.npz");
    let bytes = fs::read(&archive).expect("bytes");
    fs::write(&archive, &bytes[..bytes.len() / 2]).expect("torn");
    refused(&sandbox, &train, &["`torn`", "features.npz"]);

    // The same phrase, skipped.
    let skip = format!("train c.toml {train} --set data.on_bad_phrase=skip");
    let finished = sandbox.run(&skip).succeeded();
    assert!(
        finished.stderr.contains("1 bad item skipped"),
        "{}",
        finished.stderr
    );
    assert!(finished.stderr.contains("torn:"), "{}", finished.stderr);
}
