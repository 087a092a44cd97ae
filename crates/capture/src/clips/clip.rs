//! From a body to the features of clips.

use std::ops::Range;

use kinegrad_motion::humanml::extract::{canonicalize, leg_ratio, rescale};
use kinegrad_motion::humanml::{Extraction, FeatureError, Features, Joints, Skeleton};
use kinegrad_motion::vector::{length, minus};

/// Toes that move less than this distance in metres between frames stand.
const STANDING: f64 = 0.01;
/// Fewest frames of standing toes that define the floor.
const ENOUGH: usize = 5;
/// Fraction of standing toes that may be below the floor, due to capture errors.
const BELOW: f64 = 0.05;

/// The joints of a take with its feet on the floor, to cut clips from.
pub(super) struct Grounded {
    /// `[frames, J]`, metres; the floor is y = 0.
    pub joints: Joints,
}

impl Grounded {
    /// Puts the joints of a take on the floor: the height at which the toes stand. With `retarget`,
    /// the joints get the bones of `skeleton` ([`rescale`]). A retargeted body is moved up or down
    /// in each frame until its lower toes are as high as before, in proportion to its legs.
    pub fn new(skeleton: &Skeleton, joints: &Joints, retarget: bool) -> Result<Self, FeatureError> {
        let joints = match retarget {
            true => on_its_toes(skeleton, joints, &rescale(skeleton, joints)?)?,
            false => joints.clone(),
        };
        let floor = floor(skeleton, &joints);
        let joints = raised(&joints, -floor)?;
        Ok(Self { joints })
    }

    /// Number of feature frames: each needs two frames of joints.
    pub fn frames(&self) -> usize {
        self.joints.frames() - 1
    }

    /// The features of a part of the take, moved to begin at x = z = 0 facing +z. The floor is that
    /// of the whole take, because the feet may not touch the floor in each part.
    pub fn clip(
        &self,
        skeleton: &Skeleton,
        frames: Range<usize>,
    ) -> Result<Features, FeatureError> {
        let count = self.joints.joints();
        let part = &self.joints.as_slice()[frames.start * count..(frames.end + 1) * count];
        let part = Joints::new(part.to_vec(), count)?;
        let placed = raised(&canonicalize(skeleton, &part)?, lowest(&part))?;
        Extraction::default().features_in_place(skeleton, &placed)
    }
}

/// The `rescaled` joints, moved up or down in each frame: the lower toes are as high as in the
/// `source`, in proportion to the legs.
fn on_its_toes(
    skeleton: &Skeleton,
    source: &Joints,
    rescaled: &Joints,
) -> Result<Joints, FeatureError> {
    let ratio = leg_ratio(skeleton, source)?;
    let [_, left, _, right] = skeleton.contact_joints();
    let lower = |joints: &Joints, t: usize| {
        let frame = joints.frame(t);
        frame[left][1].min(frame[right][1])
    };
    let places = (0..rescaled.frames()).flat_map(|t| {
        let by = ratio * lower(source, t) - lower(rescaled, t);
        let frame = rescaled.frame(t).iter();
        frame.map(move |[x, y, z]| [*x, y + by, *z])
    });
    Joints::new(places.collect(), rescaled.joints())
}

/// The height of the floor: a low percentile of the heights of standing toes, or the lowest joint.
fn floor(skeleton: &Skeleton, joints: &Joints) -> f64 {
    let [_, left, _, right] = skeleton.contact_joints();
    let height = |(t, toes): (usize, usize)| {
        let [now, before] = [t, t - 1].map(|t| joints.frame(t)[toes]);
        (length(minus(now, before)) < STANDING).then_some(now[1])
    };
    let toes = (1..joints.frames()).flat_map(|t| [(t, left), (t, right)]);
    let mut standing: Vec<f64> = toes.filter_map(height).collect();
    if standing.len() < ENOUGH {
        return lowest(joints);
    }
    standing.sort_by(f64::total_cmp);
    standing[(BELOW * standing.len() as f64) as usize]
}

fn lowest(joints: &Joints) -> f64 {
    let heights = joints.as_slice().iter().map(|[_, y, _]| *y);
    heights.fold(f64::INFINITY, f64::min)
}

fn raised(joints: &Joints, by: f64) -> Result<Joints, FeatureError> {
    let places = joints.as_slice().iter().map(|[x, y, z]| [*x, y + by, *z]);
    Joints::new(places.collect(), joints.joints())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clips::tests::walking;

    /// Heights of the lower toes, `[frames]`.
    fn toes(joints: &Joints) -> Vec<f64> {
        let frames = (0..joints.frames()).map(|t| joints.frame(t));
        frames.map(|frame| frame[10][1].min(frame[11][1])).collect()
    }

    /// A walk on a floor half a metre below the origin whose upper body sways up and down by 4 cm on
    /// legs that grow and shrink.
    fn swaying() -> Joints {
        let joints = walking(90, 20.0, 1.0);
        let legs = [4, 5, 7, 8, 10, 11];
        let places = joints
            .as_slice()
            .iter()
            .enumerate()
            .map(|(place, [x, y, z])| {
                let sway = match legs.contains(&(place % 22)) {
                    true => 0.0,
                    false => 0.04 * (place as f64 / 22.0 / 6.0).sin(),
                };
                [*x, y + sway - 0.5, *z]
            });
        Joints::new(places.collect(), 22).unwrap()
    }

    #[test]
    fn toes_stand_on_the_floor_whatever_the_bones_were() {
        let skeleton = Skeleton::humanml3d();
        for scale in [1.0, 1.3] {
            let source = swaying();
            let places = source.as_slice().iter();
            let places = places.map(|place| place.map(|value| value * scale));
            let source = Joints::new(places.collect(), 22).unwrap();
            let grounded = Grounded::new(&skeleton, &source, true).unwrap();
            let highest = |heights: Vec<f64>| heights.into_iter().fold(0.0, f64::max);
            let plain = rescale(&skeleton, &source).unwrap();
            let least = lowest(&plain);
            let floating = toes(&plain).into_iter().map(|height| height - least);
            assert!(
                highest(floating.collect()) > 0.05,
                "the test would show nothing"
            );
            let standing = toes(&grounded.joints);
            assert!(highest(standing.clone()) < 0.03, "{standing:?}");
            assert!(
                standing.iter().all(|height| *height > -0.02),
                "{standing:?}"
            );
        }
    }

    #[test]
    fn the_floor_is_where_most_toes_stand_and_not_where_a_joint_dips() {
        let skeleton = Skeleton::humanml3d();
        let joints = walking(90, 20.0, 0.8);
        let mut places = joints.as_slice().to_vec();
        // A hand and a foot far below the floor in one frame each.
        places[30 * 22 + 20][1] -= 3.0;
        places[40 * 22 + 10][1] -= 0.2;
        let dipping = Joints::new(places, 22).unwrap();
        let found = floor(&skeleton, &dipping);
        let known = floor(&skeleton, &joints);
        assert!((found - known).abs() < 0.01, "{found} {known}");
        // A body that never stands has its lowest joint on the floor.
        let flying = joints.as_slice().iter().enumerate();
        let flying = flying.map(|(place, [x, y, z])| [*x, y + (place / 22) as f64, *z]);
        let flying = Joints::new(flying.collect(), 22).unwrap();
        assert_eq!(floor(&skeleton, &flying), lowest(&flying));
    }
}
