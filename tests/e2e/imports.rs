//! Published weights as runs.

use std::fs;

use kinegrad_data::humanml::write_walks;
use kinegrad_data::write_values;
use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::{SMALLEST_WALKS, Sandbox, contents};
use serde_json::Value;

use super::goals::{GOAL, sandbox, shape};

/// A sandbox with the weights of `data_fixtures/gmd` and statistics for them.
fn published() -> Sandbox {
    let sandbox = sandbox();
    for name in [
        "checkpoint_tiny.pt",
        "checkpoint_bare.pt",
        "checkpoint_expanded.pt",
        "checkpoint_mdm.pt",
    ] {
        let bytes = fs::read(workspace().join("data_fixtures/gmd").join(name)).expect("a fixture");
        sandbox.write(name, bytes);
    }
    for name in ["m.npy", "s.npy"] {
        write_values(&sandbox.path(name), &[263], &[1.0; 263]).expect("a file");
    }
    sandbox
}

#[test]
fn published_weights_become_a_run() {
    let sandbox = published();
    let import = "import checkpoint_tiny.pt --arch gmd_trajectory --mean m.npy --std s.npy";
    let said = sandbox.run(&format!("{import} --out runs/gmd")).succeeded();
    assert!(said.stdout.contains("`model_avg`"), "{}", said.stdout);
    assert!(said.stdout.contains("12,636 parameters"), "{}", said.stdout);
    sandbox
        .run(&format!("{import} --out runs/gmd"))
        .failed(2, &["runs/gmd"]);
    sandbox
        .run(&format!(
            "{import} --out runs/other --set steering.guidance.norm=mse \
             --set steering.guidance.frame_limit=12 \
             --set steering.schedule.points_until=30 --set steering.padding=zeros"
        ))
        .succeeded();
    let steering_of = |run: &str| {
        let state = sandbox.path(format!("runs/{run}/checkpoints/step-00000000/state.json"));
        let state = fs::read_to_string(state).expect("a checkpoint");
        let state: Value = serde_json::from_str(&state).expect("JSON");
        state["config"]["steering"].clone()
    };
    // As in the published program, unless set otherwise.
    assert_eq!(steering_of("gmd")["padding"], "sampled");
    let steering = steering_of("other");
    assert_eq!(steering["padding"], "zeros");
    assert_eq!(steering["guidance"]["norm"], "mse");
    assert_eq!(steering["guidance"]["frame_limit"], 12);
    assert_eq!(steering["schedule"]["points_until"], 30);
    sandbox
        .run(&format!("{import} --out runs/third --set steering.scal=1"))
        .failed(2, &["steering.scale"]);
    sandbox.write("goal.toml", GOAL);
    sandbox
        .run("sample runs/gmd --goal goal.toml --steps 3 --out path")
        .succeeded();
    assert_eq!(shape(&sandbox.path("path.npy")), [16, 2]);
    write_walks(&sandbox.path("walks"), 8, 48, 3).expect("walks");
    sandbox
        .run("eval runs/gmd --source walks --set evaluation.goals=1 --steps 3")
        .succeeded();
    let tune = "train c.toml --name tuned --set train.recipe=gmd_trajectory \
                --set init.diffusion=runs/gmd --set train.max_steps=2";
    let without_model = SMALLEST_WALKS
        .split("[model]")
        .next()
        .expect("what comes first");
    sandbox.write("c.toml", without_model);
    sandbox.run(tune).succeeded();
}

#[test]
fn published_weights_of_the_transformer_become_a_run() {
    let sandbox = published();
    let import = "import checkpoint_mdm.pt --arch mdm --mean m.npy --std s.npy --out runs/mdm";
    sandbox
        .run(&format!("{import} --projection m.npy"))
        .failed(2, &["`--projection` with `--arch mdm`"]);
    sandbox
        .run(&format!("{import} --padded-frames 64"))
        .failed(2, &["`--padded-frames` with `--arch mdm`"]);
    let said = sandbox.run(import).succeeded();
    // Three tensors of the text encoder, and the table twice.
    assert!(
        said.stdout.contains("5 tensors of other parts ignored"),
        "{}",
        said.stdout
    );
    assert!(!said.stderr.contains("--projection"), "{}", said.stderr);
    sandbox
        .run("sample runs/mdm --frames 24 --steps 3 --out walk --allow-unusable")
        .succeeded();
    assert_eq!(shape(&sandbox.path("walk.npy")), [24, 22, 3]);
    // The root is relative, so positions cannot be given.
    sandbox.write("goal.toml", GOAL);
    sandbox
        .run("sample runs/mdm --goal goal.toml --steps 3 --out way")
        .failed(2, &["data.humanml3d.root"]);
    sandbox
        .run("import checkpoint_tiny.pt --arch mdm --mean m.npy --std s.npy --out runs/other")
        .failed(2, &["input_process.poseEmbedding.weight"]);
}

#[test]
fn weights_that_do_not_fit_are_refused_with_all_differences() {
    let sandbox = published();
    let import = |weights: &str, arch: &str, rest: &str| {
        sandbox.run(&format!(
            "import {weights} --arch {arch} --out runs/gmd {rest}"
        ))
    };
    let statistics = "--mean m.npy --std s.npy";
    import("checkpoint_tiny.pt", "gmd_trajectory", "").failed(2, &["--mean"]);
    import("checkpoint_tiny.pt", "gmd_motion", statistics).failed(2, &["4 channels", "263"]);
    import("goal.toml", "gmd_trajectory", statistics).failed(2, &["goal.toml"]);
    for frames in ["9223372036854775808", "18446744073709551615", "0", "3"] {
        let padded = format!("{statistics} --padded-frames {frames}");
        import("checkpoint_tiny.pt", "gmd_trajectory", &padded)
            .failed(2, &["`model.padded_frames`", frames]);
    }
    // A tensor of 4 GiB that repeats one number.
    import("checkpoint_expanded.pt", "gmd_trajectory", statistics)
        .failed(2, &["its tensors need more than its"]);
    // A pickle that declares the remaining 20 GiB of the file as one value.
    let mut claim = vec![0x80, 4, 0x8e];
    claim.extend((20_u64 << 30).to_le_bytes());
    fs::write(sandbox.path("claim.pt"), &claim).expect("written");
    let file = fs::File::options()
        .write(true)
        .open(sandbox.path("claim.pt"));
    file.and_then(|file| file.set_len(21 << 30))
        .expect("longer");
    import("claim.pt", "gmd_trajectory", statistics).failed(2, &["at most 2147483648 are read"]);
    // The remaining files are compared below, and this one would be read into memory.
    fs::remove_file(sandbox.path("claim.pt")).expect("a file");
    // Deviations of absolute positions as small as those of steps.
    let mut relative = [1.0; 263];
    relative[1..3].fill(0.02);
    relative[193..259].fill(0.02);
    write_values(&sandbox.path("s.npy"), &[263], &relative).expect("a file");
    import("checkpoint_tiny.pt", "gmd_trajectory", statistics).failed(
        2,
        &[
            "s.npy",
            "relative root",
            "Mean_abs_3d.npy and Std_abs_3d.npy",
        ],
    );
    write_values(&sandbox.path("s.npy"), &[12], &[1.0; 12]).expect("a file");
    import("checkpoint_tiny.pt", "gmd_trajectory", statistics).failed(2, &["12", "263"]);
    write_values(&sandbox.path("s.npy"), &[263], &[1.0; 263]).expect("a file");

    // A changed name in the pickle is one missing and one unknown parameter.
    let path = sandbox.path("checkpoint_bare.pt");
    let bytes = fs::read(&path).expect("a fixture");
    fs::write(
        &path,
        renamed(bytes, b"embed_text.bias", b"embed_text.bios"),
    )
    .expect("a file");
    import("checkpoint_bare.pt", "gmd_trajectory", statistics).failed(
        2,
        &[
            "2 differences",
            "missing: `embed_text.bias` [8]",
            "not known: `embed_text.bios`",
        ],
    );
    let left = contents(&sandbox.path("."));
    assert!(
        left.iter().all(|(name, _)| !name.starts_with("runs")),
        "nothing written"
    );
}

/// An archive in whose first file containing `name` it is replaced by `other`, of the same length.
fn renamed(mut archive: Vec<u8>, name: &[u8], other: &[u8]) -> Vec<u8> {
    let place = |archive: &[u8], text: &[u8]| {
        archive
            .windows(text.len())
            .position(|window| window == text)
            .expect("the text is there")
    };
    // The pickle is the archive's first file: its local header has the offset.
    let number = |archive: &[u8], at: usize, bytes: usize| {
        (0..bytes).fold(0usize, |n, i| n | usize::from(archive[at + i]) << (8 * i))
    };
    let directory = place(&archive, b"PK\x01\x02");
    let (old_sum, length) = (
        archive[directory + 16..directory + 20].to_vec(),
        number(&archive, directory + 20, 4),
    );
    let start = 30 + number(&archive, 26, 2) + number(&archive, 28, 2);
    let at = start + place(&archive[start..start + length], name);
    archive[at..at + name.len()].copy_from_slice(other);
    let sum = crc32(&archive[start..start + length]).to_le_bytes();
    for at in 0..archive.len() - 4 {
        if archive[at..at + 4] == old_sum[..] {
            archive[at..at + 4].copy_from_slice(&sum);
        }
    }
    archive
}

/// The checksum of zip archives.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| {
            (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg())
        })
    })
}

#[test]
fn published_compositions_become_a_run_that_composes() {
    let sandbox = published();
    let weights = workspace().join("data_fixtures/flowmdm/checkpoint.pt");
    sandbox.write("flowmdm.pt", fs::read(&weights).expect("a fixture"));
    // The command of the documentation, with its names of files.
    let page = fs::read_to_string(workspace().join("docs/compose.md")).expect("a page");
    let mut lines = page.lines();
    let command = lines.find_map(|line| line.strip_prefix("kinegrad import "));
    let command = command.expect("a command of import");
    let file = command.split(' ').next().expect("the weights");
    sandbox.write(file, fs::read(&weights).expect("a fixture"));
    for (own, documented) in [("m.npy", "Mean.npy"), ("s.npy", "Std.npy")] {
        sandbox.write(documented, fs::read(sandbox.path(own)).expect("a file"));
    }
    let said = sandbox.run(&format!("import {command}")).succeeded();
    assert!(said.stdout.contains("parameters"), "{}", said.stdout);
    sandbox
        .run("sample runs/flowmdm --frames 30 --steps 3 --out composed --allow-unusable")
        .succeeded();
    assert_eq!(shape(&sandbox.path("composed.npy")), [30, 22, 3]);
    let record = fs::read_to_string(sandbox.path("composed.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["composition"]["bpe_denoising_step"], 60);
    // Other weights, and statistics that do not fit.
    for (line, expected) in [
        (
            "import checkpoint_mdm.pt --arch flowmdm --mean m.npy --std s.npy --out no",
            "these are not the weights of FlowMDM",
        ),
        ("import flowmdm.pt --arch flowmdm --out no", "statistics"),
        (
            "import flowmdm.pt --arch flowmdm --mean m.npy --std s.npy --projection m.npy --out no",
            "`--projection`",
        ),
    ] {
        sandbox.run(line).failed(2, &[expected]);
    }
    assert!(!sandbox.path("no").exists());
}
