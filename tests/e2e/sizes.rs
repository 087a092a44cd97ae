//! Work beyond the available memory, and endless files: refused with exit code 2.

use std::fs;
use std::process::Command;

use kinegrad_tests::captures::wav;
use kinegrad_tests::sandbox::{Finished, SMALLEST, SMALLEST_WALKS, Sandbox, finish, wait_for};

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("walks.toml", SMALLEST_WALKS);
    sandbox
}

/// The error for work that does not fit.
const ESTIMATE: [&str; 3] = ["needs about", "GiB of memory are free", "hint:"];

#[test]
fn training_that_does_not_fit_is_refused_with_an_estimate() {
    let sandbox = sandbox();
    for settings in [
        "--set model.model_channels=65536",
        "--set model.num_res_blocks=1024 --set model.model_channels=4096",
        "--set data.target_frames=216000 --set data.batch_size=65536",
        "--set data.synthetic.phrases=1000000 --set data.synthetic.frames=216000",
        "--set train.recipe=e2e --set decoder.hidden_dim=65536",
        "--set train.recipe=e2e --set lora.rank=65536 --set model.model_channels=4096",
        "--set train.recipe=e2e --set decoder.num_layers=1024 --set decoder.hidden_dim=8192",
    ] {
        sandbox
            .run(&format!("train c.toml {settings}"))
            .failed(2, &ESTIMATE);
        // As a comment of the config.
        let shown = sandbox.run(&format!("config show c.toml {settings}"));
        let estimate = shown.succeeded().stdout;
        assert!(estimate.contains("# memory: about "), "{estimate}");
    }
    let settings = "--set model.latent_dim=65536 --set model.dim_mults=[1.0,1.0]";
    sandbox
        .run(&format!("train walks.toml {settings}"))
        .failed(2, &ESTIMATE);
    assert!(!sandbox.path("runs").exists());
}

#[test]
fn sizes_beyond_all_machines_are_refused_by_key() {
    let sandbox = sandbox();
    for (config, setting, key) in [
        (
            "c",
            "model.num_res_blocks=1000000000000000000",
            "model.num_res_blocks",
        ),
        (
            "c",
            "model.channel_mult=[1,9223372036854775807]",
            "model.channel_mult",
        ),
        (
            "c",
            "model.model_channels=9223372036854775776",
            "model.model_channels",
        ),
        (
            "c",
            "model.time_embed_dim=9223372036854775806",
            "model.time_embed_dim",
        ),
        (
            "c",
            "model.context_dim=9223372036854775807",
            "model.context_dim",
        ),
        (
            "walks",
            "model.latent_dim=9223372036854775806",
            "model.latent_dim",
        ),
        (
            "walks",
            "model.padded_frames=9223372036854775806",
            "model.padded_frames",
        ),
        ("walks", "model.dim_mults=[1e18]", "model.dim_mults"),
        (
            "walks",
            "evaluation.obstacles=9223372036854775807",
            "evaluation.obstacles",
        ),
        (
            "walks",
            "evaluation.keyframes=9223372036854775807",
            "evaluation.keyframes",
        ),
    ] {
        sandbox
            .run(&format!("config show {config}.toml --set {setting}"))
            .failed(2, &[key, "allowed"]);
    }
    for setting in [
        "decoder.num_layers=1000000000000000000",
        "decoder.hidden_dim=9223372036854775807",
        "lora.rank=9223372036854775807",
    ] {
        let key = setting.split('=').next().expect("a key");
        sandbox
            .run(&format!(
                "config show c.toml --set train.recipe=e2e --set {setting}"
            ))
            .failed(2, &[key, "allowed"]);
    }
}

#[test]
fn samples_that_do_not_fit_are_refused_with_an_estimate() {
    let sandbox = sandbox();
    for config in ["c", "walks"] {
        sandbox
            .run(&format!(
                "train {config}.toml --name {config} --set train.max_steps=1"
            ))
            .succeeded();
    }
    for command in [
        "sample runs/walks --count 1000000000 --out d",
        "eval runs/c --set evaluation.seeds=100000000",
    ] {
        sandbox.run(command).failed(2, &ESTIMATE);
    }
    for count in ["0", "18446744073709551615"] {
        sandbox
            .run(&format!("sample runs/walks --count {count} --out d"))
            .failed(2, &["`--count` is", "1 to 1000000000"]);
    }
    for frames in ["0", "9223372036854775807"] {
        sandbox
            .run(&format!("sample runs/walks --frames {frames} --out d"))
            .failed(2, &["`--frames` is", "1 to 216000"]);
    }
    sandbox.write(
        "goal.toml",
        "frames = 1000000000\n[[keyframe]]\nframe = 1\nx = 0\nz = 0\n",
    );
    sandbox
        .run("sample runs/walks --goal goal.toml --out d")
        .failed(2, &["frames", "216000"]);
}

#[test]
fn any_number_of_phrases_is_drawn_a_batch_at_a_time() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --name c --set train.max_steps=1")
        .succeeded();
    let mut drawing = sandbox.start("sample runs/c --steps 1 --count 1000000000 --out d");
    let second_batch = sandbox.path("d-040.npy");
    wait_for(&mut drawing, "the second batch", || second_batch.exists());
    drawing.kill().expect("a kill");
    drawing.wait().expect("an end");
}

#[test]
fn pipes_devices_and_endless_files_are_not_read() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --name r --set train.max_steps=1")
        .succeeded();
    sandbox
        .run("train walks.toml --name w --set train.max_steps=1")
        .succeeded();
    let pipe = sandbox.path("pipe");
    let made = Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
    assert!(made.success());
    // A sparse file of 5 GiB.
    let sparse = fs::File::create(sandbox.path("sparse")).expect("a file");
    sparse.set_len(5 << 30).expect("room");
    for file in ["pipe", "/dev/zero", "sparse"] {
        for ending in ["pt", "npz", "npy", "flac", "toml"] {
            let _ = fs::remove_file(sandbox.path(format!("in.{ending}")));
            let target = match file {
                "/dev/zero" => file.into(),
                _ => sandbox.path(file),
            };
            std::os::unix::fs::symlink(target, sandbox.path(format!("in.{ending}")))
                .expect("a link");
        }
        for command in [
            "config show in.toml",
            "train in.toml",
            "data prepare in.toml --out set",
            "sample runs/w --goal in.toml --out d",
            "sample runs/w --text-embedding in.pt#key --out d",
            "sample runs/r --audio-features in.npz --out d",
            "check in.npy",
            "plot in.npy --out p.svg",
            "train c.toml --name x --set data.validation.ids_file=in.toml",
            "import in.pt --arch gmd_motion --mean in.npy --std in.npy --out i",
            "audio features in.flac --out f",
        ] {
            let finished = sandbox.run(command);
            assert!(
                matches!(finished.code, Some(1 | 2)) && !finished.stderr.contains("panicked"),
                "{command} of {file}: {finished:?}"
            );
        }
    }
}

/// Runs the binary with a limit on its address space, in MiB.
fn run_with(sandbox: &Sandbox, mebibytes: u64, arguments: &str) -> Finished {
    let (limit, binary) = (mebibytes << 10, env!("CARGO_BIN_EXE_kinegrad"));
    let mut command = Command::new("bash");
    command
        .args([
            "-c",
            &format!("ulimit -v {limit}; exec {binary} {arguments}"),
        ])
        .env("RAYON_NUM_THREADS", "1")
        .current_dir(sandbox.path(""));
    finish(command)
}

#[test]
fn an_evaluation_is_measured_by_the_samples_of_a_phrase() {
    let sandbox = sandbox();
    let settings = "--set train.max_steps=1 --set validation.every_steps=0 \
                    --set data.synthetic.phrases=4 --set data.synthetic.frames=3000";
    for (name, target) in [
        ("windows", "rotation_6d"),
        ("whole", "canonical_quaternion"),
    ] {
        sandbox
            .run(&format!(
                "train c.toml --name {name} --set model.orientation_target={target} {settings}"
            ))
            .succeeded();
    }
    let eval = |name: &str| {
        let eval = "--steps 1 --set evaluation.phrases=1 --set evaluation.seeds=32";
        run_with(&sandbox, 450, &format!("eval runs/{name} {eval}"))
    };
    eval("whole").failed(
        2,
        &["sampling 32 phrases of 3000 frames", "`evaluation.seeds`"],
    );
    // In windows it fits.
    eval("windows").succeeded();
}

#[test]
fn a_song_that_does_not_fit_is_refused() {
    let sandbox = sandbox();
    // Silence, as a sparse file.
    let silence = |name: &str, seconds: u32| {
        let length = seconds * 44_100 * 2;
        let mut song = wav(0);
        song[4..8].copy_from_slice(&(36 + length).to_le_bytes());
        song[40..44].copy_from_slice(&length.to_le_bytes());
        sandbox.write(name, &song);
        let file = fs::File::options().write(true).open(sandbox.path(name));
        let whole = song.len() as u64 + u64::from(length);
        file.and_then(|file| file.set_len(whole)).expect("longer");
    };
    silence("hour.wav", 3600);
    silence("song.wav", 600);
    for (song, mebibytes, expected) in [
        ("hour", 600, "hour.wav: memory is full after second"),
        ("hour", 1100, "hour.wav: the analysis of 60 minutes"),
        ("song", 380, "song.wav: the features of 10 minutes need"),
    ] {
        let command = format!("audio features {song}.wav --out o");
        run_with(&sandbox, mebibytes, &command).failed(2, &[expected, "hint:"]);
    }
    assert!(!sandbox.path("o").exists());
}

#[test]
fn a_file_of_embeddings_that_is_too_long_is_not_read() {
    let sandbox = sandbox();
    sandbox
        .run("data synth --walks --out set --phrases 2 --frames 40")
        .succeeded();
    let path = sandbox.path("set/text_embeddings.safetensors");
    let file = fs::File::options().write(true).open(path);
    file.and_then(|file| file.set_len(5 << 30)).expect("room");
    sandbox.run("data inspect set --humanml3d").failed(
        2,
        &["text_embeddings.safetensors", "5368709120", "2147483648"],
    );
}

#[test]
fn losses_beyond_all_axes_leave_gaps_in_a_plot() {
    let sandbox = sandbox();
    let line = |step: u64, loss: f64| format!("{{\"step\":{step},\"loss\":{loss:e}}}\n");
    let lines: String = (1..=9)
        .map(|step| line(step, if step % 3 == 0 { 1e308 } else { -1e308 }))
        .chain([line(10, 1.0), line(11, 2.0)])
        .collect();
    sandbox.write("runs/r/metrics.jsonl", lines);
    sandbox.run("plot runs/r --out p.svg").succeeded();
    assert!(sandbox.path("p.svg").exists());
}

#[test]
fn a_config_may_come_from_another_program() {
    let sandbox = sandbox();
    let kinegrad = env!("CARGO_BIN_EXE_kinegrad");
    let shown = Command::new("bash")
        .args(["-c", &format!("'{kinegrad}' config show <(cat c.toml)")])
        .current_dir(sandbox.path("."))
        .output()
        .expect("bash");
    let said = String::from_utf8_lossy(&shown.stderr);
    assert!(shown.status.success(), "{said}");
}
