//! Motion that comes to rest at the end of a path.

use super::STILL;
use super::course::{ground, walked};
use crate::humanml::{FeatureError, Joints, Skeleton};
use crate::vector::{length, minus, plus};

/// Time in which a motion comes to rest, seconds.
const STOP_SECONDS: f64 = 1.0;

/// A motion that stands in its last frames.
pub(super) struct Idle {
    pub joints: Joints,
    /// The first frame that stands.
    pub from: usize,
}

/// `joints` until the root has gone `metres`, slower and slower in the last [`STOP_SECONDS`], then
/// standing in the pose of that place. The number of frames stays. `None` for a motion that does not
/// go further.
pub(super) fn standing_after(
    joints: &Joints,
    skeleton: &Skeleton,
    metres: f64,
) -> Result<Option<Idle>, FeatureError> {
    let gone = walked(&ground(joints));
    let Some(next) = gone.iter().position(|gone| *gone > metres + STILL) else {
        return Ok(None);
    };
    // The first frame has gone nothing, so there is one before.
    let (before, step) = (next - 1, gone[next] - gone[next - 1]);
    let arrival = before as f64 + (metres - gone[before]) / step;
    let stop = Stop {
        arrival,
        width: (STOP_SECONDS * skeleton.description().fps)
            .min(2.0 * arrival)
            .min(2.0 * ((joints.frames() - 1) as f64 - arrival)),
    };
    let moments: Vec<f64> = (0..joints.frames())
        .map(|t| stop.moment(t as f64))
        .collect();
    let from = moments.iter().position(|moment| *moment >= arrival);
    let frames = moments
        .iter()
        .flat_map(|&moment| pose(joints, skeleton, moment));
    Ok(Some(Idle {
        joints: Joints::new(frames.collect(), joints.joints())?,
        from: from.unwrap_or(moments.len() - 1),
    }))
}

/// Time of a motion that slows down to a stop, in frames.
struct Stop {
    /// The moment of the motion at which it stands.
    arrival: f64,
    /// Frames in which it slows down; the motion advances by half of them.
    width: f64,
}

impl Stop {
    /// The moment of the motion that frame `t` shows. Its speed falls from 1 to 0 as `1 - 3 s^2 + 2
    /// s^3`.
    fn moment(&self, t: f64) -> f64 {
        let begin = self.arrival - self.width / 2.0;
        match t {
            _ if t <= begin => t,
            _ if t >= begin + self.width => self.arrival,
            _ => {
                let s = (t - begin) / self.width;
                begin + self.width * (s - s.powi(3) + s.powi(4) / 2.0)
            }
        }
    }
}

/// The pose between two frames: bones turn and keep their lengths.
fn pose(joints: &Joints, skeleton: &Skeleton, moment: f64) -> Vec<[f64; 3]> {
    let last = joints.frames() - 1;
    let frame = (moment as usize).min(last);
    let (a, b) = (joints.frame(frame), joints.frame((frame + 1).min(last)));
    let share = moment - frame as f64;
    if share == 0.0 {
        return a.to_vec();
    }
    let scaled = |vector: [f64; 3], factor: f64| vector.map(|value| value * factor);
    let mixed = |x: [f64; 3], y: [f64; 3]| plus(x, scaled(minus(y, x), share));
    let mut pose = a.to_vec();
    pose[0] = mixed(a[0], b[0]);
    for [parent, child] in skeleton.chains().flatten() {
        let bones = [a, b].map(|frame| minus(frame[child], frame[parent]));
        let bone = mixed(bones[0], bones[1]);
        let [before, after] = bones.map(length);
        let (wanted, found) = (before + share * (after - before), length(bone));
        let factor = if found > 0.0 { wanted / found } else { 0.0 };
        pose[child] = plus(pose[parent], scaled(bone, factor));
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::walk::{Course, joints as walk};

    #[test]
    fn a_walk_comes_to_rest_where_it_is_asked_to() {
        let skeleton = Skeleton::humanml3d();
        let course = Course {
            speed: Box::new(|_| 1.2),
            turning: Box::new(|t| 0.3 * t.sin()),
        };
        let joints = Joints::new(walk(&course, &skeleton, 100), 22).unwrap();
        let all = *walked(&ground(&joints)).last().unwrap();
        assert!(standing_after(&joints, &skeleton, all).unwrap().is_none());
        for metres in [0.0, 0.05, 2.0, 5.0, all - 0.1] {
            let found = standing_after(&joints, &skeleton, metres).unwrap().unwrap();
            let (idle, from) = (found.joints, found.from);
            assert_eq!(idle.frames(), 100);
            let gone = walked(&ground(&idle));
            assert!((gone[99] - metres).abs() < 0.01, "{metres}: {}", gone[99]);
            for t in from..100 {
                let apart = idle.frame(t).iter().zip(idle.frame(99));
                let apart = apart.map(|(a, b)| length(minus(*a, *b)));
                assert!(apart.fold(0.0, f64::max) < 1e-9, "{metres}, frame {t}");
            }
            // Steps only become shorter.
            let steps: Vec<f64> = gone.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(
                steps.iter().all(|step| *step < 0.0605),
                "{metres}: {steps:?}"
            );
            for t in 0..100 {
                for (joint, parent) in skeleton.parents().iter().enumerate() {
                    let Some(parent) = *parent else { continue };
                    let bone = |joints: &Joints, t: usize| {
                        length(minus(joints.frame(t)[joint], joints.frame(t)[parent]))
                    };
                    assert!((bone(&idle, t) - bone(&joints, 0)).abs() < 1e-9);
                }
            }
        }
        // Without a change of speed until it slows down.
        let found = standing_after(&joints, &skeleton, 3.0).unwrap().unwrap();
        for t in 0..35 {
            assert_eq!(found.joints.frame(t), joints.frame(t), "{t}");
        }
        assert!((60..=61).contains(&found.from), "{}", found.from);
    }
}
