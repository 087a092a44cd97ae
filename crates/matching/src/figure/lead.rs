//! A way that passes given places.

use kinegrad_motion::banded::{BAND, Cholesky};
use nalgebra::{DMatrix, DVector};

use super::Figure;
use crate::Frames;

/// Seconds over which what a place changes of the speed fades.
const FADE: f64 = 1.0;

/// Weight of a step that must stay as it is, beside that of a change of the steps' differences.
const KEPT: f64 = 1e6;

impl Figure {
    /// Bends the way of a motion, so that at frame `t` it is at `place` on the two axes that do not
    /// point up, in the file's units, for each of `points`. The first frame stays where it is
    /// ([`start_at`](Self::start_at) says otherwise).
    ///
    /// What the steps `u` from frame to frame change by is the least
    ///
    /// ```text
    /// sum over t of u[t]^2 / fade^4 + sum over t of (u[t+1] - 2 u[t] + u[t-1])^2
    /// ```
    ///
    /// of which the sums up to the points are what the way misses them by: the second term is the
    /// jerk, the first has the change fade within a second before and behind the points. `around`: the
    /// last frame is followed by the first, where the steps stay as they are.
    pub(crate) fn lead(&self, frames: &mut Frames, points: &[(usize, [f64; 2])], around: bool) {
        let mut points: Vec<_> = points.iter().filter(|(t, _)| *t > 0).copied().collect();
        points.sort_by_key(|(t, _)| *t);
        points.dedup_by_key(|(t, _)| *t);
        if points.is_empty() {
            return;
        }
        let axes = (0..3).filter(|&axis| axis != self.up as usize);
        let axes: Vec<usize> = axes.collect();
        let way = self.way_of(frames);
        let missed = axes.iter().enumerate().map(|(place, &axis)| {
            let missed = points.iter().map(|(t, wanted)| {
                (wanted[place] - self.base[axis] - way[*t].0[axis]) * self.scale
            });
            missed.collect()
        });
        let ends: Vec<usize> = points.iter().map(|(t, _)| *t).collect();
        let fade = FADE / self.frame_time;
        let steps: Vec<Vec<f64>> = steps(frames.frames(), &ends, missed.collect(), fade, around);
        let first = self.channels() - 3;
        for (t, (_, heading)) in way.iter().enumerate().skip(1) {
            let mut step = [0.0; 3];
            for (&axis, steps) in axes.iter().zip(&steps) {
                step[axis] = steps[t - 1];
            }
            let moved = self.turned(-heading).rotate(step);
            for &axis in &axes {
                frames.frame_mut(t)[first + axis] += moved[axis] as f32;
            }
        }
    }
}

/// Changes of the steps that lead to frames 1 to `n - 1`, for each list of what frames `ends`, in
/// order, are moved by.
fn steps(n: usize, ends: &[usize], moved: Vec<Vec<f64>>, fade: f64, around: bool) -> Vec<Vec<f64>> {
    let count = n - 1;
    let mut matrix = vec![[fade.powi(-4), 0.0, 0.0]; count];
    let second = [1.0, -2.0, 1.0];
    for t in 0..count.saturating_sub(BAND - 1) {
        for a in 0..BAND {
            for b in 0..=a {
                matrix[t + a][a - b] += second[a] * second[b];
            }
        }
    }
    if around {
        for step in [0, 1, count - 1, count.saturating_sub(2)] {
            matrix[step.min(count - 1)][0] += KEPT;
        }
    }
    let factor = Cholesky::new(matrix);
    let mut begin = 0;
    // What a unit force along the steps between two points does to all of them.
    let responses = ends.iter().map(|&end| {
        let mut response = vec![0.0; count];
        response[begin..end].fill(1.0);
        begin = end;
        factor.solve(&mut response);
        response
    });
    let responses: Vec<Vec<f64>> = responses.collect();
    let between = |response: &[f64], point: usize| -> f64 {
        let begin = point.checked_sub(1).map_or(0, |before| ends[before]);
        response[begin..ends[point]].iter().sum()
    };
    let points = ends.len();
    let gram = DMatrix::from_fn(points, points, |i, j| between(&responses[j], i));
    let gram = gram.cholesky().expect("a positive definite matrix");
    let forced = moved.into_iter().map(|moved| {
        let whole = |point: usize| {
            let before = point.checked_sub(1).map_or(0.0, |before| moved[before]);
            moved[point] - before
        };
        let forces = gram.solve(&DVector::from_fn(points, |point, _| whole(point)));
        let mut steps = vec![0.0; count];
        for (response, force) in responses.iter().zip(forces.iter()) {
            let pairs = steps.iter_mut().zip(response);
            pairs.for_each(|(step, response)| *step += force * response);
        }
        steps
    });
    forced.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jerk(steps: &[f64]) -> f64 {
        let bends = steps.windows(3).map(|s| (s[2] - 2.0 * s[1] + s[0]).abs());
        bends.fold(0.0, f64::max) * 27_000.0
    }

    fn sum(steps: &[f64], end: usize) -> f64 {
        steps[..end].iter().sum()
    }

    #[test]
    fn places_are_met_and_the_way_between_is_calm() {
        for around in [false, true] {
            let moved = [vec![0.3, -0.3, 0.5], vec![0.0, 0.0, 0.0]];
            let ends = [15, 30, 200];
            let found = steps(260, &ends, moved.to_vec(), 30.0, around);
            for (&end, wanted) in ends.iter().zip(&moved[0]) {
                assert!(
                    (sum(&found[0], end) - wanted).abs() < 1e-9,
                    "{around} {end}"
                );
            }
            assert!(found[1].iter().all(|step| *step == 0.0));
            if around {
                assert!(found[0][0].abs() < 1e-4 && found[0][258].abs() < 1e-4);
            }
        }
        // From rest to rest within half a second, 0.3 m take 140 m/s^3.
        let alone = steps(260, &[15], vec![vec![0.3]], 30.0, false);
        assert!(jerk(&alone[0]) < 20.0, "{}", jerk(&alone[0]));
        // It fades.
        assert!(sum(&alone[0], 259) - sum(&alone[0], 150) < 0.01);
    }

    #[test]
    fn the_shortest_motions_and_points_at_their_ends_are_led_too() {
        for n in [2, 3, 4, 5] {
            for around in [false, true] {
                let found = steps(n, &[n - 1], vec![vec![2.0]], 30.0, around);
                assert!((sum(&found[0], n - 1) - 2.0).abs() < 1e-9, "{n}");
            }
        }
        let all: Vec<usize> = (1..40).collect();
        let moved: Vec<f64> = all.iter().map(|&t| (t as f64).sin()).collect();
        let found = steps(40, &all, vec![moved.clone()], 30.0, false);
        for (&end, wanted) in all.iter().zip(&moved) {
            assert!((sum(&found[0], end) - wanted).abs() < 1e-6);
        }
    }

    #[test]
    fn hours_are_led() {
        let found = steps(100_000, &[50, 90_000], vec![vec![1.0, -5.0]], 30.0, false);
        assert!((sum(&found[0], 90_000) + 5.0).abs() < 1e-6);
    }
}
