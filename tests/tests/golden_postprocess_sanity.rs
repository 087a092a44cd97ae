//! Post-processor and document checks against golden file 10 (docs/sources.md, sections 1.12 and
//! 1.13).

use kinegrad_motion::{Hemisphere, Motion, PostProcessConfig, Profile, Value, check, process};
use kinegrad_tests::golden::Golden;

const TOLERANCE: f64 = 1e-5;

fn open() -> Option<Golden> {
    Golden::open("ccmotion", "10_postprocess_sanity.safetensors")
}

/// Names of the motions in the file.
fn motions(golden: &Golden) -> Vec<String> {
    let names = golden.names_under("in.");
    let motions: Vec<String> = names
        .iter()
        .filter_map(|name| name.strip_suffix(".motion"))
        .map(String::from)
        .collect();
    assert!(!motions.is_empty(), "the file holds motions");
    motions
}

fn motion(golden: &Golden, name: &str) -> Motion {
    Motion::new(golden.get(&format!("in.{name}.motion")).f32s()).expect("whole frames")
}

/// The settings that an option of the file stands for.
fn config(option: &str) -> PostProcessConfig {
    let document = PostProcessConfig::document();
    match option {
        "default" => document,
        "none" => PostProcessConfig::none(),
        "no_clamp" => PostProcessConfig {
            clamp_values: false,
            ..document
        },
        "no_quat" => PostProcessConfig {
            normalize_quaternions: false,
            ..document
        },
        "vel_coherence" => PostProcessConfig {
            enforce_velocity_coherence: true,
            ..document
        },
        "accel_coherence" => PostProcessConfig {
            enforce_accel_coherence: true,
            ..document
        },
        "vel_accel_coherence" => PostProcessConfig {
            enforce_velocity_coherence: true,
            enforce_accel_coherence: true,
            ..document
        },
        "quat_smooth" => PostProcessConfig {
            smooth_quaternions: true,
            ..document
        },
        "phase_monotonic" => PostProcessConfig {
            enforce_phase_monotonic: true,
            ..document
        },
        "all" => PostProcessConfig {
            smooth_quaternions: true,
            enforce_phase_monotonic: true,
            enforce_velocity_coherence: true,
            enforce_accel_coherence: true,
            apply_smoothing: true,
            ..document
        },
        other => {
            let kernel = other
                .strip_prefix("smoothing")
                .and_then(|size| size.parse().ok());
            let smoothing_kernel_size =
                kernel.unwrap_or_else(|| panic!("the option `{other}` is new"));
            PostProcessConfig {
                apply_smoothing: true,
                smoothing_kernel_size,
                ..document
            }
        }
    }
}

#[test]
fn golden_postprocess_all_options() {
    let Some(golden) = open() else { return };
    let (mut worst, mut compared) = (0.0f64, 0);
    for name in motions(&golden) {
        let input = motion(&golden, &name);
        for option in golden.names_under(&format!("out.post.{name}.")) {
            let key = format!("out.post.{name}.{option}");
            let processed = process(&input, &config(&option), None);
            let error =
                golden
                    .reference(&key)
                    .assert_close_f32(&key, processed.as_slice(), TOLERANCE);
            worst = worst.max(error);
            compared += 1;
        }
    }
    assert!(compared > 0, "the file holds processed motions");
    println!("{compared} processed motions, largest error {worst:.2e}");
}

#[test]
fn golden_postprocess_document_defaults() {
    let Some(golden) = open() else { return };
    let stored: serde_json::Value =
        serde_json::from_str(golden.metadata("defaults")).expect("the defaults are JSON");
    let ours = serde_json::to_value(PostProcessConfig::document()).expect("settings serialise");
    for (key, value) in stored.as_object().expect("an object") {
        let name = match key.as_str() {
            "quat_eps" => continue, // A constant here.
            "quat_smooth_window" => "quaternion_smoothing_window",
            other => other,
        };
        assert_eq!(&ours[name], value, "{key}");
    }
    assert_eq!(
        PostProcessConfig::document().hemisphere,
        Hemisphere::PositiveW
    );
}

#[test]
fn golden_sanity_values_and_flags() {
    let Some(golden) = open() else { return };
    let (mut worst, mut values, mut flags) = (0.0f64, 0, 0);
    for name in motions(&golden) {
        let input = motion(&golden, &name);
        for entry in golden.names_under(&format!("out.sanity.{name}.")) {
            let key = format!("out.sanity.{name}.{entry}");
            let (variant, what) = entry.split_once('.').expect("variant and check");
            let checked = match variant {
                "raw" => input.clone(),
                option => process(&input, &config(option), None),
            };
            let report = check(&checked, Profile::Document, None).expect("no statistics needed");
            let of = |check: &str| {
                report
                    .check(check)
                    .unwrap_or_else(|| panic!("the check `{check}` of {key} is new"))
            };
            if what == "all_passed" {
                assert_eq!(report.passed, golden.get(&key).scalar() != 0.0, "{key}");
                flags += 1;
            } else if let Some(check) = what.strip_suffix(".passed") {
                assert_eq!(of(check).passed, golden.get(&key).scalar() != 0.0, "{key}");
                flags += 1;
            } else {
                let measured = match of(what).value {
                    Value::Number(number) => vec![number],
                    Value::Range(range) => range.to_vec(),
                };
                worst = worst.max(
                    golden
                        .reference(&key)
                        .assert_close(&key, &measured, TOLERANCE),
                );
                values += 1;
            }
        }
    }
    assert!(values > 0 && flags > 0, "the file holds sanity values");
    println!("{values} sanity values, largest error {worst:.2e}; {flags} flags");
}
