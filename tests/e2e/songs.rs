//! `kinegrad sample` in windows: whole songs, continued motion, known frames; post-processing
//! profiles.

use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use kinegrad_cc_motion::generate::Generator;
use kinegrad_cc_motion::windowed::WindowedSampling;
use kinegrad_data::{AudioLayout, load_audio, read_motion};
use kinegrad_motion::phrase::POSITION;
use kinegrad_motion::stitch::Windows;
use kinegrad_motion::{MotionMeasure, Phrase};
use kinegrad_random::{Key, Purpose};
use kinegrad_systems::BUILT_IN;
use kinegrad_tests::captures::wav;
use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox};
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::sampling::KnownFramesCondition;
use serde_json::Value;

/// A sandbox with a run that was trained on 24 frames, and a song of 181 frames.
fn trained(settings: &str) -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("song.wav", wav(6));
    sandbox.run(&format!("train c.toml {settings}")).succeeded();
    sandbox
}

fn motion(sandbox: &Sandbox, file: &str) -> Phrase {
    read_motion(&sandbox.path(file)).expect("a motion")
}

fn record(sandbox: &Sandbox, file: &str) -> Value {
    let text = fs::read_to_string(sandbox.path(file)).expect("a record");
    serde_json::from_str(&text).expect("JSON")
}

/// Mean path jerk around the frames where windows begin and end, over that of the other frames.
fn seams(motion: &Phrase, windows: &Windows) -> f64 {
    let near = |t: usize| {
        (0..windows.len()).any(|window| {
            let range = windows.of(window);
            let inside = |border: usize| border > 0 && border < motion.frames();
            [range.start, range.end]
                .into_iter()
                .any(|border| inside(border) && border.abs_diff(t + 2) <= 2)
        })
    };
    let jerk = |t: usize| {
        MotionMeasure::PathJerk
            .of(&motion.slice(t..t + 4))
            .expect("four frames")
    };
    let (mut at, mut inside) = (Vec::new(), Vec::new());
    for t in 0..motion.frames() - 3 {
        let of = if near(t) { &mut at } else { &mut inside };
        of.push(jerk(t));
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    mean(&at) / mean(&inside)
}

#[test]
fn a_song_of_any_length_is_drawn_whole() {
    let sandbox = trained("--set train.max_steps=150");
    let draw = "sample runs/smallest --audio song.wav --guidance-scale 1.5";
    sandbox
        .run(&format!("{draw} --steps 8 --out whole"))
        .succeeded();
    let whole = motion(&sandbox, "whole.npy");
    assert_eq!(whole.frames(), 181);
    let said = record(&sandbox, "whole.json");
    assert_eq!(said["frames"], 181);
    assert_eq!(
        said["windows"],
        serde_json::json!({"frames": 24, "count": 11, "in_flight": 8})
    );
    let ratio = seams(&whole, &Windows::new(181, 24));
    assert!(ratio < 1.2, "jerk at seams is {ratio} times the inside");
    // Lengths that no windows fill evenly, and the last frames of the song.
    for (arguments, frames, windows) in [
        ("--frames 25", 25, Some(2)),
        ("--frames 61 --start 0.5", 61, Some(4)),
        ("--start 4.4", 49, Some(3)),
        ("--start 5.3", 22, None),
    ] {
        sandbox
            .run(&format!(
                "{draw} {arguments} --steps 2 --out part --overwrite"
            ))
            .succeeded();
        assert_eq!(motion(&sandbox, "part.npy").frames(), frames, "{arguments}");
        let count = &record(&sandbox, "part.json")["windows"]["count"];
        assert_eq!(count.as_u64(), windows, "{arguments}");
    }
    let many = sandbox
        .run(&format!("{draw} --steps 2 --count 2 --out two"))
        .succeeded();
    assert_eq!(many.stdout.lines().count(), 6);
    assert_ne!(
        motion(&sandbox, "two-000.npy"),
        motion(&sandbox, "two-001.npy")
    );
    sandbox
        .run(&format!("{draw} --frames 182 --out more"))
        .failed(2, &["`--frames` is 182", "181 frames"]);
}

#[test]
fn what_fits_into_one_window_is_drawn_as_a_phrase() {
    let sandbox = trained("--set train.max_steps=4");
    fs::copy(sandbox.path("song.wav"), sandbox.path("cond.wav")).expect("a copy");
    sandbox
        .run("audio features cond.wav --out features")
        .succeeded();
    let draw = "sample runs/smallest --frames 24 --steps 4";
    sandbox
        .run(&format!("{draw} --audio cond.wav --out song"))
        .succeeded();
    sandbox
        .run(&format!(
            "{draw} --audio-features features/cond/features.npz --out phrase"
        ))
        .succeeded();
    assert_eq!(motion(&sandbox, "song.npy"), motion(&sandbox, "phrase.npy"));
    assert!(record(&sandbox, "song.json")["windows"].is_null());
}

#[test]
fn windows_in_flight_change_nothing_and_ddpm_shares_its_noise() {
    let sandbox = trained("--set train.max_steps=4");
    sandbox
        .run("audio features song.wav --out features")
        .succeeded();
    let audio = load_audio(
        &sandbox.path("features/song/features.npz"),
        AudioLayout::CCMOTION,
    )
    .expect("features");
    let audio = audio.slice(0..95);
    let checkpoint = sandbox.path("runs/smallest/checkpoints/step-00000004");
    let saved = SavedCheckpoint::read(&checkpoint).expect("a checkpoint");
    let trained = BUILT_IN.trained(saved, &[], Weights::Ema, Some("cpu"));
    let generator = Generator::load(&trained.expect("a model")).expect("a generator");
    for kind in ["ddim", "ddpm", "dpmpp_2m", "heun"] {
        let mut sampling = generator.config().sampling.clone();
        let sampler = serde_json::json!({ "kind": kind, "num_inference_steps": 5 });
        sampling.sampler = serde_json::from_value(sampler).expect("a sampler");
        let draw = |in_flight: usize| {
            let whole = WindowedSampling {
                audio: &audio,
                windows: Windows::new(95, 24),
                known: None,
                path: None,
                in_flight,
            };
            let mut last = (0, 0);
            let sample = generator.sample_windowed(
                &whole,
                &sampling,
                Key::new(3, Purpose::Sampling),
                &mut |done, all| {
                    assert!(done > last.0 && done <= all);
                    last = (done, all);
                    ControlFlow::Continue(())
                },
            );
            assert_eq!(last.0, last.1, "{kind} tells all steps");
            sample.expect("a sample").motion
        };
        let one = draw(1);
        assert_eq!(one.frames(), 95);
        assert_eq!(one.first_non_finite(), None);
        for in_flight in [3, 8] {
            assert_eq!(draw(in_flight), one, "{kind}");
        }
    }
    let stopped = generator.sample_windowed(
        &WindowedSampling {
            audio: &audio,
            windows: Windows::new(95, 24),
            known: None,
            path: None,
            in_flight: 2,
        },
        &generator.config().sampling,
        Key::new(3, Purpose::Sampling),
        &mut |_, _| ControlFlow::Break(()),
    );
    assert!(stopped.is_err());
}

#[test]
fn kept_frames_are_those_of_the_motion_to_the_bit() {
    for settings in [
        "--set train.max_steps=4",
        "--set train.max_steps=2 --set train.recipe=e2e --set decoder.coherence=projection \
         --set rollout.steps=2 --set init.pretrain.diffusion_steps=2 \
         --set init.pretrain.decoder_steps=2 --set decoder.hidden_dim=32",
    ] {
        let sandbox = trained(settings);
        let draw = "sample runs/smallest --audio song.wav --steps 4";
        sandbox
            .run(&format!("{draw} --frames 90 --seed 1 --out first"))
            .succeeded();
        let first = motion(&sandbox, "first.npy");
        sandbox
            .run(&format!(
                "{draw} --frames 70 --keep 0..5,40..52 --keep-from first.npy --out between"
            ))
            .succeeded();
        for file in ["between.npy", "between.raw.npy"] {
            let between = motion(&sandbox, file);
            assert_eq!(between.frames(), 70);
            for t in (0..5).chain(40..52) {
                assert_eq!(between.frame(t), first.frame(t), "frame {t} of {file}");
            }
            assert_ne!(between.frame(20), first.frame(20));
        }
        assert_eq!(
            record(&sandbox, "between.json")["condition"]["known_frames"],
            serde_json::json!({
                "motion": "first.npy", "frames": [[0, 5], [40, 52]], "continued": false
            })
        );
        // It continues from the last frames, wherever they are.
        sandbox
            .run(&format!(
                "{draw} --start 2 --continue-from first.npy --out more"
            ))
            .succeeded();
        let more = motion(&sandbox, "more.npy");
        for t in 0..6 {
            assert_eq!(more.frame(t), first.frame(84 + t), "frame {t}");
        }
        let kept = &record(&sandbox, "more.json")["condition"]["known_frames"];
        assert_eq!(kept["frames"], serde_json::json!([[0, 6]]));
        assert_eq!(kept["continued"], true);
        // The first new frame is as near as consecutive frames are.
        let step = |t: usize| {
            let apart = POSITION.map(|c| more.frame(t + 1)[c] - more.frame(t)[c]);
            apart.map(|d| d * d).sum::<f32>().sqrt()
        };
        let largest = (6..more.frames() - 1).map(step).fold(0.0, f32::max);
        assert!(step(5) <= 2.0 * largest, "{} {largest}", step(5));
    }
}

#[test]
fn frames_that_cannot_be_kept_are_refused() {
    let sandbox = trained("--set train.max_steps=2");
    sandbox
        .run("sample runs/smallest --out first --steps 2")
        .succeeded();
    let before = sandbox.list(".");
    for (arguments, expected) in [
        ("--keep 3..2 --keep-from first.npy", "`--keep 3..2`: `3..2`"),
        ("--keep 0..5,4..6 --keep-from first.npy", "`4..6`"),
        (
            "--keep 0..99 --keep-from first.npy",
            "first.npy has 40 frames",
        ),
        (
            "--keep 0..30 --keep-from first.npy --frames 20",
            "the sample has 20 frames",
        ),
        ("--keep 0..40 --keep-from first.npy", "keeps all 40 frames"),
        ("--keep 0..3 --keep-from none.npy", "none.npy"),
        ("--continue-from c.toml", "c.toml"),
        ("--keep 0..3", "--keep-from"),
        ("--keep-from first.npy", "--keep"),
        (
            "--continue-from first.npy --keep 0..3 --keep-from first.npy",
            "cannot be used with",
        ),
        ("--postprocess some", "some"),
    ] {
        sandbox
            .run(&format!("sample runs/smallest {arguments} --out wrong"))
            .failed(2, &[expected]);
        assert_eq!(sandbox.list("."), before, "{arguments}");
    }
    let walks = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    walks.write("c.toml", SMALLEST_WALKS);
    walks
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    for arguments in ["--postprocess none", "--continue-from a.npy"] {
        let option = arguments.split(' ').next().expect("an option");
        walks
            .run(&format!("sample runs/smallest {arguments} --out wrong"))
            .failed(2, &[option, "a run of recipe `gmd_motion`"]);
    }
    let given = KnownFramesCondition::in_place(Path::new("m.npy"), "1..2").expect("a range");
    assert_eq!(given.frames, [[1, 2]]);
}

#[test]
fn the_profile_says_how_a_sample_is_repaired() {
    // The columns of a rotation are short where the network is uncertain.
    let settings = "--set train.max_steps=2 --set model.orientation_target=rotation_6d";
    let sandbox = trained(settings);
    let draw = "sample runs/smallest --steps 2";
    for (profile, hemisphere) in [
        ("default", Some("continuous")),
        ("ccmotion", Some("positive_w")),
        ("none", None),
    ] {
        sandbox
            .run(&format!("{draw} --postprocess {profile} --out {profile}"))
            .succeeded();
        let said = &record(&sandbox, &format!("{profile}.json"))["post_processing"];
        assert_eq!(said["normalize_quaternions"], hemisphere.is_some());
        if let Some(hemisphere) = hemisphere {
            assert_eq!(said["hemisphere"], hemisphere);
        }
    }
    sandbox.run(&format!("{draw} --out unsaid")).succeeded();
    assert_eq!(
        motion(&sandbox, "unsaid.npy"),
        motion(&sandbox, "default.npy")
    );
    assert_eq!(
        motion(&sandbox, "none.npy"),
        motion(&sandbox, "none.raw.npy")
    );
    let literal = motion(&sandbox, "ccmotion.npy");
    assert!((0..literal.frames()).all(|t| literal.quaternion(t).w >= 0.0));
    // Single steps.
    let only = "fit_coherent_motion=false";
    for (name, setting) in [
        ("smoothed", "apply_smoothing=true"),
        ("blended", "enforce_velocity_coherence=true"),
        ("slow", "limits.velocity=0.01"),
    ] {
        let set =
            format!("--set evaluation.postprocess.{only} --set evaluation.postprocess.{setting}");
        let set = match name {
            "slow" => format!("{set} --set evaluation.postprocess.widen_limits=false"),
            _ => set,
        };
        sandbox
            .run(&format!("{draw} {set} --out {name}"))
            .succeeded();
        assert_ne!(
            motion(&sandbox, &format!("{name}.npy")),
            motion(&sandbox, "unsaid.npy")
        );
        let used = &record(&sandbox, &format!("{name}.json"))["post_processing"];
        assert_eq!(used["fit_coherent_motion"], false);
    }
    let slow = motion(&sandbox, "slow.npy");
    assert!((0..slow.frames()).all(|t| slow.frame(t)[3..6].iter().all(|v| v.abs() <= 0.01)));
    sandbox
        .run(&format!(
            "{draw} --set evaluation.postprocess.smoothing_kernel_size=4 --out even"
        ))
        .failed(
            2,
            &[
                "evaluation.postprocess.smoothing_kernel_size",
                "an odd number of frames",
            ],
        );
}
