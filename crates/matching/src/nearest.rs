//! The example patch that is nearest to each patch of the synthesis.
//!
//! A patch distance is a sum of frame distances along a diagonal: D[i, j] is the sum over k of
//! ||x[i + k] - y[j + k]||^2. So frames are compared once and not once for each patch that covers
//! them. The p terms are added each time: differences of a running sum would flip neighbours that
//! lie close together. Rows are computed in tiles; where all tiles together are large, they are
//! computed twice and never held.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::distance::{Padded, squared};
use crate::{Frames, Pool};

/// What the distance of two patches is.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Distance {
    /// The mean of the squared differences of all values, as the published program has it.
    MeanSquare,
    /// The Euclidean distance, as the paper has it.
    L2,
}

/// The nearest patches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matches {
    /// The nearest example patch of each patch of the synthesis, by its number in the pool; of
    /// several equally near ones the first.
    pub nearest: Vec<usize>,
    /// The distance to it, divided by completeness where there is any.
    pub distances: Vec<f32>,
    /// For each example patch its distance to the nearest patch of the synthesis.
    pub smallest: Vec<f32>,
}

/// Bytes of frame distances that are held from the first pass to the second.
const HELD: usize = 64 << 20;
/// Bytes of a tile that is not held.
const TILE: usize = 8 << 20;

/// Example patches to compare with, prepared for any number of searches.
pub struct Search<'a> {
    pool: &'a Pool,
    padded: Padded,
    distance: Distance,
}

impl<'a> Search<'a> {
    /// A search among the patches of `pool`.
    pub fn new(pool: &'a Pool, distance: Distance) -> Self {
        Self {
            pool,
            padded: Padded::new(pool.frames()),
            distance,
        }
    }

    /// The nearest example patch of each patch of `synthesis`, `[frames, channels]`: the smallest
    /// D[i, j] / (`alpha` + min over i of D[i, j]) over j, or without `alpha` the smallest D[i, j].
    /// The result is the same on any number of threads.
    ///
    /// # Panics
    /// Panics if the channels differ, or either side is shorter than a patch.
    pub fn nearest(&self, synthesis: &Frames, alpha: Option<f64>) -> Matches {
        let p = self.pool.patch_size();
        assert!(synthesis.frames() >= p && self.pool.patches() > 0);
        let synthesis = Padded::new(synthesis);
        let patches = synthesis.frames() - p + 1;
        let width = self.padded.frames();
        let holds = synthesis.frames() * width * size_of::<f32>() <= HELD;
        let share = patches.div_ceil(2 * rayon::current_num_threads());
        let most = match holds {
            true => patches,
            false => TILE / size_of::<f32>() / width,
        };
        let rows = share.clamp(32, most.max(32));
        let tiles: Vec<usize> = (0..patches).step_by(rows).collect();
        let tile = |first: usize| {
            let rows = rows.min(patches - first);
            let mut distances = vec![0.0; (rows + p - 1) * width];
            squared(&synthesis, first, &self.padded, &mut distances);
            distances
        };
        let first_pass = || {
            tiles.par_iter().map(|&first| {
                let distances = tile(first);
                let smallest = alpha.map(|_| self.smallest(&distances));
                (holds.then_some(distances), smallest.unwrap_or_default())
            })
        };
        let (held, smallest): (Vec<Option<Vec<f32>>>, Vec<Vec<f32>>) = match (alpha, holds) {
            (None, false) => (vec![None; tiles.len()], Vec::new()),
            _ => first_pass().collect(),
        };
        let smallest = smallest.into_iter().reduce(|mut all, tile| {
            for (all, value) in all.iter_mut().zip(tile) {
                *all = all.min(value);
            }
            all
        });
        let smallest = smallest.unwrap_or_default();
        let scale: Vec<f32> = match alpha {
            Some(alpha) => smallest.iter().map(|&min| alpha as f32 + min).collect(),
            None => vec![1.0; self.pool.patches()],
        };
        let found: Vec<(usize, f32)> = tiles
            .par_iter()
            .zip(held)
            .flat_map_iter(|(&first, held)| {
                let distances = held.unwrap_or_else(|| tile(first));
                self.first_smallest(&distances, &scale)
            })
            .collect();
        let (nearest, distances) = found.into_iter().unzip();
        Matches {
            nearest,
            distances,
            smallest,
        }
    }

    /// The distances of the tile's patch `i` to all example patches, from those of its frames.
    #[inline(always)]
    fn row(&self, distances: &[f32], i: usize, row: &mut [f32]) {
        let (p, width) = (self.pool.patch_size(), self.padded.frames());
        row.fill(0.0);
        for (first, start, patches) in self.pool.runs() {
            let row = &mut row[first..first + patches];
            for k in 0..p {
                let from = (i + k) * width + start + k;
                for (sum, value) in row.iter_mut().zip(&distances[from..from + patches]) {
                    *sum += value;
                }
            }
        }
        match self.distance {
            Distance::MeanSquare => {
                let values = (self.pool.frames().channels() * p) as f32;
                row.iter_mut().for_each(|sum| *sum /= values);
            }
            Distance::L2 => row.iter_mut().for_each(|sum| *sum = sum.sqrt()),
        }
    }

    fn rows(&self, distances: &[f32]) -> usize {
        distances.len() / self.padded.frames() + 1 - self.pool.patch_size()
    }

    /// For each example patch its distance to the nearest patch of the tile.
    fn smallest(&self, distances: &[f32]) -> Vec<f32> {
        let patches = self.pool.patches();
        let (mut smallest, mut row) = (vec![f32::INFINITY; patches], vec![0.0; patches]);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for i in 0..self.rows(distances) {
                    self.row(distances, i, &mut row);
                    for (smallest, value) in smallest.iter_mut().zip(&row) {
                        *smallest = smallest.min(*value);
                    }
                }
            },
        );
        smallest
    }

    /// The first example patch of the smallest scaled distance, for each patch of the tile.
    fn first_smallest(&self, distances: &[f32], scale: &[f32]) -> Vec<(usize, f32)> {
        let mut row = vec![0.0; self.pool.patches()];
        let mut found = Vec::with_capacity(self.rows(distances));
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                for i in 0..self.rows(distances) {
                    self.row(distances, i, &mut row);
                    for (value, scale) in row.iter_mut().zip(scale) {
                        *value /= scale;
                    }
                    let least = minimum(&row);
                    let at = row.iter().position(|value| *value == least);
                    found.push((at.unwrap_or(0), least));
                }
            },
        );
        found
    }
}

/// The smallest value, in lanes.
#[inline(always)]
fn minimum(values: &[f32]) -> f32 {
    let mut lanes = [f32::INFINITY; 16];
    let (chunks, rest) = values.as_chunks::<16>();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane = if *value < *lane { *value } else { *lane };
        }
    }
    lanes
        .iter()
        .chain(rest)
        .copied()
        .fold(f32::INFINITY, f32::min)
}
