//! Reference motion for checks without training statistics: measures of captured people.

use std::collections::BTreeMap;

use crate::Statistics;

/// 1st and 99th percentiles of the measures of phrases: 88 phrases of 4 s of ballroom dancers.
const PHRASES: [(&str, [f64; 2]); 13] = [
    ("path_speed", [0.22, 0.93]),
    ("path_acceleration", [1.0, 5.1]),
    ("path_jerk", [27.0, 145.0]),
    ("travel", [0.09, 0.95]),
    ("height", [0.80, 1.07]),
    ("lowest_height", [0.52, 1.02]),
    ("highest_height", [0.88, 1.10]),
    ("turn_rate", [18.8, 286.0]),
    ("turn_acceleration", [331.0, 2313.0]),
    ("largest_turn", [3.0, 31.0]),
    ("largest_tilt", [9.0, 29.0]),
    ("phase_rate", [0.37, 0.53]),
    ("largest_phase_step", [0.012, 0.018]),
];

/// The same of bodies: 1,141 clips of up to 10 s of three actors that walk, run, dance, kick and
/// gesture. The bounds of speed, turning and heights are those of livelier people: sprints,
/// pirouettes, jumps, sitting and lying.
const BODIES: [(&str, [f64; 2]); 11] = [
    ("fastest_root", [0.0, 5.0]),
    ("fastest_joint", [0.0, 11.0]),
    ("jerk_p99", [0.0, 2000.0]),
    ("largest_turn", [0.0, 700.0]),
    ("still_share", [0.0, 0.3]),
    ("glide", [0.0, 3.2]),
    ("skating", [0.0, 0.7]),
    ("floor", [-0.01, 0.0]),
    ("floating", [0.0, 0.3]),
    ("root_height", [0.35, 1.3]),
    ("leg_length", [0.5, 1.0]),
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
