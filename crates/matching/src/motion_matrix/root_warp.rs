//! Root trajectories warped through places.

use kinegrad_motion::banded::Cholesky;

use super::MotionMatrix;
use crate::Frames;
use crate::smoothing::THIRD;

/// Seconds over which a change of speed is spread.
const FADE: f64 = 0.25;

/// Weight of the first-order term in the banded system, relative to the weight of the step: the
/// correction returns to the straight line within a second or two.
const NEAR: f64 = 1e-3;

impl MotionMatrix {
    /// Warps a root trajectory through the place of each of `points` (horizontal, file units) at
    /// frame `t` of the point. The first frame is fixed ([`start_at`](Self::start_at) moves it);
    /// frames after the last point move with that point.
    ///
    /// The offsets x minimise
    ///
    /// ```text
    /// sum over t of (x[t+1] - x[t])^2 / fade^4 + sum over t of (x[t+3] - 3 x[t+2] + 3 x[t+1] - x[t])^2
    /// ```
    ///
    /// subject to the points. The first term evens the speed between points; the second, the jerk,
    /// spreads changes of speed over a quarter of a second, or half the time between close points.
    /// `is_loop`: the last frame is followed by the first; the steps around the seam do not change.
    pub(crate) fn warp_root(
        &self,
        frames: &mut Frames,
        points: &[(usize, [f64; 2])],
        is_loop: bool,
    ) {
        let mut points: Vec<_> = points.iter().filter(|(t, _)| *t > 0).copied().collect();
        points.sort_by_key(|(t, _)| *t);
        points.dedup_by_key(|(t, _)| *t);
        if points.is_empty() {
            return;
        }
        let axes: Vec<usize> = (0..3).filter(|&axis| axis != self.up as usize).collect();
        let trajectory = self.root_trajectory(frames);
        let fade = FADE / self.frame_time;
        let moved = axes.iter().enumerate().map(|(place, &axis)| {
            let missed = points.iter().map(|&(t, wanted)| {
                let missed = wanted[place] - self.base[axis] - trajectory[t].0[axis];
                (t, missed * self.scale)
            });
            offsets(frames.frames(), &missed.collect::<Vec<_>>(), fade, is_loop)
        });
        let moved: Vec<Vec<f64>> = moved.collect();
        let first = self.channels() - 3;
        for (t, (_, heading)) in trajectory.iter().enumerate().skip(1) {
            let mut step = [0.0; 3];
            for (&axis, moved) in axes.iter().zip(&moved) {
                step[axis] = moved[t] - moved[t - 1];
            }
            let step = self.heading_rotation(-heading).rotate(step);
            for &axis in &axes {
                frames.frame_mut(t)[first + axis] += step[axis] as f32;
            }
        }
    }
}

/// The offset of each of `n` frames, where the frames of `points` (sorted, after the first frame)
/// have fixed offsets.
fn offsets(n: usize, points: &[(usize, f64)], fade: f64, is_loop: bool) -> Vec<f64> {
    let last = points.last().map_or(0, |(t, _)| *t);
    let mut knots = vec![(0, 0.0)];
    if is_loop {
        // The steps before and after the seam.
        let free = |t: usize| t < n && points.iter().all(|(point, _)| t < *point);
        knots.extend([1, 2].into_iter().filter(|&t| free(t)).map(|t| (t, 0.0)));
    }
    knots.extend_from_slice(points);
    if is_loop {
        let end = knots[knots.len() - 1].1;
        let ends = n.saturating_sub(3).max(last + 1)..n;
        knots.extend(ends.map(|t| (t, end)));
    }
    let even = linear(n, &knots);
    let slow = step_weights(n, points, fade);
    let diagonal = slow.iter().map(|slow| [NEAR * slow, 0.0, 0.0, 0.0]);
    let mut matrix: Vec<[f64; 4]> = diagonal.collect();
    let mut bend = vec![0.0; n];
    let mut add = |from: usize, weights: &[f64], strength: f64| {
        let pairs = weights.iter().zip(&even[from..]);
        let value: f64 = pairs.map(|(weight, x)| weight * x).sum();
        for (a, one) in weights.iter().enumerate() {
            for (b, other) in weights.iter().enumerate().take(a + 1) {
                matrix[from + a][a - b] += strength * one * other;
            }
            bend[from + a] -= strength * one * value;
        }
    };
    (1..n).for_each(|t| add(t - 1, &[-1.0, 1.0], slow[t]));
    (3..n).for_each(|t| add(t - 3, &THIRD, 1.0));
    for &(t, _) in &knots {
        matrix[t] = [1.0, 0.0, 0.0, 0.0];
        for (below, row) in matrix[t + 1..].iter_mut().take(3).enumerate() {
            row[below + 1] = 0.0;
        }
        bend[t] = 0.0;
    }
    Cholesky::new(matrix).solve(&mut bend);
    let offsets = even.iter().zip(bend).map(|(even, bend)| even + bend);
    offsets.collect()
}

/// The weight of the squared step to each frame. A change of speed that takes longer than the time
/// to the next point would overshoot, so changes are quicker near close points.
fn step_weights(n: usize, points: &[(usize, f64)], fade: f64) -> Vec<f64> {
    let mut times = vec![0];
    times.extend(points.iter().map(|(t, _)| *t));
    let gaps: Vec<usize> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut weights = Vec::with_capacity(n);
    for (place, &from) in times.iter().enumerate() {
        let to = times.get(place + 1).copied().unwrap_or(n - 1);
        let around = place.saturating_sub(1)..(place + 2).min(gaps.len());
        let least = gaps[around].iter().min();
        let least = least.map_or(fade, |gap| *gap as f64 / 2.0);
        let weight = fade.min(least).max(1.0).powi(-4);
        weights.resize(if place == 0 { 1 } else { from + 1 }, weight);
        weights.resize(to + 1, weight);
    }
    weights
}

/// Linear interpolation between knots, from frame 0 on, constant after the last.
fn linear(n: usize, knots: &[(usize, f64)]) -> Vec<f64> {
    let mut values = vec![knots[knots.len() - 1].1; n];
    for pair in knots.windows(2) {
        let [(from, begin), (to, end)] = [pair[0], pair[1]];
        for (t, value) in values[from..to].iter_mut().enumerate() {
            *value = begin + (end - begin) * t as f64 / (to - from) as f64;
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: f64 = FADE * 30.0;

    fn jerk(moved: &[f64]) -> f64 {
        let thirds = moved.windows(4).map(|x| {
            let pairs = THIRD.iter().zip(x);
            pairs.map(|(weight, x)| weight * x).sum::<f64>().abs()
        });
        thirds.fold(0.0, f64::max) * 27_000.0
    }

    /// Overshoot beyond the points, as a part of their range.
    fn beyond(moved: &[f64], points: &[(usize, f64)]) -> f64 {
        let values = points.iter().map(|(_, value)| *value);
        let low = values.clone().fold(0.0, f64::min);
        let high = values.fold(0.0, f64::max);
        let outside = moved.iter().map(|x| (x - high).max(low - x));
        outside.fold(0.0, f64::max) / (high - low).max(1e-9)
    }

    #[test]
    fn places_are_exact_and_the_trajectory_does_not_overshoot() {
        let cases: [&[(usize, f64)]; 8] = [
            &[(15, 0.3)],
            &[(6, 0.3)],
            &[(6, 0.1), (12, 0.3)],
            &[(2, 0.3)],
            &[(30, 0.0), (60, 1.0), (90, 0.0)],
            &[(100, 0.0), (101, 0.05)],
            &[(75, 0.3), (90, -0.3)],
            &[(298, 0.2)],
        ];
        for points in cases {
            for is_loop in [false, true] {
                let mut points = points.to_vec();
                if is_loop {
                    points[0].1 = 0.0; // A loop starts so that its first place is passed.
                }
                let points = &points[..];
                let moved = offsets(300, points, FRAMES, is_loop);
                assert_eq!(moved[0], 0.0);
                for &(t, value) in points {
                    assert_eq!(moved[t], value, "{points:?}");
                }
                let beyond = beyond(&moved, points);
                assert!(beyond < 1.0, "{points:?} {is_loop}: {beyond}");
                let end = points[points.len() - 1];
                if end.0 < 200 {
                    assert!((moved[299] - end.1).abs() < 1e-3, "{points:?} {is_loop}");
                }
                if is_loop && (3..290).contains(&points[0].0) {
                    assert_eq!((moved[1], moved[2]), (0.0, 0.0), "{points:?}");
                    assert_eq!(moved[298], moved[299]);
                }
            }
        }
    }

    #[test]
    fn offsets_have_little_jerk() {
        // A move of 0.3 m from rest to rest within half a second takes 140 m/s^3.
        let alone = offsets(300, &[(15, 0.3)], FRAMES, false);
        assert!(jerk(&alone) < 30.0, "{}", jerk(&alone));
        let far = offsets(300, &[(120, 1.0)], FRAMES, false);
        assert!(jerk(&far) < 15.0, "{}", jerk(&far));
        assert!(beyond(&far, &[(120, 1.0)]) < 0.05);
        // Two close places later on change nothing.
        let points = [(150, 2.0), (300, -1.0), (420, -1.0), (422, -1.0)];
        let beside = offsets(500, &points, FRAMES, false);
        assert!(jerk(&beside) < 15.0, "{}", jerk(&beside));
    }

    #[test]
    fn short_and_long_motions_and_places_in_all_frames_are_warped() {
        for n in [2, 3, 4, 5] {
            for is_loop in [false, true] {
                let found = offsets(n, &[(n - 1, 2.0)], FRAMES, is_loop);
                assert_eq!(found[n - 1], 2.0, "{n}");
                assert!(found.iter().all(|x| x.is_finite()));
            }
        }
        for fade in [1e-80, 0.1, FRAMES, 15.0] {
            let all: Vec<(usize, f64)> = (1..40).map(|t| (t, (t as f64).sin())).collect();
            let found = offsets(40, &all, fade, false);
            assert!(all.iter().all(|&(t, value)| found[t] == value));
        }
        let found = offsets(200_000, &[(50, 1.0), (180_000, -5.0)], 15.0, false);
        assert!(found.iter().all(|x| x.is_finite()));
        assert!(
            (found[199_999] + 5.0).abs() < 1e-3
                && beyond(&found, &[(50, 1.0), (180_000, -5.0)]) < 0.1
        );
    }
}
