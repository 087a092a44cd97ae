//! Whether a body stands on the ground and moves smoothly.

use serde::{Deserialize, Serialize};

use super::{jerk_norms, lowest_heights, skating_ratio};
use crate::humanml::{Joints, Skeleton};
use crate::moments::mean;
use crate::quantiles::percentile;

/// A body whose lowest joint is further above the floor floats, metres.
pub const FLOATING: f64 = 0.03;

/// Measures of a body that a path, a goal or a lock does not optimise.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct BodyQuality {
    /// Height of the lowest joint above the floor that 95 % of the frames stay below, metres.
    pub lowest_joint: Option<f64>,
    /// Share of the frames in which the lowest joint is above [`FLOATING`].
    pub floating: Option<f64>,
    /// [`skating_ratio`] of the toes; none for a single frame.
    pub foot_skating: Option<f64>,
    /// Mean norm of the jerk of all joints, metres per second cubed; none below four frames.
    pub jerk: Option<f64>,
    /// Its 99th percentile over frames and joints.
    pub jerk_99: Option<f64>,
    /// The largest one.
    pub jerk_largest: Option<f64>,
}

impl BodyQuality {
    /// Measures of `joints` of `skeleton` above a floor of that height.
    pub fn of(joints: &Joints, skeleton: &Skeleton, floor: f64) -> Self {
        let (fps, feet) = (skeleton.description().fps, skeleton.contact_joints());
        let lowest = lowest_heights(joints).into_iter();
        let lowest: Vec<f64> = lowest.map(|height| height - floor).collect();
        let floats = lowest
            .iter()
            .map(|height| f64::from(u8::from(*height > FLOATING)));
        let floating = mean(floats);
        let jerks = jerk_norms(joints, fps);
        let any = |of: &dyn Fn() -> f64| (!jerks.is_empty()).then(of);
        Self {
            lowest_joint: Some(percentile(lowest, 95.0)),
            floating: Some(floating),
            foot_skating: skating_ratio(joints, fps, &[feet[1], feet[3]]),
            jerk: any(&|| mean(jerks.iter().copied())),
            jerk_99: any(&|| percentile(jerks.clone(), 99.0)),
            jerk_largest: any(&|| jerks.iter().copied().fold(0.0, f64::max)),
        }
    }

    /// Name, value and digits of each measure.
    pub fn rows(&self) -> [(&'static str, Option<f64>, usize); 6] {
        [
            ("lowest joint over the floor, m", self.lowest_joint, 3),
            ("share of frames that float", self.floating, 3),
            ("foot skating", self.foot_skating, 3),
            ("jerk, m/s^3", self.jerk, 0),
            ("jerk, 99th percentile", self.jerk_99, 0),
            ("jerk, largest", self.jerk_largest, 0),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk::{Course, joints as walk};
    use crate::metrics::mean_jerk;

    #[test]
    fn a_body_that_hangs_over_the_floor_is_seen() {
        let skeleton = Skeleton::humanml3d();
        let course = Course {
            speed: Box::new(|_| 1.1),
            turning: Box::new(|_| 0.0),
        };
        let joints = Joints::new(walk(&course, &skeleton, 60), 22).unwrap();
        let stands = BodyQuality::of(&joints, &skeleton, 0.0);
        assert_eq!(stands.floating, Some(0.0));
        assert!(stands.lowest_joint.unwrap() < FLOATING, "{stands:?}");
        let own = mean_jerk(&joints, 20.0).unwrap();
        assert!((stands.jerk.unwrap() / own - 1.0).abs() < 1e-9);
        assert!(stands.jerk < stands.jerk_99 && stands.jerk_99 < stands.jerk_largest);
        // Every second frame is 8 cm higher.
        let places = joints.as_slice().iter().enumerate();
        let places = places.map(|(n, [x, y, z])| [*x, y + 0.08 * (n / 22 % 2) as f64, *z]);
        let hops = Joints::new(places.collect(), 22).unwrap();
        let hops = BodyQuality::of(&hops, &skeleton, 0.0);
        assert_eq!(hops.floating, Some(0.5));
        assert!(
            hops.lowest_joint.unwrap() > 0.08 && hops.jerk > stands.jerk,
            "{hops:?}"
        );
        // Above a floor at that height it stands.
        assert_eq!(
            BodyQuality::of(&joints, &skeleton, -0.08).floating,
            Some(1.0)
        );
    }
}
