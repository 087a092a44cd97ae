//! Phrases: the 25 channels of CC-MotionGen.

use super::{Curves, Representation, root_mean_square};
use crate::derivatives::{angular_rates, differences, jerk, jerk_of, mean_jerk_norm};
use crate::humanml::Joints;
use crate::phrase::{ACCELERATION, ANGULAR_VELOCITY, PHASE, POSITION, QUATERNION, STYLE, VELOCITY};
use crate::vector::length;
use crate::{
    CHANNELS, ChannelEncoding, ChannelMoments, FPS, MotionMeasure, Phrase, Profile, Quaternion,
    Report, Statistics, channel_name, sanity,
};

/// Phrases, `[frames, 25]` at 30 frames per second (docs/sources.md, section 1.1).
#[derive(Clone, Copy, Debug)]
pub struct Phrases;

/// The statistics of finite phrases; `None` without phrases.
pub fn phrase_statistics<'a>(phrases: impl IntoIterator<Item = &'a Phrase>) -> Option<Statistics> {
    super::statistics_of(&Phrases, phrases.into_iter().map(Phrase::as_slice))
}

fn motion(rows: &[f32]) -> Phrase {
    Phrase::new(rows.to_vec()).expect("whole frames of 25 channels")
}

impl Representation for Phrases {
    fn name(&self) -> String {
        "phrase".to_owned()
    }

    fn channels(&self) -> usize {
        CHANNELS
    }

    fn fps(&self) -> f64 {
        FPS
    }

    fn channel_name(&self, channel: usize) -> String {
        channel_name(channel)
    }

    fn statistics(&self, moments: ChannelMoments) -> Statistics {
        Statistics {
            rms_speed: Some(root_mean_square(&moments, VELOCITY)),
            rms_acceleration: Some(root_mean_square(&moments, ACCELERATION)),
            ..ChannelEncoding::default().statistics(moments)
        }
    }

    fn mean_jerk(&self, rows: &[f32]) -> f64 {
        mean_jerk_norm(&motion(rows))
    }

    fn movement(&self, rows: &[f32]) -> Vec<(&'static str, f64)> {
        let motion = motion(rows);
        let of = |measure: MotionMeasure| Some((measure.name(), measure.of(&motion)?));
        MotionMeasure::ALL.into_iter().filter_map(of).collect()
    }

    /// The root alone.
    fn joints(&self, rows: &[f32]) -> Option<Joints> {
        Joints::new(motion(rows).vectors(POSITION), 1).ok()
    }

    fn check(&self, rows: &[f32], profile: Profile, statistics: Option<&Statistics>) -> Report {
        sanity::check(&motion(rows), profile, statistics)
    }

    fn curves(&self, rows: &[f32]) -> Vec<Curves> {
        let motion = motion(rows);
        let channels =
            |title, range, names: &[&str]| Curves::channels(title, rows, CHANNELS, range, names);
        let norms = motion.quaternions().into_iter().map(Quaternion::norm);
        // Channels and derivatives of the poses.
        let sizes = |channels: Vec<[f64; 3]>| channels.into_iter().map(length).collect();
        let twice = |title, channels: Vec<[f64; 3]>, poses: Vec<[f64; 3]>| {
            let series = [("channels", channels), ("poses", poses)];
            let series = series.map(|(name, vectors)| (name.to_owned(), sizes(vectors)));
            Curves::new(title, series.to_vec())
        };
        let vectors = |channels| motion.vectors(channels);
        let turns = vectors(ANGULAR_VELOCITY);
        let path = differences(&vectors(POSITION), FPS);
        let bends = jerk_of(&vectors(POSITION), FPS);
        let xyz = ["x", "y", "z"];
        vec![
            channels("position (m)", POSITION, &xyz),
            channels("velocity (m/s)", VELOCITY, &xyz),
            channels("acceleration (m/s²)", ACCELERATION, &xyz),
            channels("quaternion", QUATERNION, &["w", "x", "y", "z"]),
            channels("angular velocity (rad/s)", ANGULAR_VELOCITY, &xyz),
            channels("phase", PHASE..PHASE + 1, &["phase"]).bounded_by("phase"),
            channels("style", STYLE, &["0", "1", "2", "3", "4", "5", "6", "7"]),
            Curves::new("quaternion norm", vec![("|q|".into(), norms.collect())])
                .bounded_by("quaternion"),
            twice("speed (m/s)", vectors(VELOCITY), path),
            twice("jerk (m/s³)", jerk(&motion), bends).bounded_by("jerk"),
            twice("turn rate (rad/s)", turns, angular_rates(&motion)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_phrase::random_phrase;

    #[test]
    fn quaternions_stay_and_the_phase_is_centred() {
        let phrases: Vec<Phrase> = (0..5).map(|seed| random_phrase(seed, 20)).collect();
        let statistics = phrase_statistics(&phrases).unwrap();
        assert_eq!((statistics.items, statistics.frames), (5, 100));
        for phrase in &phrases {
            let normalized = statistics.normalize(phrase.as_slice());
            let seen = Phrase::from_channel_major(&normalized, 20).unwrap();
            for t in 0..20 {
                assert_eq!(phrase.frame(t)[QUATERNION], seen.frame(t)[QUATERNION]);
                assert_eq!(seen.frame(t)[PHASE], 2.0 * phrase.frame(t)[PHASE] - 1.0);
            }
        }
    }

    #[test]
    fn curves_show_poses_beside_channels() {
        let mut motion = random_phrase(3, 40);
        motion.set_vector(20, POSITION, motion.vector(20, POSITION).map(|x| x + 0.05));
        let curves = Phrases.curves(motion.as_slice());
        let largest = |title: &str, series: usize| {
            let found = curves.iter().find(|curves| curves.title == title).unwrap();
            let values = found.series[series].1.iter().copied();
            values.fold(0.0, f64::max)
        };
        assert!(largest("jerk (m/s³)", 1) > 5.0 * largest("jerk (m/s³)", 0));
        assert!(largest("speed (m/s)", 1) > 1.2 * largest("speed (m/s)", 0));
        let turns = [0, 1].map(|series| largest("turn rate (rad/s)", series));
        assert!((turns[0] - turns[1]).abs() < 1e-4, "{turns:?}");
    }

    #[test]
    fn scales_of_real_motion_are_those_of_the_vectors() {
        let mut motion = Phrase::new(vec![0.0; 4 * CHANNELS]).unwrap();
        for (t, speed) in [1.0, 1.0, 5.0, 5.0].into_iter().enumerate() {
            motion.set_vector(t, VELOCITY, [0.6 * speed, 0.0, -0.8 * speed]);
            motion.set_vector(t, ACCELERATION, [0.0, 2.0 * t as f64, 0.0]);
        }
        let statistics = phrase_statistics([&motion]).unwrap();
        assert!((statistics.rms_speed.unwrap() - 13.0f64.sqrt()).abs() < 1e-6);
        assert!((statistics.rms_acceleration.unwrap() - 14.0f64.sqrt()).abs() < 1e-12);
        assert_eq!(statistics.jerk_p95, Some(60.0));
    }
}
