//! Reference motion for checks without training statistics: measures of captured people.

use std::collections::BTreeMap;

use crate::Statistics;

/// 1st and 99th percentiles of the measures of phrases: 286 phrases of 4 s of ballroom dancers,
/// some of whom hold a pose.
const PHRASES: [(&str, [f64; 2]); 16] = [
    ("path_speed", [0.04, 0.93]),
    ("fastest_step", [0.14, 2.16]),
    ("path_acceleration", [0.35, 5.1]),
    ("path_jerk", [15.0, 145.0]),
    ("travel", [0.03, 0.95]),
    ("height", [0.70, 1.07]),
    ("lowest_height", [0.47, 1.02]),
    ("highest_height", [0.88, 1.10]),
    ("turn_rate", [7.5, 286.0]),
    ("turn_acceleration", [100.0, 2313.0]),
    ("largest_turn", [0.7, 31.3]),
    ("largest_tilt", [9.0, 34.0]),
    ("phase_rate", [0.28, 0.54]),
    ("largest_phase_step", [0.009, 0.019]),
    ("largest_acceleration", [2.5, 50.0]),
    ("still_share", [0.0, 0.1]),
];

/// The same of bodies: 1,267 clips of up to 10 s of actors and dancers that walk, run, dance, kick and
/// gesture. The bounds of speed, turning and heights are those of livelier people: sprints,
/// pirouettes, jumps, sitting and lying.
const BODIES: [(&str, [f64; 2]); 17] = [
    ("fastest_root", [0.0, 5.0]),
    ("fastest_joint", [0.0, 11.0]),
    ("jerk_p99", [0.0, 2000.0]),
    ("largest_jerk", [0.0, 4000.0]),
    ("largest_turn", [0.0, 700.0]),
    ("root_acceleration", [0.0, 27.0]),
    ("turn_acceleration", [0.0, 3500.0]),
    ("still_share", [0.0, 0.15]),
    ("glide", [0.0, 3.2]),
    ("statue", [0.0, 0.0]),
    ("time_direction", [-3.2, 0.05]),
    ("skating", [0.0, 0.5]),
    ("floor", [-0.01, 0.0]),
    ("floating", [0.0, 0.09]),
    ("flight", [0.0, 0.4]),
    ("root_height", [0.35, 1.3]),
    ("leg_length", [0.6, 1.05]),
];

/// 95th percentile of the clips' mean jerk norms, metres per second cubed.
pub(super) const JERK_P95: f64 = 350.0;

/// Statistics of phrases of 120 frames.
pub(super) fn phrases() -> Statistics {
    Statistics {
        frames: 120,
        items: 1,
        rms_speed: Some(0.72),
        rms_acceleration: Some(3.8),
        jerk_p95: Some(120.0),
        movement: by_name(&PHRASES),
        ..Statistics::default()
    }
}

/// Measures of bodies.
pub(super) fn bodies() -> BTreeMap<String, [f64; 2]> {
    by_name(&BODIES)
}

fn by_name(measures: &[(&str, [f64; 2])]) -> BTreeMap<String, [f64; 2]> {
    let named = measures.iter();
    named
        .map(|&(name, range)| (name.to_owned(), range))
        .collect()
}
