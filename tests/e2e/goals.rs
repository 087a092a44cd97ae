//! Clip models from training to motion: goals, published weights, evaluation, bad input.

use std::fs;
use std::path::Path;

use kinegrad_capture::Bvh;
use kinegrad_data::humanml::write_walks;
use kinegrad_data::{read_array, write_values};
use kinegrad_motion::humanml::{Features, Root, Skeleton};
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use serde_json::Value;

pub const GOAL: &str = "frames = 16\n[[keyframe]]\nframe = 8\nx = 0.1\nz = 0.4\n\
                    [[keyframe]]\nframe = 15\nx = 0.2\nz = 0.9\n";

pub fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST_WALKS);
    sandbox.write("goal.toml", GOAL);
    sandbox
}

/// A motion and a trajectory run of a few steps.
pub fn trained() -> Sandbox {
    let sandbox = sandbox();
    for recipe in ["gmd_motion", "gmd_trajectory"] {
        let settings = format!("--set train.recipe={recipe} --set train.max_steps=4");
        sandbox
            .run(&format!("train c.toml --name {recipe} {settings}"))
            .succeeded();
    }
    sandbox
}

pub fn shape(path: &Path) -> Vec<usize> {
    read_array(path).expect("an array").shape
}

#[test]
fn two_stages_lead_to_a_goal_in_four_files() {
    let sandbox = trained();
    let sample = "sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --goal goal.toml";
    let said = sandbox.run(&format!("{sample} --out walk")).succeeded();
    assert!(said.stdout.contains("average error"), "{}", said.stdout);
    assert_eq!(shape(&sandbox.path("walk.npy")), [16, 22, 3]);
    assert_eq!(shape(&sandbox.path("walk.features.npy")), [16, 263]);
    assert_eq!(shape(&sandbox.path("walk.path.npy")), [16, 2]);
    let bvh = fs::read(sandbox.path("walk.bvh")).expect("a file");
    let bvh = Bvh::parse(&bvh, "walk.bvh").expect("what was written can be read");
    assert_eq!(bvh.frames(), 16);
    // Bone lengths of an untrained network's samples vary.
    let note = "note: walk.bvh: joints are up to ";
    assert!(said.stderr.contains(note), "{}", said.stderr);

    let said = sandbox.run(&format!("{sample} --out locked --lock-feet"));
    let said = said.succeeded().stderr;
    assert!(said.contains("note: locked.bvh: feet stand in"), "{said}");
    sandbox.run(&format!("{sample} --out again")).succeeded();
    let bytes = |name: &str| fs::read(sandbox.path(name)).expect("a file");
    assert!(bytes("walk.npy") == bytes("again.npy"));
    assert!(bytes("walk.npy") == bytes("locked.npy"));
    sandbox
        .run(&format!("{sample} --seed 1 --out other"))
        .succeeded();
    assert!(bytes("walk.npy") != bytes("other.npy"));
}

#[test]
fn several_goals_are_drawn_as_one_batch_and_a_trajectory_run_alone_gives_paths() {
    let sandbox = trained();
    let sample = "sample runs/gmd_trajectory --goal goal.toml --goal goal.toml --count 2";
    sandbox
        .run(&format!("{sample} --out path --lock-feet"))
        .failed(2, &["`--lock-feet`", "no bodies"]);
    sandbox.run(&format!("{sample} --out path")).succeeded();
    for index in 0..4 {
        assert_eq!(
            shape(&sandbox.path(format!("path-{index:03}.npy"))),
            [16, 2]
        );
    }
    sandbox
        .run("sample runs/gmd_motion --frames 12 --out free")
        .succeeded();
    assert_eq!(shape(&sandbox.path("free.npy")), [12, 22, 3]);
}

#[test]
fn a_sampled_body_is_measured_beside_the_training_clips() {
    let sandbox = trained();
    let said = sandbox
        .run("sample runs/gmd_motion --frames 16 --out free")
        .succeeded();
    // An undertrained network leaves the bounds of the training motion.
    for part in [
        "1 sample: mean speed ",
        " (training ",
        "; mean jerk ",
        "; skating ",
        "warning: the sample is out of bounds: ",
    ] {
        assert!(said.stderr.contains(part), "{part}: {}", said.stderr);
    }
    let text = fs::read_to_string(sandbox.path("free.json")).expect("a record");
    let body = serde_json::from_str::<Value>(&text).expect("JSON")["body"].clone();
    assert!(!body["failed"].as_array().expect("failed").is_empty());
    let fastest = &body["measures"]["fastest_joint"];
    let frame = fastest["frame"].as_u64().expect("a frame") as usize;
    let places = read_array(&sandbox.path("free.npy"))
        .expect("joints")
        .values;
    let (places, _) = places.as_chunks::<3>();
    let (frames, _) = places.as_chunks::<22>();
    let speed = |joint: usize| {
        let step =
            [0, 1, 2].map(|axis| frames[frame][joint][axis] - frames[frame - 1][joint][axis]);
        20.0 * f64::from(step.iter().map(|part| part * part).sum::<f32>().sqrt())
    };
    let largest = (0..22).map(speed).fold(0.0, f64::max);
    let value = fastest["value"].as_f64().expect("a speed");
    assert!((largest / value - 1.0).abs() < 1e-3, "{largest}: {body}");
    assert!(fastest["training"][1].as_f64() > Some(0.0), "{body}");
    let checked = sandbox.run("check free.npy --run runs/gmd_motion");
    let checked = checked.failed(1, &[]).stdout;
    assert!(checked.contains("FAIL "), "{checked}");
}

#[test]
fn a_root_out_of_bounds_is_sampled_again_and_reported_with_its_frame() {
    let sandbox = trained();
    // A step across the disc is inside it, although no frame is.
    let obstacle = "[[obstacle]]\nkind = \"disc\"\nx = 0.1\nz = 0.4\nradius = 3.0\n";
    sandbox.write("around.toml", format!("{GOAL}{obstacle}"));
    let sample = "sample runs/gmd_trajectory --goal around.toml --count 2 --out path --overwrite \
                  --allow-unusable --set steering.detours=false";
    let said = sandbox
        .run(&format!("{sample} --set steering.attempts=1"))
        .succeeded();
    for part in [
        "warning: sample 000: ",
        "times the fastest step of training (",
        " m/s) in frame ",
    ] {
        assert!(said.stderr.contains(part), "{part}: {}", said.stderr);
    }
    assert!(!said.stderr.contains("attempt"), "{}", said.stderr);
    for part in [
        "clearance  ",
        "fastest root step  ",
        "fastest of training  ",
    ] {
        assert!(said.stdout.contains(part), "{part}: {}", said.stdout);
    }
    // The record has what the written path has.
    let record = |name: &str| {
        let text = fs::read_to_string(sandbox.path(name)).expect("a record");
        serde_json::from_str::<Value>(&text).expect("JSON")["ground"].clone()
    };
    let found = record("path-000.json");
    let path = read_array(&sandbox.path("path-000.npy"))
        .expect("a path")
        .values;
    let (path, _) = path.as_chunks::<2>();
    let step = |frame: usize| {
        let [from, to] = [path[frame - 1], path[frame]];
        20.0 * f64::from((to[0] - from[0]).hypot(to[1] - from[1]))
    };
    let frame = found["fastest_step"]["frame"].as_u64().expect("a frame") as usize;
    let speed = found["fastest_step"]["speed"].as_f64().expect("a speed");
    assert!((step(frame) - speed).abs() < 1e-3 * speed);
    assert!((1..path.len()).all(|frame| step(frame) <= speed * 1.001));
    assert!(
        found["clearance"]["frames_inside"].as_u64() > Some(0),
        "{found}"
    );

    let said = sandbox.run(&format!("{sample} --set steering.attempts=3"));
    said.succeeded();
    let again = record("path-000.json");
    assert!(again["rejected"].as_u64() <= Some(2), "{again}");
    // Without a goal too.
    let free = "sample runs/gmd_trajectory --out free --allow-unusable";
    sandbox.run(free).succeeded();
    assert!(record("free.json")["fastest_step"]["speed"].is_number());
}

#[test]
fn the_second_stage_is_guided_and_imputed_as_its_config_says() {
    let sandbox = trained();
    let obstacle = "[[obstacle]]\nkind = \"disc\"\nx = 0.1\nz = 0.4\nradius = 3.0\n";
    sandbox.write("around.toml", format!("{GOAL}{obstacle}"));
    let drawn = |goal: &str, settings: &str| {
        let sample = "sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --steps 16 \
                      --set steering.attempts=1";
        let sample = format!("{sample} --goal {goal}.toml --out walk --overwrite {settings}");
        sandbox.run(&sample).succeeded();
        let read = |name: &str| read_array(&sandbox.path(name)).expect("an array").values;
        (read("walk.path.npy"), read("walk.features.npy"))
    };
    let steering = "--set steering";
    let (path, both) = drawn("around", "");
    for settings in [
        format!("{steering}.second_stage_guidance=false"),
        format!("{steering}.schedule.motion_until=400"),
    ] {
        let (same, other) = drawn("around", &settings);
        assert_eq!(same, path, "{settings}: the first stage is as before");
        assert_ne!(other, both, "{settings}");
    }
    let record = fs::read_to_string(sandbox.path("walk.json")).expect("a record");
    assert!(record.contains("second_stage_guidance"), "{record}");
    // The stages have independent numbers of steps.
    let (twice, follows) = drawn("around", &format!("{steering}.first_stage_steps=8"));
    assert_ne!(twice, path);
    assert_ne!(follows, both);
    let same = format!("{steering}.first_stage_steps=16");
    assert_eq!(drawn("around", &same), (path, both));
    let record = fs::read_to_string(sandbox.path("walk.json")).expect("a record");
    assert!(record.contains("\"first_stage_steps\": 16"), "{record}");
    let refused = "sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --goal around.toml \
                   --out no --set steering.first_stage_steps=1001";
    sandbox
        .run(refused)
        .failed(2, &["`steering.first_stage_steps` is 1001", "1 to 1000"]);
}

#[test]
fn positions_are_checked_with_the_statistics_of_the_features_trained_on() {
    let sandbox = trained();
    let walks = sandbox.path("walks");
    write_walks(&walks, 3, 40, 7).expect("a dataset");
    let skeleton = Skeleton::humanml3d();
    let name = "walk_00000.npy";
    let rows = read_array(&walks.join("new_joint_vecs").join(name)).expect("features");
    let features = Features::new(rows.values, skeleton.layout(), Root::Relative);
    let joints = features.expect("a walk").joints();
    let mut values = joints.to_f32();
    let shape = [joints.frames(), joints.joints(), 3];
    write_values(&sandbox.path("walk.npy"), &shape, &values).expect("a file");
    // The same path in a fifth of the time.
    for (index, value) in values.iter_mut().enumerate() {
        let frame = index / (3 * joints.joints());
        *value += if index % 3 == 2 {
            0.2 * frame as f32
        } else {
            0.0
        };
    }
    write_values(&sandbox.path("fast.npy"), &shape, &values).expect("a file");
    for statistics in ["--run runs/gmd_motion", "--source walks"] {
        let check =
            |file: &str| sandbox.run(&format!("check {file} --profile strict {statistics}"));
        check("walk.npy").succeeded();
        let fast = check("fast.npy").failed(1, &[]);
        let line = fast.stdout.lines().find(|line| line.contains("speed"));
        assert!(line.is_some_and(|line| line.contains("FAIL")), "{line:?}");
    }
}

#[test]
fn runs_are_measured_on_goals_of_held_out_clips() {
    let sandbox = trained();
    let said = sandbox
        .run(
            "eval runs/gmd_motion --set evaluation.goals=2 --set evaluation.keyframes=3 \
             --trajectory-run runs/gmd_trajectory",
        )
        .succeeded();
    assert!(said.stdout.contains("real"), "{}", said.stdout);
    let settings = "goals=2-keyframes=3";
    let report = format!("runs/gmd_motion/reports/eval-goals-two-stage-{settings}.json");
    let report = sandbox.path(report);
    let report: Value = serde_json::from_slice(&fs::read(report).expect("a report")).expect("JSON");
    let report = &report["evaluations"][0];
    assert_eq!(report["real"]["average_error"], 0.0);
    assert!(report["sampled"]["average_error"].as_f64() > Some(0.0));
    // Without the first stage the report has another name, so both can be compared.
    sandbox
        .run("eval runs/gmd_motion --set evaluation.goals=2 --set evaluation.keyframes=3")
        .succeeded();
    let stems = ["eval-goals-two-stage", "eval-goals"];
    let files =
        ["csv", "json"].map(|ending| stems.map(|stem| format!("{stem}-{settings}.{ending}")));
    let mut files = files.concat();
    files.sort();
    assert_eq!(sandbox.list("runs/gmd_motion/reports"), files);
    sandbox
        .run(
            "eval runs/gmd_trajectory --set evaluation.goals=2 --set evaluation.obstacles=1 \
             --set steering.scale=0",
        )
        .succeeded();
    sandbox
        .run("eval runs/gmd_motion --set evaluation.split=test")
        .failed(2, &["evaluation.split", "synthetic_walks"]);
    sandbox
        .run("eval runs/gmd_motion --set evaluation.evaluator.weights=finest.tar")
        .failed(2, &["evaluation.evaluator.mean", "word_vectors"]);
}

#[test]
fn what_belongs_to_another_system_is_refused_by_name() {
    let sandbox = trained();
    sandbox.write("p.toml", SMALLEST);
    sandbox
        .run("train p.toml --name phrases --set train.max_steps=2")
        .succeeded();
    for (command, texts) in [
        (
            "train p.toml --name x --set train.recipe=decoder --set init.diffusion=runs/gmd_motion",
            [
                "`init.diffusion`",
                "runs/gmd_motion",
                "recipe is `gmd_motion`",
            ],
        ),
        (
            "train c.toml --name x --set train.recipe=gmd_motion --set init.diffusion=runs/phrases",
            ["`init.diffusion`", "runs/phrases", "recipe is `diffusion`"],
        ),
        (
            "eval runs/phrases --trajectory-run runs/gmd_trajectory",
            [
                "`--trajectory-run`",
                "runs/phrases",
                "a run of recipe `diffusion`",
            ],
        ),
        (
            "train c.toml --name phrases --set train.recipe=gmd_motion --resume",
            [
                "`train.recipe`",
                "gmd_motion",
                "\"diffusion\", which the run",
            ],
        ),
    ] {
        sandbox.run(command).failed(2, &texts);
    }
    assert!(!sandbox.path("runs/x").exists());
}

#[test]
fn a_run_starts_from_another_and_keeps_its_space() {
    let sandbox = trained();
    let train = "train c.toml --name tuned --set init.diffusion=runs/gmd_motion \
                 --set train.max_steps=2";
    sandbox.run(train).succeeded();
    let more = format!("{train} --resume --set train.max_steps=4 --set optim.weight_decay=0.5");
    sandbox.run(&more).failed(2, &["optim.weight_decay"]);
    let more = format!("{train} --resume").replace("max_steps=2", "max_steps=4");
    sandbox.run(&more).succeeded();
    sandbox
        .run(&format!("{train} --set emphasis.kind=none").replace("--name tuned", "--name plain"))
        .failed(2, &["emphasis.kind"]);
    let matrix = |run: &str, step: &str| {
        let path = format!("runs/{run}/checkpoints/step-{step}/model.safetensors");
        let bytes = fs::read(sandbox.path(path)).expect("weights");
        let tensors = safetensors::SafeTensors::deserialize(&bytes).expect("a file of tensors");
        let matrix = tensors.tensor("projection.matrix").expect("a matrix");
        matrix.data().to_vec()
    };
    assert!(matrix("tuned", "00000004") == matrix("gmd_motion", "00000004"));
    sandbox
        .run("train c.toml --name other --set init.diffusion=runs/gmd_trajectory")
        .failed(2, &["init.diffusion", "`gmd_trajectory`"]);
}

#[test]
fn goals_that_cannot_be_followed_are_refused_by_name() {
    let sandbox = trained();
    let sample = "sample runs/gmd_motion --goal goal.toml --out walk";
    let refused = |goal: &str, texts: &[&str]| {
        sandbox.write("goal.toml", goal);
        sandbox.run(sample).failed(2, texts);
        assert!(!sandbox.path("walk.npy").exists());
    };
    refused(
        "frames = 16\n[[keyframe]]\nframe = 16\nx = 0.0\nz = 0.0\n",
        &["goal.toml", "keyframe[0].frame", "0 to 15"],
    );
    refused(
        "frames = 99\n[[keyframe]]\nframe = 50\nx = 0.0\nz = 0.0\n",
        &["`frames` is 99", "1 to 20"],
    );
    refused(
        "frames = 16\n[[keyframes]]\nframe = 1\n",
        &["goal.toml", "keyframes"],
    );
    refused("frames = 16\n", &["goal.toml"]);
    refused(
        "frames = 16\nweights = [1.0, 2.0]\nkeyframe = [{ frame = 1, x = 0.0, z = 0.0 }]\n",
        &["goal.toml", "`weights`", "a list of 2 values"],
    );
    refused(
        "frames = 16\nkeyframe = [[1, 0.0, 0.0]]\n",
        &["goal.toml", "`keyframe[0]`", "a list of 3 values"],
    );
    refused(
        "frames = 16\n[[keyframe]]\nframe = 1\nx = nan\nz = 0.0\n",
        &["`keyframe[0].x`", "NaN is not a finite number"],
    );
    for x in ["9223372036854775808", "1e308"] {
        let points = format!("[trajectory]\nfirst_frame = 0\npoints = [[{x}, 0.0], [0.0, 1.0]]\n");
        refused(&format!("frames = 16\n{points}"), &["goal.toml:4: "]);
    }
    sandbox.write("goal.toml", GOAL);
    sandbox
        .run("sample runs/gmd_motion --audio song.mp3 --out walk")
        .failed(2, &["`--audio`", "--text-embedding"]);
    sandbox
        .run("sample runs/gmd_motion --trajectory-run runs/gmd_motion --goal goal.toml --out walk")
        .failed(2, &["--trajectory-run", "gmd_trajectory"]);
    let sample = "sample runs/gmd_motion --goal goal.toml --out walk";
    for (settings, texts) in [
        ("--steps 0", ["num_inference_steps", "1 to"]),
        (
            "--set sampling.sampler.kind=heun",
            ["sampling.sampler.kind", "ddpm"],
        ),
        (
            "--set model.size=mdm",
            ["only keys of `sampling`", "model.size"],
        ),
        ("--frames 8", ["`--seconds` with `--goal`", "frames = 16"]),
        ("--seconds 1", ["`--seconds` with `--goal`", "frames = 16"]),
        ("--set steering.scale=-1", ["steering.scale", "0 or more"]),
        (
            "--set sampling.clip=training_range",
            ["sampling.clip", "training_range"],
        ),
    ] {
        sandbox
            .run(&format!("{sample} {settings}"))
            .failed(2, &texts);
    }
    sandbox
        .run("sample runs/gmd_motion --frames 0 --out walk")
        .failed(2, &["`--frames` is 0"]);
}

#[test]
fn losses_and_samples_at_the_end_are_those_of_every_system() {
    let sandbox = sandbox();
    let train = "train c.toml --name losses --set train.max_steps=2 --set validation.every_steps=1";
    let loss = |settings: &str| {
        let _ = fs::remove_dir_all(sandbox.path("runs/losses"));
        sandbox.run(&format!("{train} {settings}")).succeeded();
        let lines = fs::read_to_string(sandbox.path("runs/losses/metrics.jsonl")).expect("metrics");
        let lines: Vec<Value> = lines
            .lines()
            .map(|line| serde_json::from_str(line).expect("JSON"))
            .collect();
        let first = |key: &str| lines.iter().find_map(|line| line[key].as_f64());
        (
            first("loss").expect("a loss"),
            first("val_loss").expect("one"),
        )
    };
    let (plain, validated) = loss("");
    let (absolute, _) = loss("--set diffusion.loss_type=l1");
    assert!((plain - absolute).abs() > 1e-3, "{plain} {absolute}");
    // Timestep weights change training, not the first validation.
    let (weighted, same) = loss("--set diffusion.snr_gamma=5");
    assert!((plain - weighted).abs() > 1e-3, "{plain} {weighted}");
    assert!(
        (validated - same).abs() < 0.2 * validated,
        "{validated} {same}"
    );
    let said = sandbox
        .run("train c.toml --name end --set train.max_steps=1 --set sampling.count_at_end=2")
        .succeeded();
    assert!(
        said.stdout.contains("1 sample of step 1"),
        "{}",
        said.stdout
    );
    let names = sandbox.list("runs/end/samples");
    let bodies = names.iter().filter(|name| name.ends_with(".bvh"));
    assert!(bodies.count() > 0, "{names:?}");
}

#[test]
fn settings_of_another_kind_of_run_are_refused_by_name() {
    let sandbox = sandbox();
    let refused = |settings: &str, texts: &[&str]| {
        sandbox
            .run(&format!("train c.toml {settings}"))
            .failed(2, texts);
        assert!(!sandbox.path("runs").exists());
    };
    refused("--set model.kind=unet1d", &["model.kind", "gmd_unet"]);
    refused(
        "--set model.num_res_blocks=2",
        &["model.num_res_blocks", "latent_dim"],
    );
    refused(
        "--set model.ff_size=64",
        &["model.ff_size", "mdm_transformer"],
    );
    refused(
        "--set data.kind=synthetic",
        &["data.kind", "synthetic_walks"],
    );
    refused("--set model.padded_frames=15", &["model.padded_frames"]);
    refused("--set model.padded_frames=8", &["data.target_frames", "8"]);
    refused("--set model.dim_mults=[0.3,1]", &["model.dim_mults"]);
    refused("--set emphasis.scale=0", &["scale"]);
    refused(
        "--set loss.trajectory_scale=5",
        &["loss.trajectory_scale", "projected"],
    );
    refused(
        "--set train.recipe=gmd_trajectory --set emphasis.kind=gaussian",
        &["emphasis.kind"],
    );
    refused("--set sampling.clip=training_range", &["sampling.clip"]);
    refused("--set steering.scale=-1", &["steering.scale"]);
    sandbox.write("c.toml", SMALLEST);
    refused("--set data.kind=synthetic_walks", &["data.kind", "phrases"]);
}
