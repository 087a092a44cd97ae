//! Corrections of a foot that are eased over its whole step.

use std::array::from_fn;
use std::ops::Range;

use super::runs;
use crate::banded::Cholesky;
use crate::vector::{length, minus, plus};

/// Weight of a contact's mean correction: feet stand around where they were.
const SIZE: f64 = 0.3;

/// Weight with which a frame is drawn into the reach of its leg, added in each round.
const REACH: f64 = 1e3;

/// Rounds in which unreachable frames are drawn into reach.
const ROUNDS: usize = 4;

/// Distance out of reach that is left to the last clamp, metres.
const NEAR: f64 = 1e-3;

/// A foot's contacts, unwanted steps and reach.
pub(super) struct Foot<'a, F: Fn(usize, [f64; 3]) -> [f64; 3]> {
    /// Steps to the next frame that the correction cancels in contact, metres, `[frames - 1]`.
    pub unwanted: Vec<[f64; 3]>,
    /// True in contact, `[frames]`.
    pub contacts: &'a [bool],
    /// Weight of a step in contact against the squared third difference of the correction.
    pub firmness: f64,
    /// The nearest correction within the leg's reach in a frame.
    pub reachable: F,
}

impl<F: Fn(usize, [f64; 3]) -> [f64; 3]> Foot<'_, F> {
    /// The correction of each frame, metres: it cancels unwanted steps in contact, changes as
    /// smoothly as possible in between (least squared third differences), fades over `blend` frames
    /// where no contact follows, and stays within reach.
    pub fn corrections(&self, blend: f64) -> Vec<[f64; 3]> {
        let frames = self.contacts.len();
        if !self.contacts.contains(&true) {
            return vec![[0.0; 3]; frames];
        }
        let places = self.places();
        let mut drawn = vec![([0.0; 3], 0.0); frames];
        let mut by = self.solved(blend, &places, &drawn);
        for _ in 0..ROUNDS {
            let mut reached = true;
            for (t, (target, weight)) in drawn.iter_mut().enumerate() {
                let nearest = (self.reachable)(t, by[t]);
                if length(minus(nearest, by[t])) > NEAR {
                    *target = nearest;
                    *weight += REACH;
                    reached = false;
                }
            }
            if reached {
                break;
            }
            by = self.solved(blend, &places, &drawn);
        }
        let within = |(t, by): (usize, [f64; 3])| (self.reachable)(t, by);
        by.into_iter().enumerate().map(within).collect()
    }

    /// Corrections that cancel all unwanted steps of a contact and are 0 on average; 0 elsewhere.
    fn places(&self) -> Vec<[f64; 3]> {
        let mut places = vec![[0.0; 3]; self.contacts.len()];
        for run in runs(self.contacts) {
            for t in run.start + 1..run.end {
                places[t] = minus(places[t - 1], self.unwanted[t - 1]);
            }
            let mean = mean_of(&places[run.clone()]);
            places[run].iter_mut().for_each(|by| *by = minus(*by, mean));
        }
        places
    }

    /// The least squares; `drawn` has a target and its weight for each frame.
    fn solved(&self, blend: f64, places: &[[f64; 3]], drawn: &[([f64; 3], f64)]) -> Vec<[f64; 3]> {
        let frames = drawn.len();
        let (mut matrix, mut right) = (vec![[0.0; 4]; frames], vec![[0.0; 3]; frames]);
        for (t, (target, weight)) in drawn.iter().enumerate() {
            let size = if self.contacts[t] {
                SIZE
            } else {
                blend.powi(-6)
            };
            matrix[t][0] += size + weight;
            right[t] = from_fn(|axis| size * places[t][axis] + weight * target[axis]);
        }
        const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
        for t in 3..frames {
            for (i, d) in (0..4).flat_map(|i| (0..=i).map(move |d| (i, d))) {
                matrix[t - 3 + i][d] += THIRD[i] * THIRD[i - d];
            }
        }
        for (t, unwanted) in self.unwanted.iter().enumerate() {
            if self.contacts[t] && self.contacts[t + 1] {
                matrix[t][0] += self.firmness;
                matrix[t + 1][0] += self.firmness;
                matrix[t + 1][1] -= self.firmness;
                right[t] = plus(right[t], unwanted.map(|value| self.firmness * value));
                right[t + 1] = minus(right[t + 1], unwanted.map(|value| self.firmness * value));
            }
        }
        let factor = Cholesky::new(matrix);
        let axes: [Vec<f64>; 3] = from_fn(|axis| {
            let mut values: Vec<f64> = right.iter().map(|value| value[axis]).collect();
            factor.solve(&mut values);
            values
        });
        (0..frames).map(|t| from_fn(|axis| axes[axis][t])).collect()
    }

    /// Largest distance of the foot from where it should be within a contact, metres.
    pub fn missed(&self, by: &[[f64; 3]]) -> f64 {
        let places = self.places();
        let of_run = |run: Range<usize>| {
            let off: Vec<[f64; 3]> = run.map(|t| minus(by[t], places[t])).collect();
            let mean = mean_of(&off);
            let distances = off.into_iter().map(|off| length(minus(off, mean)));
            distances.fold(0.0, f64::max)
        };
        runs(self.contacts)
            .into_iter()
            .map(of_run)
            .fold(0.0, f64::max)
    }
}

/// The mean of vectors.
fn mean_of(vectors: &[[f64; 3]]) -> [f64; 3] {
    let sum = vectors
        .iter()
        .fold([0.0; 3], |sum, &vector| plus(sum, vector));
    sum.map(|value| value / vectors.len() as f64)
}
