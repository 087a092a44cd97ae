//! Post-processor and checks of the profile `ccmotion` against golden file 10 (docs/sources.md,
//! sections 1.12 and 1.13).

use kinegrad_motion::{Hemisphere, Phrase, PostProcessConfig, Profile, Value, check, process};
use kinegrad_tests::golden::{Golden, compared};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

const TOLERANCE: f64 = 1e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_postprocess_all_options("ccmotion/10_postprocess_sanity.safetensors"),
        golden_postprocess_document_defaults("ccmotion/10_postprocess_sanity.safetensors"),
        golden_sanity_values_and_flags("ccmotion/10_postprocess_sanity.safetensors"),
    ]
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

fn motion(golden: &Golden, name: &str) -> Phrase {
    Phrase::new(golden.get(&format!("in.{name}.motion")).f32s()).expect("whole frames")
}

/// The settings of an option of the file.
fn config(option: &str) -> PostProcessConfig {
    let document = PostProcessConfig::ccmotion();
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

fn golden_postprocess_all_options(golden: Golden) {
    for name in motions(&golden) {
        let input = motion(&golden, &name);
        for option in golden.names_under(&format!("out.post.{name}.")) {
            let key = format!("out.post.{name}.{option}");
            let processed = process(&input, &config(&option), None);
            golden
                .reference(&key)
                .assert_close_f32(&key, processed.as_slice(), TOLERANCE);
        }
    }
}

fn golden_postprocess_document_defaults(golden: Golden) {
    let stored: serde_json::Value =
        serde_json::from_str(golden.metadata("defaults")).expect("the defaults are JSON");
    let ours = serde_json::to_value(PostProcessConfig::ccmotion()).expect("settings serialise");
    for (key, value) in stored.as_object().expect("an object") {
        let name = match key.as_str() {
            "quat_eps" => continue, // A constant here.
            "quat_smooth_window" => "quaternion_smoothing_window",
            other => other,
        };
        assert_eq!(&ours[name], value, "{key}");
        compared(1);
    }
    assert_eq!(
        PostProcessConfig::ccmotion().hemisphere,
        Hemisphere::PositiveW
    );
}

fn golden_sanity_values_and_flags(golden: Golden) {
    let (mut values, mut flags) = (0, 0);
    for name in motions(&golden) {
        let input = motion(&golden, &name);
        for entry in golden.names_under(&format!("out.sanity.{name}.")) {
            let key = format!("out.sanity.{name}.{entry}");
            let (variant, what) = entry.split_once('.').expect("variant and check");
            let checked = match variant {
                "raw" => input.clone(),
                option => process(&input, &config(option), None),
            };
            let report = check(&checked, Profile::Ccmotion, None);
            let of = |check: &str| {
                report
                    .check(check)
                    .unwrap_or_else(|| panic!("the check `{check}` of {key} is new"))
            };
            let flag = |passed: bool| golden.compare_exactly(&key, &[f64::from(u8::from(passed))]);
            if what == "all_passed" {
                flag(report.passed);
                flags += 1;
            } else if let Some(check) = what.strip_suffix(".passed") {
                flag(of(check).passed);
                flags += 1;
            } else {
                let measured = match of(what).value {
                    Value::Number(number) => vec![number],
                    Value::Range(range) => range.to_vec(),
                };
                golden
                    .reference(&key)
                    .assert_close(&key, &measured, TOLERANCE);
                values += 1;
            }
        }
    }
    assert!(values > 0 && flags > 0, "{values} values, {flags} flags");
}
