//! Contradictory constraints.

use super::Job;
use crate::{Constraint, Error, Looping, MotionMatrix};

impl Job {
    /// Rejects contradictory constraints. `constraints` of the motion of `frames` frames: key
    /// frames first, in the order of the job.
    pub(super) fn must_agree(
        &self,
        layout: &MotionMatrix,
        constraints: &[Constraint],
        frames: usize,
    ) -> Result<(), Error> {
        if let (Looping::Even | Looping::Halves, Some(fixed)) =
            (self.settings.looping, self.fixed.first())
        {
            let problem = format!(
                "`{}` follows it, whose end need not lead into its beginning",
                fixed.part
            );
            let hint = "leave option `loop` or option `fix` out";
            return Err(Error::file(&fixed.motion.file, problem, hint));
        }
        let (keys, fixed) = constraints.split_at(self.keyframes.len());
        for (index, one) in fixed.iter().enumerate() {
            for (place, other) in fixed[..index].iter().enumerate() {
                let (
                    Constraint::Channels { motion, .. },
                    Constraint::Channels { motion: others, .. },
                ) = (one, other)
                else {
                    continue;
                };
                let shared = shared(one, other);
                let differs =
                    |channel: &&usize| motion.columns(&[**channel]) != others.columns(&[**channel]);
                if let Some(&channel) = shared.iter().find(differs) {
                    let (part, before) = (&self.fixed[index].part, &self.fixed[place].part);
                    let problem = format!(
                        "`{part}` follows it, and {}, which is of `{before}` too, follows {}",
                        named(layout, channel),
                        self.fixed[place].motion.file
                    );
                    let hint =
                        "give parts that share no joint; option `parts` divides the body otherwise";
                    return Err(Error::file(&self.fixed[index].motion.file, problem, hint));
                }
            }
        }
        let moment = |constraint: &Constraint| match constraint {
            Constraint::Keyframe { at, .. } => Constraint::frame(*at, frames),
            Constraint::Channels { .. } => 0,
        };
        for (index, key) in keys.iter().enumerate() {
            let time = self.keyframes[index].0.time;
            for (fixed, own) in fixed.iter().zip(&self.fixed) {
                if let Some(&channel) = shared(key, fixed).first() {
                    let problem = format!(
                        "at {time} s {} has a pose, and follows {} as part of `{}`",
                        named(layout, channel),
                        own.motion.file,
                        own.part
                    );
                    let hint = "give the key frame a `part` that nothing fixes";
                    return Err(Error::file(self.keyframes[index].0.called(), problem, hint));
                }
                let trajectory = layout.root_channels();
                if self.keyframes[index].0.place.is_some()
                    && channels(fixed)
                        .iter()
                        .any(|channel| trajectory.contains(channel))
                {
                    let problem = format!(
                        "at {time} s the body has a place, and its root trajectory follows {} as part of `{}`",
                        own.motion.file, own.part
                    );
                    let hint = "leave `place` out, or fix no part with the root trajectory";
                    return Err(Error::file(self.keyframes[index].0.called(), problem, hint));
                }
            }
            for (place, before) in keys[..index].iter().enumerate() {
                if moment(before) != moment(key) {
                    continue;
                }
                let hint = "key frames of one moment have different parts, or lie a frame apart";
                let [own, other] = [index, place].map(|index| &self.keyframes[index].0);
                if let Some(channel) = contradiction(key, before) {
                    let problem = format!("at {time} s {} has two poses", named(layout, channel));
                    return Err(Error::file(self.keyframes[index].0.called(), problem, hint));
                }
                if own.place.is_some() && other.place.is_some() && own.place != other.place {
                    let problem = format!("at {time} s the body has two places");
                    return Err(Error::file(self.keyframes[index].0.called(), problem, hint));
                }
            }
        }
        Ok(())
    }
}

/// Channels of both constraints.
fn shared(one: &Constraint, other: &Constraint) -> Vec<usize> {
    let others = channels(other);
    let own = channels(one).iter().copied();
    own.filter(|channel| others.contains(channel)).collect()
}

fn channels(constraint: &Constraint) -> &[usize] {
    match constraint {
        Constraint::Channels { channels, .. } | Constraint::Keyframe { channels, .. } => channels,
    }
}

/// A channel with different values in two key frames.
fn contradiction(one: &Constraint, other: &Constraint) -> Option<usize> {
    let value = |constraint: &Constraint, wanted: usize| match constraint {
        Constraint::Keyframe {
            channels,
            source,
            from,
            ..
        } => {
            let place = channels.iter().position(|&channel| channel == wanted)?;
            Some(source.frame(*from)[place])
        }
        Constraint::Channels { .. } => None,
    };
    let mut shared = shared(one, other).into_iter();
    shared.find(|&channel| value(one, channel) != value(other, channel))
}

/// Name of the joint of a channel.
fn named(layout: &MotionMatrix, channel: usize) -> String {
    let joints = 0..layout.joints().len();
    let mut of = joints.filter(|&joint| layout.channels_of(joint).contains(&channel));
    match of.next() {
        Some(joint) => format!("`{}`", layout.joints()[joint].name),
        None => "the root trajectory".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_matrix::tests::example;
    use crate::{Example, Fixed, Keyframe};

    fn walk(file: &str, frames: usize) -> Example {
        example(file, frames, 1.0 / 30.0)
    }

    fn message(job: &Job) -> String {
        job.make(&[walk("walk.bvh", 70)]).unwrap_err().to_string()
    }

    fn key(source_time: f64, part: Option<&str>, place: Option<[f64; 2]>) -> Keyframe {
        Keyframe {
            time: 1.0,
            source_time,
            file: None,
            part: part.map(str::to_string),
            place,
            reach: None,
            name: String::new(),
        }
    }

    #[test]
    fn contradictions_are_refused() {
        let fixed = |part: &str, motion: Example| Fixed {
            part: part.to_string(),
            motion,
        };
        let legs = walk("legs.bvh", 64);
        let mut job = Job {
            fixed: vec![fixed("LeftLeg", legs.clone())],
            keyframes: vec![(key(0.5, None, None), None)],
            ..Job::default()
        };
        let missed = message(&job);
        assert!(
            missed.contains("key frame: at 1 s `Hips` has a pose, and follows legs.bvh"),
            "{missed}"
        );
        job.keyframes[0].0.part = Some("RightFoot".to_string());
        job.make(&[walk("walk.bvh", 70)]).unwrap();
        job.keyframes[0].0.place = Some([1.0, 2.0]);
        let led = message(&job);
        assert!(
            led.contains("the body has a place, and its root trajectory follows legs.bvh as part of `LeftLeg`"),
            "{led}"
        );
        // Parts that share the hips of one motion agree, of two they do not.
        job.fixed.push(fixed("RightLeg", legs.clone()));
        job.keyframes.clear();
        job.make(&[walk("walk.bvh", 70)]).unwrap();
        let mut other = walk("other.bvh", 128);
        other.bvh = other
            .bvh
            .reposed(
                1.0 / 30.0,
                &(64..128)
                    .flat_map(|t| other.bvh.locals(t))
                    .collect::<Vec<_>>(),
            )
            .unwrap();
        job.fixed[1].motion = other;
        let two = message(&job);
        assert!(
            two.starts_with("other.bvh: `RightLeg` follows it, and `Hips`"),
            "{two}"
        );
        job.fixed.truncate(1);
        job.settings.looping = Looping::Even;
        let loops = message(&job);
        assert!(
            loops.contains("need not lead into its beginning"),
            "{loops}"
        );
    }

    #[test]
    fn key_frames_of_one_moment_must_agree() {
        let of = |one: Keyframe, two: Keyframe| Job {
            keyframes: vec![(one, None), (two, None)],
            ..Job::default()
        };
        let poses = message(&of(key(0.5, None, None), key(0.9, Some("LeftLeg"), None)));
        assert!(poses.contains("has two poses"), "{poses}");
        let places = [Some([1.0, 2.0]), Some([2.0, 2.0])];
        let two = message(&of(key(0.5, None, places[0]), key(0.5, None, places[1])));
        assert!(two.contains("at 1 s the body has two places"), "{two}");
        let apart = of(
            key(0.5, Some("LeftFoot"), None),
            key(0.9, Some("RightFoot"), None),
        );
        apart.make(&[walk("walk.bvh", 70)]).unwrap();
    }
}
