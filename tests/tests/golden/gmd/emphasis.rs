//! The emphasis projection. The tolerances are the reference data's own.

use kinegrad_motion::emphasis::{EmphasisProjection, relative_importance};
use kinegrad_tests::golden::{Golden, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// The rows that the published models emphasise: root rotation, x and z.
const CHANNELS: [usize; 3] = [0, 1, 2];

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_projections_of_12_features_agree_at_every_scale("gmd/projection_d12.safetensors"),
        golden_projection_of_normalised_motion_goes_there_and_back(
            "gmd/projection_d12.safetensors"
        ),
        golden_projection_at_full_width_agrees("gmd/projection_d263.safetensors"),
    ]
}

/// The tolerances that differ between the files.
struct Tolerances {
    projected: f64,
    round_trip: f64,
}

/// All tensors of a file for one projection, under keys that begin with `prefix`.
fn check_projection(golden: &Golden, prefix: &str, scale: f64, tolerances: &Tolerances) {
    let key = |name: &str| format!("{prefix}{name}");
    let draws = golden.get("in.G");
    let dimension = draws.shape[0];
    let draws = draws.f32s();
    let projection = EmphasisProjection::gaussian(&draws, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    golden.compare_relative(&key("P"), &wide(projection.matrix()), 1e-6);
    golden.compare_relative(&key("P_inv"), &wide(projection.inverse()), 1e-3);
    let variances = projection.variance_per_dimension();
    golden.compare_relative(&key("var_per_dim"), &variances, 1e-5);
    let frames = golden.get("in.x").f32s();
    let projected = projection.project(&frames);
    golden.compare(&key("y"), &wide(&projected), tolerances.projected);
    let back = wide(&projection.unproject(&projected));
    golden.compare(&key("x_back"), &back, tolerances.round_trip);
    golden.compare("in.x", &back, tolerances.round_trip);
    // As a published model's matrix.
    let given = golden.get(&key("P")).f32s();
    let given = EmphasisProjection::from_matrix(&given, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    golden.compare_relative(&key("P_inv"), &wide(given.inverse()), 1e-3);
    golden.compare(
        &key("y"),
        &wide(&given.project(&frames)),
        tolerances.projected,
    );
}

fn golden_projections_of_12_features_agree_at_every_scale(golden: Golden) {
    let tolerances = Tolerances {
        projected: 1e-5,
        round_trip: 1e-4,
    };
    let scales = golden.get("in.c_values").values;
    let dimension = golden.get("in.G").shape[0];
    let importance: Vec<f64> = scales
        .iter()
        .map(|&scale| relative_importance(scale, CHANNELS.len(), dimension))
        .collect();
    golden.compare_relative("out.relative_importance", &importance, 1e-6);
    for &scale in &scales {
        check_projection(&golden, &format!("out.c{scale}."), scale, &tolerances);
    }
}

fn golden_projection_of_normalised_motion_goes_there_and_back(golden: Golden) {
    // The reference has this at a scale of 10.
    let matrix = golden.get("out.c10.P").f32s();
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let dimension = mean.len();
    let projection = EmphasisProjection::from_matrix(&matrix, dimension, 10.0, &CHANNELS)
        .expect("the reference matrix can be undone");
    let each_channel = |values: &[f64], map: &dyn Fn(f64, usize) -> f64| -> Vec<f64> {
        let places = values.iter().enumerate();
        places
            .map(|(index, &value)| map(value, index % dimension))
            .collect()
    };
    let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect::<Vec<_>>();
    let normalised = each_channel(&golden.get("in.motion").values, &|v, c| {
        (v - mean[c]) / std[c]
    });
    let projected = projection.project(&single(normalised));
    golden.compare("out.motion_to_model", &wide(&projected), 1e-5);
    let back = wide(&projection.unproject(&projected));
    let motion = each_channel(&back, &|v, c| v * std[c] + mean[c]);
    golden.compare("out.model_to_motion", &motion, 1e-4);
    golden.compare("in.motion", &motion, 1e-4);
}

fn golden_projection_at_full_width_agrees(golden: Golden) {
    let tolerances = Tolerances {
        projected: 5e-5,
        round_trip: 1e-3,
    };
    // The reference's own routine has this scale.
    let scale = 10.0;
    check_projection(&golden, "out.", scale, &tolerances);
    let dimension = golden.get("in.G").shape[0];
    let expected = relative_importance(scale, CHANNELS.len(), dimension);
    golden.compare_relative("out.relative_importance_expected", &[expected], 1e-6);
    let draws = golden.get("in.G").f32s();
    let projection = EmphasisProjection::gaussian(&draws, dimension, scale, &CHANNELS)
        .expect("the reference matrix can be undone");
    let share = [projection.trajectory_share()];
    golden.compare_relative("out.relative_importance_of_P", &share, 1e-5);
    let own = projection.measure(0);
    let orthogonal = EmphasisProjection::orthogonal(&draws, dimension, scale, &CHANNELS)
        .expect("orthogonal matrices can be undone");
    let orthogonal = orthogonal.measure(0);
    assert!(orthogonal.condition_number < own.condition_number);
    assert!(orthogonal.round_trip_max < own.round_trip_max);
}
