//! Randomly bent trajectories for training (docs/sources.md, section 7, option E).

use std::f64::consts::TAU;

use kinegrad_random::Key;

use super::headings::without_sway;
use super::{Warp, between, placed};
use crate::feet::{ContactRule, Planted, lock_joints};
use crate::humanml::extract::{canonicalize, extrapolated};
use crate::humanml::{Extraction, FeatureError, Features, Joints, Skeleton};

/// Largest overall curvature, radians per metre (a circle of 1.25 m).
const CURVATURE: f64 = 0.8;
/// Largest amplitude of a wave, radians.
const AMPLITUDE: f64 = 0.5;
/// Shortest and longest wave, metres.
const WAVES: [f64; 2] = [2.0, 6.0];
/// Allowed distance of a locked foot from its contact position, metres.
const MISSED: f64 = 0.08;

/// A bend of a trajectory: the direction is rotated by an angle that depends on the arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Overall curvature, radians per metre.
    pub curvature: f64,
    /// Waves of the direction: amplitude (radians), length (metres), phase (radians).
    pub waves: [[f64; 3]; 2],
}

impl Bend {
    /// A random bend: an arc and two waves.
    pub fn random(key: Key) -> Self {
        let uniforms = key.uniforms(7);
        let mut uniforms = uniforms.into_iter().map(f64::from);
        let mut between = |low: f64, high: f64| {
            let share = uniforms.next().expect("seven numbers");
            low + (high - low) * share
        };
        let curvature = between(-CURVATURE, CURVATURE);
        let waves = [(); 2].map(|()| {
            let amplitude = between(0.0, AMPLITUDE);
            [amplitude, between(WAVES[0], WAVES[1]), between(0.0, TAU)]
        });
        Self { curvature, waves }
    }

    /// Rotation of the direction at an arc length, radians; zero at the start.
    pub fn turn(&self, metres: f64) -> f64 {
        let wave = |[amplitude, length, phase]: [f64; 3]| {
            amplitude * ((TAU * metres / length + phase).sin() - phase.sin())
        };
        self.curvature * metres + self.waves.map(wave).iter().sum::<f64>()
    }

    /// `joints` at `fps` frames per second on the bent trajectory. Step and body are rotated by the
    /// angle at their arc length, which ignores sway and standing.
    pub fn apply(&self, joints: &Joints, fps: f64) -> Joints {
        let track = joints.track(0).into_iter();
        let track: Vec<[f64; 2]> = track.map(|[x, _, z]| [x, z]).collect();
        let mut metres = 0.0;
        let mut turns = vec![self.turn(0.0)];
        for pair in without_sway(&track).windows(2) {
            let step = between(pair[0], pair[1]);
            if step * fps >= Warp::STANDING {
                metres += step;
            }
            turns.push(self.turn(metres));
        }
        let mut points = track.clone();
        for t in 1..track.len() {
            let (sin, cos) = (0.5 * (turns[t - 1] + turns[t])).sin_cos();
            let [dx, dz] = [0, 1].map(|axis| track[t][axis] - track[t - 1][axis]);
            let [x, z] = points[t - 1];
            points[t] = [x + dx * cos + dz * sin, z - dx * sin + dz * cos];
        }
        placed(joints, &points, &turns).expect("a point and a turn for each frame")
    }

    /// The relative features of a clip bent with locked feet. Too short legs leave the clip
    /// unchanged.
    ///
    /// # Errors
    /// [`FeatureError::TooFewFrames`]; [`FeatureError::LengthMismatch`] for another skeleton.
    pub fn of_features(
        &self,
        features: &Features,
        skeleton: &Skeleton,
    ) -> Result<Features, FeatureError> {
        let joints = features.joints();
        let bent = self.apply(&joints, skeleton.description().fps);
        let locked = lock_joints(
            &bent,
            &joints,
            skeleton,
            &ContactRule::default(),
            Planted::AsSeen,
            0.0,
        )?;
        if locked.missed > MISSED {
            return Ok(features.to_relative());
        }
        // Features begin at the origin and keep the clip's floor.
        let joints = extrapolated(&locked.joints)?;
        let moved = canonicalize(skeleton, &joints)?;
        let floor = joints.frame(0)[0][1] - moved.frame(0)[0][1];
        let places = moved.as_slice().iter().map(|[x, y, z]| [*x, y + floor, *z]);
        let lifted = Joints::new(places.collect(), joints.joints())?;
        Extraction::default().features_in_place(skeleton, &lifted)
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_random::Purpose;

    use super::*;
    use crate::humanml::walk::{Course, joints as walk};
    use crate::metrics::skating_ratio;
    use crate::path::course::walked;
    use crate::path::{headings_of_gait, unwrapped};
    use crate::vector::{length, minus};

    fn straight(frames: usize) -> (Joints, Skeleton) {
        let skeleton = Skeleton::humanml3d();
        let course = Course {
            speed: Box::new(|_| 1.2),
            turning: Box::new(|_| 0.0),
        };
        let places = walk(&course, &skeleton, frames);
        (Joints::new(places, 22).unwrap(), skeleton)
    }

    fn heading_at(joints: &Joints, t: usize) -> f64 {
        let track: Vec<[f64; 2]> = joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
        unwrapped(&headings_of_gait(&track, 0.0))[t]
    }

    #[test]
    fn a_straight_walk_becomes_part_of_a_circle_of_the_same_length() {
        let (joints, _) = straight(81);
        let bend = Bend {
            curvature: -0.5,
            waves: [[0.0, 2.0, 0.0]; 2],
        };
        let bent = bend.apply(&joints, 20.0);
        let metres = |joints: &Joints| {
            let track: Vec<[f64; 2]> = joints.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
            walked(&track)[80]
        };
        assert!((metres(&bent) - metres(&joints)).abs() < 1e-9);
        let turned = heading_at(&bent, 70) - heading_at(&bent, 10);
        let expected = -0.5 * metres(&joints) * 60.0 / 80.0;
        assert!((turned - expected).abs() < 0.05, "{turned} {expected}");
    }

    #[test]
    fn bones_and_heights_stay_and_samples_differ() {
        let (joints, skeleton) = straight(60);
        let key = Key::new(3, Purpose::Augment);
        let bent: Vec<Joints> = (0..20)
            .map(|n| Bend::random(key.at(n)).apply(&joints, 20.0))
            .collect();
        let ends: Vec<f64> = bent.iter().map(|bent| heading_at(bent, 59)).collect();
        let most = ends.iter().copied().fold(f64::MIN, f64::max);
        let least = ends.iter().copied().fold(f64::MAX, f64::min);
        assert!(most > 0.5 && least < -0.5, "{least} to {most}");
        for bent in &bent {
            for t in 0..60 {
                let (old, new) = (joints.frame(t), bent.frame(t));
                for (joint, parent) in skeleton.parents().iter().enumerate() {
                    assert_eq!(old[joint][1], new[joint][1]);
                    let Some(parent) = *parent else { continue };
                    let bone = |frame: &[[f64; 3]]| length(minus(frame[joint], frame[parent]));
                    assert!((bone(old) - bone(new)).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn features_follow_the_bend_and_feet_do_not_slide_more() {
        let (joints, skeleton) = straight(70);
        let features = Extraction::default();
        let features = features.features_of_all_frames(&skeleton, &joints).unwrap();
        let feet = skeleton.contact_joints();
        let skates =
            |joints: &Joints| skating_ratio(joints, 20.0, &[feet[1], feet[3]]).unwrap_or(0.0);
        let before = skates(&features.joints());
        for n in 0..5 {
            let bend = Bend::random(Key::new(8, Purpose::Augment).at(n));
            let made = bend.of_features(&features, &skeleton).unwrap();
            assert_eq!(made.frames(), features.frames());
            let (found, expected) = (made.joints(), bend.apply(&features.joints(), 20.0));
            let turned = |joints: &Joints| heading_at(joints, 65) - heading_at(joints, 5);
            let apart = turned(&found) - turned(&expected);
            assert!(apart.abs() < 0.05, "{apart}");
            assert!(skates(&found) <= before + 0.05, "{}", skates(&found));
        }
    }

    #[test]
    fn a_body_that_stands_and_sways_is_not_turned_and_floors_stay() {
        let (joints, skeleton) = straight(60);
        let still = joints.frame(7).to_vec();
        // The body is half a metre above the floor and sways by a centimetre.
        let places = (0..60).flat_map(|t| {
            let (a, b) = (
                0.01 * (0.9 * f64::from(t)).sin(),
                0.01 * (1.3 * f64::from(t)).cos(),
            );
            still.iter().map(move |[x, y, z]| [x + a, y + 0.5, z + b])
        });
        let standing = Joints::new(places.collect(), 22).unwrap();
        let features = Extraction {
            rescale: false,
            ..Extraction::default()
        };
        let joints = extrapolated(&standing).unwrap();
        let moved = canonicalize(&skeleton, &joints).unwrap();
        let places = moved.as_slice().iter().map(|[x, y, z]| [*x, y + 0.5, *z]);
        let lifted = Joints::new(places.collect(), 22).unwrap();
        let features = features.features_in_place(&skeleton, &lifted).unwrap();
        let bend = Bend {
            curvature: 0.8,
            waves: [[0.5, 2.0, 1.0]; 2],
        };
        let bent = bend.of_features(&features, &skeleton).unwrap();
        let pairs = features
            .joints()
            .to_f32()
            .into_iter()
            .zip(bent.joints().to_f32());
        let apart = pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()));
        assert!(apart < 0.01, "{apart}");
    }
}
