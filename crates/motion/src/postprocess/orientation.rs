//! Steps 2 and 3 of the post-processor: quaternions.

use super::{Frames, Hemisphere, PostProcessConfig, window};
use crate::Quaternion;
use crate::derivatives::make_sign_continuous;
use crate::phrase::{CHANNELS, QUATERNION};
use crate::vector::plus;

/// Brings every quaternion to unit norm and to one hemisphere.
pub(super) fn normalize(frames: &mut Frames, config: &PostProcessConfig) {
    let mut quaternions: Vec<Quaternion> = frames.iter().map(read).collect();
    finish(&mut quaternions, config);
    write(frames, &quaternions);
}

/// Replaces each quaternion by the normalized mean of a window around it, keeping the sign.
pub(super) fn smooth(frames: &mut Frames, config: &PostProcessConfig) {
    let size = config.quaternion_smoothing_window;
    let original: Vec<Quaternion> = frames.iter().map(read).collect();
    let mean = |t: usize| {
        let near = window(t, size, original.len()).map(|s| original[s].nearer_to(original[t]));
        let sum = near.fold([0.0; 4], |sum, near| plus(sum, near.parts()));
        Quaternion::from(sum).scale(1.0 / (2 * (size / 2) + 1) as f64)
    };
    let mut smoothed: Vec<Quaternion> = (0..original.len()).map(mean).collect();
    finish(&mut smoothed, config);
    write(frames, &smoothed);
}

/// Divides by the norm and picks the sign.
fn finish(quaternions: &mut [Quaternion], config: &PostProcessConfig) {
    let (hemisphere, eps) = (config.hemisphere, config.quaternion_eps);
    let mut previous = Quaternion::IDENTITY;
    for quaternion in quaternions.iter_mut() {
        let norm = quaternion.norm();
        *quaternion = match hemisphere {
            // CC-MotionGen leaves a vanishing quaternion short. Here the previous quaternion is
            // repeated.
            Hemisphere::Continuous if norm < eps => previous,
            _ => quaternion.scale(1.0 / norm.max(eps)),
        };
        if norm.is_finite() {
            previous = *quaternion;
        }
    }
    match hemisphere {
        Hemisphere::Continuous => make_sign_continuous(quaternions),
        Hemisphere::PositiveW => {
            for quaternion in quaternions.iter_mut().filter(|q| q.w < 0.0) {
                *quaternion = quaternion.scale(-1.0);
            }
        }
    }
}

fn read(frame: &[f64; CHANNELS]) -> Quaternion {
    Quaternion::from([0, 1, 2, 3].map(|part| frame[QUATERNION.start + part]))
}

fn write(frames: &mut Frames, quaternions: &[Quaternion]) {
    for (frame, quaternion) in frames.iter_mut().zip(quaternions) {
        frame[QUATERNION].copy_from_slice(&quaternion.parts());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body that turns about +y in steps of 0.1 rad, through w = 0. Signs alternate; norms are 2.
    fn turning() -> Frames {
        let mut frames = vec![[0.0; CHANNELS]; 80];
        let sign = |t: usize| if t.is_multiple_of(2) { 2.0 } else { -2.0 };
        let quaternions: Vec<Quaternion> = (0..80)
            .map(|t| Quaternion::from_yaw(0.1 * t as f64).scale(sign(t)))
            .collect();
        write(&mut frames, &quaternions);
        frames
    }

    fn smallest_dot(frames: &Frames) -> f64 {
        let dots = frames
            .windows(2)
            .map(|pair| read(&pair[0]).dot(read(&pair[1])));
        dots.fold(f64::INFINITY, f64::min)
    }

    fn of(hemisphere: Hemisphere) -> PostProcessConfig {
        PostProcessConfig {
            hemisphere,
            ..PostProcessConfig::default()
        }
    }

    #[test]
    fn continuous_signs_survive_the_passage_through_zero() {
        let mut frames = turning();
        normalize(&mut frames, &of(Hemisphere::Continuous));
        assert!(smallest_dot(&frames) > 0.99);
        assert!(frames.iter().any(|frame| read(frame).w < 0.0));
        assert!(
            frames
                .iter()
                .all(|frame| (read(frame).norm() - 1.0).abs() < 1e-12)
        );
    }

    #[test]
    fn positive_w_jumps_there() {
        let mut frames = turning();
        normalize(&mut frames, &of(Hemisphere::PositiveW));
        assert!(smallest_dot(&frames) < -0.99);
        assert!(frames.iter().all(|frame| read(frame).w >= 0.0));
    }

    #[test]
    fn smoothing_does_not_depend_on_signs_and_keeps_a_constant_turn() {
        for hemisphere in [Hemisphere::Continuous, Hemisphere::PositiveW] {
            let (mut smoothed, mut plain) = (turning(), turning());
            smooth(&mut smoothed, &of(hemisphere));
            normalize(&mut plain, &of(hemisphere));
            // The mean of a symmetric neighborhood on the arc is its center.
            for t in 2..78 {
                assert!(
                    read(&smoothed[t]).dot(read(&plain[t])).abs() > 1.0 - 1e-12,
                    "{t}"
                );
            }
            // At the end the window repeats the first frame: (3 * 0 + 0.1 + 0.2) / 5 rad.
            assert!((read(&smoothed[0]).yaw() - 0.06).abs() < 1e-3);
        }
    }
}
