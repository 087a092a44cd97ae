//! Several figures in one motion.
//!
//! The figures of a file become one tree: an additional joint follows the first figure over the
//! ground and has its heading, and the highest moving joint of each figure hangs on it. The place of
//! the others is then relative to the first, so that they stay together.

use std::collections::HashSet;

use kinegrad_capture::{Axis, Bvh, Channel, Joint, RootPose, UpAxis, bare_name};
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::minus;

use crate::Error;
use crate::motion_matrix::travelling_joint;
use crate::parts::subtree;

/// The additional joint.
const ABOVE: &str = "figures";

/// The figures of a file as one motion. `up`: the axis that points up.
///
/// # Errors
/// Fails without figures.
pub fn joined(figures: &[Bvh], up: UpAxis) -> Result<Bvh, Error> {
    let mut above = Joint::new(ABOVE.to_string(), None, [0.0; 3], None);
    above.channels = moving(&[]);
    let mut joints = vec![above];
    let mut names = HashSet::new();
    let tops: Vec<usize> = figures.iter().map(travelling_joint).collect();
    for (number, (figure, &top)) in figures.iter().zip(&tops).enumerate() {
        let first = joints.len();
        for index in subtree(figure.joints(), top) {
            let mut joint = figure.joints()[index].clone();
            if !names.insert(joint.name.clone()) {
                joint.name = format!("figure{}:{}", number + 1, bare_name(&joint.name));
            }
            match index == top {
                true => {
                    joint.parent = Some(0);
                    joint.offset = [0.0; 3];
                    joint.channels = moving(&joint.channels);
                }
                false => joint.parent = joint.parent.map(|parent| first + parent - top),
            }
            joints.push(joint);
        }
    }
    let frames = figures.iter().map(Bvh::frames).min().unwrap_or(0);
    let mut locals = Vec::with_capacity(frames * joints.len());
    for t in 0..frames {
        let worlds = figures.iter().zip(&tops);
        let worlds: Vec<RootPose> = worlds.map(|(figure, &top)| figure.world(t)[top]).collect();
        let above = below_first(worlds[0], up);
        locals.push(above);
        let back = above.orientation.conjugate();
        for ((figure, &top), world) in figures.iter().zip(&tops).zip(worlds) {
            locals.push(RootPose {
                position: back.rotate(minus(world.position, above.position)),
                orientation: back * world.orientation,
            });
            let own = figure.locals(t);
            locals.extend(
                subtree(figure.joints(), top)
                    .skip(1)
                    .map(|joint| own[joint]),
            );
        }
    }
    let frame_time = figures.first().map_or(0.0, Bvh::frame_time);
    Ok(Bvh::from_poses(joints, frame_time, &locals)?)
}

/// The figures of a motion that was made from [`joined`] figures, with the joints and channels of
/// `figures`.
///
/// # Errors
/// Fails if a value is not finite.
///
/// # Panics
/// Panics if the motion has other joints.
pub fn separated(motion: &Bvh, figures: &[Bvh]) -> Result<Vec<Bvh>, Error> {
    let mut first = 1;
    let separated = figures.iter().map(|figure| {
        let top = travelling_joint(figure);
        let joints: Vec<usize> = subtree(figure.joints(), top).collect();
        let still = figure.locals(0);
        let above = figure.joints()[top]
            .parent
            .map(|parent| figure.world(0)[parent]);
        let mut locals = Vec::with_capacity(motion.frames() * still.len());
        for t in 0..motion.frames() {
            let own = motion.locals(t);
            let world = motion.world(t)[first];
            let mut poses = still.clone();
            for (place, &joint) in joints.iter().enumerate().skip(1) {
                poses[joint] = own[first + place];
            }
            poses[top] = match above {
                None => world,
                Some(above) => {
                    let back = above.orientation.conjugate();
                    RootPose {
                        position: back.rotate(minus(world.position, above.position)),
                        orientation: back * world.orientation,
                    }
                }
            };
            locals.extend(poses);
        }
        first += joints.len();
        Ok(figure.reposed(motion.frame_time(), &locals)?)
    });
    separated.collect()
}

/// Place on the ground and heading of a joint.
fn below_first(world: RootPose, up: UpAxis) -> RootPose {
    let (axis, rotation) = match up {
        UpAxis::Y => (1, world.orientation.y),
        UpAxis::Z => (2, world.orientation.z),
    };
    let mut position = world.position;
    position[axis] = 0.0;
    let mut heading = [0.0; 3];
    heading[axis] = 2.0 * rotation.atan2(world.orientation.w);
    RootPose {
        position,
        orientation: Quaternion::from_rotation_vector(heading),
    }
}

/// Channels of place and rotation, with the rotations of `own` if there are three.
fn moving(own: &[Channel]) -> Vec<Channel> {
    let places = [Axis::X, Axis::Y, Axis::Z].map(Channel::Position);
    let turns = own.iter().copied();
    let turns: Vec<Channel> = turns
        .filter(|channel| matches!(channel, Channel::Rotation(_)))
        .collect();
    let turns = match turns.len() {
        3 => turns,
        _ => [Axis::Z, Axis::X, Axis::Y].map(Channel::Rotation).to_vec(),
    };
    [places.to_vec(), turns].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_matrix::tests::example;
    use crate::{Example, Heading, Job, Length, MatrixOptions, MotionMatrix, Part};

    /// Two walkers, the second to the left of the first and in the opposite phase of its turn.
    fn pair() -> Vec<Bvh> {
        let one = example("walk.bvh", 90, 1.0 / 30.0).bvh;
        let mut locals: Vec<RootPose> = (0..90).flat_map(|t| one.locals(t)).collect();
        for pose in locals.chunks_exact_mut(one.joints().len()) {
            pose[1].position[0] += 120.0;
            pose[1].orientation = Quaternion::from_yaw(2.0) * pose[1].orientation;
        }
        let two = one.reposed(1.0 / 30.0, &locals).unwrap();
        vec![one, two]
    }

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        kinegrad_motion::vector::length(minus(a, b))
    }

    #[test]
    fn figures_come_back_as_they_were() {
        let figures = pair();
        let one = joined(&figures, UpAxis::Y).unwrap();
        assert_eq!(one.joints().len(), 1 + 2 * (figures[0].joints().len() - 1));
        assert_eq!(one.joints()[6].name, "figure2:Hips");
        let back = separated(&one, &figures).unwrap();
        for (back, known) in back.iter().zip(&figures) {
            assert_eq!(back.joints(), known.joints());
            for t in 0..90 {
                for (a, b) in back.world(t).iter().zip(known.world(t)) {
                    assert!(apart(a.position, b.position) < 1e-6);
                    assert!(1.0 - a.orientation.dot(b.orientation).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn figures_that_are_matched_together_stay_together() {
        let figures = pair();
        for heading in [Heading::World, Heading::Relative] {
            let examples = [Example {
                file: "pair.bvh".to_string(),
                bvh: joined(&figures, UpAxis::Y).unwrap(),
            }];
            let job = Job {
                length: Some(Length::Frames(240)),
                heading,
                ..Job::default()
            };
            let made = job.make(&examples).unwrap();
            let new = separated(&made.bvh, &figures).unwrap();
            assert_eq!(new[0].frames(), 240);
            let hips = |figures: &[Bvh], t: usize| [0, 1].map(|k| figures[k].world(t)[1].position);
            // The walkers travel, and their distance stays that of the example.
            let [start, end] = [0, 239].map(|t| hips(&new, t)[0]);
            assert!(apart(start, end) > 300.0);
            for t in 0..240 {
                let [a, b] = hips(&new, t);
                assert!((apart(a, b) - 120.0).abs() < 12.0, "{}", apart(a, b));
            }
        }
    }

    #[test]
    fn legs_of_every_figure_follow_the_trajectory() {
        let examples = [Example {
            file: "pair.bvh".to_string(),
            bvh: joined(&pair(), UpAxis::Y).unwrap(),
        }];
        let layout = MotionMatrix::new(&examples, MatrixOptions::default()).unwrap();
        assert_eq!(layout.joints()[layout.root_joint].name, ABOVE);
        let parts = Part::supported(&layout);
        assert_eq!(parts.len(), 1);
        assert_eq!(parts[0].joints.len(), layout.joints().len());
        let legs = Part::named("legs", &parts, &layout, "fixed part").unwrap();
        assert!(legs.root_trajectory);
        assert_eq!(legs.joints.len(), layout.joints().len());
    }
}
