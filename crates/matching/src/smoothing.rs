//! Smoothing with a strength for each frame.

use kinegrad_motion::banded::Cholesky;

use crate::{Constraint, Frames};

/// Coefficients of a third difference.
pub(crate) const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
/// Weight of a frame that must keep its values; others have 1.
const FIXED: f64 = 1e9;

/// Replaces every channel x by the y that minimises
///
/// ```text
/// sum over t of (y[t] - x[t])^2 + sum over t of strength[t] (y[t+3] - 3 y[t+2] + 3 y[t+1] - y[t])^2
/// ```
///
/// where y equals x in key frames. Fixed channels, and frames that no strength above 0 reaches, do
/// not change.
pub(crate) fn smooth(frames: &mut Frames, strength: &[f64], constraints: &[Constraint]) {
    let n = frames.frames();
    assert!(
        strength.len() + 3 == n,
        "a strength for each third difference"
    );
    let active = |t: &usize| strength[*t] > 0.0;
    let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
    for t in (0..strength.len()).filter(active) {
        match runs.last_mut() {
            Some(run) if t < run.end => run.end = t + 4,
            _ => runs.push(t..t + 4),
        }
    }
    let mut follows = vec![false; frames.channels()];
    let mut key_frames: Vec<Vec<usize>> = vec![Vec::new(); frames.channels()];
    for constraint in constraints {
        match constraint {
            Constraint::Channels { channels, .. } => {
                channels.iter().for_each(|&channel| follows[channel] = true);
            }
            Constraint::Keyframe { at, channels, .. } => {
                for &channel in channels {
                    key_frames[channel].push(Constraint::frame(*at, n));
                }
            }
        }
    }
    for run in runs {
        let strength = &strength[run.start..run.end - 3];
        for channel in (0..frames.channels()).filter(|&channel| !follows[channel]) {
            let fixed = key_frames[channel].iter().filter(|&t| run.contains(t));
            let fixed: Vec<usize> = fixed.map(|t| t - run.start).collect();
            let course = run.clone().map(|t| f64::from(frames.frame(t)[channel]));
            let smoothed = smoothed(&course.collect::<Vec<_>>(), strength, &fixed);
            for (t, value) in run.clone().zip(smoothed) {
                if !fixed.contains(&(t - run.start)) {
                    frames.frame_mut(t)[channel] = value as f32;
                }
            }
        }
    }
}

fn smoothed(course: &[f64], strength: &[f64], fixed: &[usize]) -> Vec<f64> {
    let weight = |t: usize| if fixed.contains(&t) { FIXED } else { 1.0 };
    let diagonal = (0..course.len()).map(|t| [weight(t), 0.0, 0.0, 0.0]);
    let mut matrix: Vec<[f64; 4]> = diagonal.collect();
    for (t, strength) in strength.iter().enumerate() {
        for a in 0..4 {
            for b in 0..=a {
                matrix[t + a][a - b] += strength * THIRD[a] * THIRD[b];
            }
        }
    }
    let weighted = course.iter().enumerate().map(|(t, x)| weight(t) * x);
    let mut solution: Vec<f64> = weighted.collect();
    Cholesky::new(matrix).solve(&mut solution);
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    fn third(frames: &Frames, channel: usize, t: usize) -> f32 {
        (0..4)
            .map(|k| THIRD[k] as f32 * frames.frame(t + k)[channel])
            .sum()
    }

    #[test]
    fn smoothing_keeps_constraints() {
        let wild = |t: usize| (t as f32 * 2.3).sin();
        let values = (0..40).flat_map(|t| [wild(t), wild(t + 7)]);
        let before = Frames::new(2, values.collect());
        let source = before.columns(&[0]);
        let key_frame = Constraint::Keyframe {
            at: 20.5 / 40.0,
            channels: vec![0],
            source,
            from: 20,
            frames: 40,
            reach: 5,
        };
        let mut after = before.clone();
        let mut strength = vec![0.0; 37];
        strength[10..30].fill(100.0);
        smooth(&mut after, &strength, &[key_frame]);
        assert_eq!(after.frame(20)[0], before.frame(20)[0]);
        assert_ne!(after.frame(20)[1], before.frame(20)[1]);
        for t in (0..10).chain(33..40) {
            assert_eq!(after.frame(t), before.frame(t), "{t}");
        }
        for channel in 0..2 {
            let size = |frames: &Frames| -> f32 {
                (10..30).map(|t| third(frames, channel, t).abs()).sum()
            };
            assert!(size(&after) < 0.2 * size(&before));
        }
        let mut followed = before.clone();
        let follows = Constraint::Channels {
            channels: vec![1],
            motion: before.clone(),
        };
        smooth(&mut followed, &strength, &[follows]);
        assert_eq!(followed.columns(&[1]), before.columns(&[1]));
        assert_ne!(followed.columns(&[0]), before.columns(&[0]));
    }

    #[test]
    fn a_parabola_stays_one() {
        let values = (0..30).map(|t| 0.01 * (t * t) as f32 - 0.2 * t as f32);
        let before = Frames::new(1, values.collect());
        let mut after = before.clone();
        smooth(&mut after, &[50.0; 27], &[]);
        for t in 0..30 {
            assert!((after.frame(t)[0] - before.frame(t)[0]).abs() < 1e-5);
        }
    }
}
