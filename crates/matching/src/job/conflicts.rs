//! Contradictory constraints.

use std::collections::HashMap;

use super::{Fixed, Job};
use crate::{Constraint, Error, Frames, Looping, MotionMatrix};

impl Job {
    /// Rejects contradictory `constraints` of a motion of `frames` frames, key frames first.
    pub(super) fn must_agree(
        &self,
        layout: &MotionMatrix,
        constraints: &[Constraint],
        frames: usize,
    ) -> Result<(), Error> {
        let is_loop = self.settings.looping != Looping::Off;
        if let Some(Fixed { part, motion }) = self.fixed.first().filter(|_| is_loop) {
            let problem =
                format!("`{part}` follows it, whose end need not lead into its beginning");
            let hint = "leave option `loop` or option `fix` out";
            return Err(Error::file(&motion.file, problem, hint));
        }
        let (keys, fixed) = constraints.split_at(self.keyframes.len());
        for (index, one) in fixed.iter().enumerate() {
            for (other, before) in fixed[..index].iter().zip(&self.fixed) {
                if let Some(channel) = contradiction(one, other) {
                    let own = &self.fixed[index];
                    let problem = format!(
                        "`{}` follows it, and {}, which is of `{}` too, follows {}",
                        own.part,
                        named(layout, channel),
                        before.part,
                        before.motion.file
                    );
                    let hint =
                        "give parts that share no joint; option `parts` divides the body otherwise";
                    return Err(Error::file(&own.motion.file, problem, hint));
                }
            }
        }
        let moment = |key: &Constraint| match key {
            Constraint::Keyframe { at, .. } => Constraint::frame(*at, frames),
            Constraint::Channels { .. } => 0,
        };
        for (index, key) in keys.iter().enumerate() {
            let keyframe = &self.keyframes[index].0;
            let time = keyframe.time;
            let refused = |problem, hint| Err(Error::file(keyframe.called(), problem, hint));
            for (fixed, own) in fixed.iter().zip(&self.fixed) {
                let (file, part) = (&own.motion.file, &own.part);
                if let Some(&(channel, _)) = shared(key, fixed).first() {
                    let name = named(layout, channel);
                    let problem = format!(
                        "at {time} s {name} has a pose, and follows {file} as part of `{part}`"
                    );
                    return refused(problem, "give the key frame a `part` that nothing fixes");
                }
                let root = layout.root_channels();
                if keyframe.place.is_some() && channels(fixed).iter().any(|c| root.contains(c)) {
                    let problem = format!(
                        "at {time} s the body has a place, and its root trajectory follows {file} as \
                         part of `{part}`"
                    );
                    let hint = "leave `place` out, or fix no part with the root trajectory";
                    return refused(problem, hint);
                }
            }
            let earlier = keys[..index].iter().zip(&self.keyframes);
            for (before, (other, _)) in earlier.filter(|(before, _)| moment(before) == moment(key))
            {
                let hint = "key frames of one moment have different parts, or lie a frame apart";
                if let Some(channel) = contradiction(key, before) {
                    let name = named(layout, channel);
                    return refused(format!("at {time} s {name} has two poses"), hint);
                }
                let places = (keyframe.place, other.place);
                if matches!(places, (Some(own), Some(other)) if own != other) {
                    return refused(format!("at {time} s the body has two places"), hint);
                }
            }
        }
        Ok(())
    }
}

/// Channels of both constraints, with their places in each.
fn shared(one: &Constraint, other: &Constraint) -> Vec<(usize, [usize; 2])> {
    let others = channels(other).iter().enumerate();
    let others: HashMap<usize, usize> = others.map(|(place, &channel)| (channel, place)).collect();
    let own = channels(one).iter().enumerate();
    let both = own.filter_map(|(place, channel)| Some((*channel, [place, *others.get(channel)?])));
    both.collect()
}

fn channels(constraint: &Constraint) -> &[usize] {
    match constraint {
        Constraint::Channels { channels, .. } | Constraint::Keyframe { channels, .. } => channels,
    }
}

/// A channel with different values in two constraints of one kind.
fn contradiction(one: &Constraint, other: &Constraint) -> Option<usize> {
    let values = |constraint: &Constraint, channel: usize, place: usize| match constraint {
        Constraint::Channels { motion, .. } => motion.columns(&[channel]),
        Constraint::Keyframe { source, from, .. } => {
            Frames::new(1, vec![source.frame(*from)[place]])
        }
    };
    let mut shared = shared(one, other).into_iter();
    let found = shared.find(|&(channel, [own, other_place])| {
        values(one, channel, own) != values(other, channel, other_place)
    });
    found.map(|(channel, _)| channel)
}

/// Name of the joint of a channel.
fn named(layout: &MotionMatrix, channel: usize) -> String {
    let mut joints = 0..layout.joints().len();
    match joints.find(|&joint| layout.channels_of(joint).contains(&channel)) {
        Some(joint) => format!("`{}`", layout.joints()[joint].name),
        None => "the root trajectory".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_matrix::tests::example;
    use crate::{Example, Keyframe};

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
        let placed = message(&job);
        assert!(
            placed.contains("the body has a place, and its root trajectory follows legs.bvh as part of `LeftLeg`"),
            "{placed}"
        );
        // Parts that share the hips agree if they are of one motion, and conflict otherwise.
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
