//! Peak Jerk and Area Under the Jerk of transitions (Barquero et al. 2024; docs/sources.md, 6.6).

use serde::{Deserialize, Serialize};

use crate::humanml::Joints;

/// Published mean jerk of HumanML3D at 20 frames per second, metres per frame cubed.
pub const HUMANML3D_JERK: f64 = 0.033_031_363;

/// Published mean jerk of BABEL at 30 frames per second, metres per frame cubed.
pub const BABEL_JERK: f64 = 0.016_383_045;

/// Jerk of each frame, `[frames - 3]`, metres per frame cubed: the largest L1 norm of a joint's
/// third difference. This norm depends on the heading.
pub fn jerk_of_frames(joints: &Joints) -> Vec<f64> {
    let frames = joints.frames().saturating_sub(3);
    let of_joint = |t: usize, joint: usize| -> f64 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|ahead| joints.frame(t + ahead)[joint]);
        let of_axis = |i: usize| (d[i] - 3.0 * c[i] + 3.0 * b[i] - a[i]).abs();
        (0..3).map(of_axis).sum()
    };
    let of_frame = |t: usize| {
        let joints = (0..joints.joints()).map(|joint| of_joint(t, joint));
        joints.fold(0.0, f64::max)
    };
    (0..frames).map(of_frame).collect()
}

/// The jerk around transitions.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TransitionJerk {
    /// The largest value over time of the mean over transitions.
    pub peak: f64,
    /// Sum over time of the absolute difference of that mean from the jerk of real motion.
    pub area: f64,
}

impl TransitionJerk {
    /// Measures curves of [`jerk_of_frames`], each around one transition. Missing frames of shorter
    /// curves count as 0, as in the published program. `None` without frames.
    pub fn of(curves: &[Vec<f64>], real_jerk: f64) -> Option<Self> {
        let frames = curves.iter().map(Vec::len).max()?;
        let mean = |t: usize| {
            let values = curves.iter().map(|curve| curve.get(t).unwrap_or(&0.0));
            values.sum::<f64>() / curves.len() as f64
        };
        let means: Vec<f64> = (0..frames).map(mean).collect();
        (frames > 0).then(|| Self {
            peak: means.iter().copied().fold(0.0, f64::max),
            area: means.iter().map(|mean| (mean - real_jerk).abs()).sum(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_a_peak_and_constant_velocity_is_none() {
        let joints = |jump: f64| {
            let places = (0..12).flat_map(|t| {
                let by = if t < 6 { 0.0 } else { jump };
                [[0.1 * f64::from(t) + by, 1.0, 0.0], [0.0, 0.5, 0.2]]
            });
            Joints::new(places.collect(), 2).unwrap()
        };
        let constant = jerk_of_frames(&joints(0.0));
        assert_eq!(constant.len(), 9);
        assert!(constant.iter().all(|jerk| *jerk < 1e-12));
        let jumping = jerk_of_frames(&joints(0.3));
        let found = TransitionJerk::of(&[jumping.clone(), constant.clone()], 0.0).unwrap();
        // The third differences of a step are 1, -2, 1.
        assert!((found.peak - 0.3).abs() < 1e-9, "{}", found.peak);
        assert!((found.area - 0.6).abs() < 1e-9, "{}", found.area);
        let real = TransitionJerk::of(&[constant], 0.01).unwrap();
        assert!((real.area - 0.09).abs() < 1e-9);
        assert_eq!(TransitionJerk::of(&[], 0.0), None);
        assert_eq!(TransitionJerk::of(&[vec![]], 0.0), None);
    }
}
