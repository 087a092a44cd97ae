//! Nearest example patches.
//!
//! The distance of two patches is a sum of frame distances along a diagonal: D[i, j] is the sum
//! over k of ||x[i + k] - y[j + k]||^2, so each pair of frames is compared once. A running sum
//! would reorder nearly equal distances by rounding. Tiles of rows that exceed the cache are
//! computed twice.

use std::borrow::Cow;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::continuity::continued;
use crate::diagonals::Diagonals;
use crate::distance::{Moving, Padded, squared};
use crate::{Frames, Pool};

/// Distance of two patches.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Distance {
    /// Mean of the squared differences, as in the published program.
    MeanSquare,
    /// Euclidean distance, as in the paper.
    L2,
}

/// Nearest patches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matches {
    /// For each patch of the synthesis, the pool number of the nearest example patch; the first of
    /// equally near patches.
    pub nearest: Vec<usize>,
    /// The distance to the nearest patch, divided by completeness if `alpha` is set.
    pub distances: Vec<f32>,
    /// The distance of each example patch to the nearest patch of the synthesis.
    pub smallest: Vec<f32>,
}

/// Most bytes of distances that a search keeps between its passes and for the next search.
const CACHE_BYTES: usize = 64 << 20;
/// Bytes of a tile that is not kept.
const TILE_BYTES: usize = 8 << 20;
/// Frames compared before their distances are summed.
const AT_A_TIME: usize = 32;

/// Example patches, prepared for searches. Distances of patches that did not change since the last
/// search are reused.
pub struct Search<'a> {
    pool: &'a Pool,
    moving: Moving,
    padded: Padded,
    distance: Distance,
    /// Tolerance of [`continued`]; 0 for the nearest patches.
    continuity: f64,
    cache_bytes: usize,
    cache: Option<Cache>,
}

/// Distances kept for the next search.
struct Cache {
    synthesis: Padded,
    /// Rows of each tile except the last.
    rows: usize,
    /// Distances of all patches.
    tiles: Vec<Vec<f32>>,
}

impl<'a> Search<'a> {
    /// A search among the patches of `pool`.
    pub fn new(pool: &'a Pool, distance: Distance) -> Self {
        let moving = Moving::of(&pool.frames);
        Self {
            pool,
            padded: moving.padded(&pool.frames),
            moving,
            distance,
            continuity: 0.0,
            cache_bytes: CACHE_BYTES,
            cache: None,
        }
    }

    /// Divides the cache's memory among `searches` searches.
    #[must_use]
    pub fn among(self, searches: usize) -> Self {
        Self {
            cache_bytes: CACHE_BYTES / searches.max(1),
            ..self
        }
    }

    /// A search that prefers patches that continue the match before, see
    /// [`Settings::continuity`](crate::Settings::continuity).
    #[must_use]
    pub fn continuing(self, continuity: f64) -> Self {
        Self { continuity, ..self }
    }

    /// The nearest example patch of each patch of `current`, `[frames, channels]`: the j with the
    /// smallest D[i, j] / (`alpha` + min over i of D[i, j]), or without `alpha` the smallest D[i,
    /// j]. The result depends neither on the number of threads nor on earlier searches.
    ///
    /// `bent`: true for frames blended into a key frame, or empty. If other patches are left,
    /// patches with blended frames do not count for the minimum over i. They equal the example from
    /// the first step on, and the rest of the motion would avoid that part of the example.
    ///
    /// # Panics
    /// Panics if the channels differ, or either side is shorter than a patch.
    pub fn nearest(&mut self, current: &Frames, alpha: Option<f64>, bent: &[bool]) -> Matches {
        let synthesis = current;
        let p = self.pool.patch_size;
        assert!(synthesis.frames() >= p && self.pool.patches > 0);
        assert!(bent.is_empty() || bent.len() == synthesis.frames());
        let mut counts: Vec<bool> = bent.windows(p).map(|bent| !bent.contains(&true)).collect();
        if !counts.contains(&true) {
            counts = vec![true; synthesis.frames() - p + 1];
        }
        let (frames, width) = (synthesis.frames(), self.padded.frames());
        let patches = frames - p + 1;
        let holds = frames * width * size_of::<f32>() <= self.cache_bytes;
        let share = patches.div_ceil(2 * rayon::current_num_threads());
        let most = match holds {
            true => patches,
            false => TILE_BYTES / size_of::<f32>() / width,
        };
        let rows = share.clamp(32, most.max(32));
        let firsts: Vec<usize> = (0..patches).step_by(rows).collect();
        let last = self.cache.take();
        let last = last.filter(|last| (last.synthesis.frames(), last.rows) == (frames, rows));
        let search = &*self;
        let tile = |synthesis: &Padded, first: usize| {
            search.tile(synthesis, first, rows.min(patches - first))
        };
        let (synthesis, cached) = match last {
            Some(mut last) => {
                let changed = self.moving.renew(&mut last.synthesis, synthesis);
                let tiles = firsts.par_iter().zip(&mut last.tiles);
                tiles.for_each(|(&first, tile)| {
                    search.renew(tile, &last.synthesis, first, &changed);
                });
                (last.synthesis, Some(last.tiles))
            }
            None => {
                let synthesis = self.moving.padded(synthesis);
                let tiles = firsts.par_iter().map(|&first| tile(&synthesis, first));
                let tiles = holds.then(|| tiles.collect::<Vec<_>>());
                (synthesis, tiles)
            }
        };
        let tiles = firsts.par_iter().enumerate();
        let tiles = tiles.map(|(index, &first)| match &cached {
            Some(tiles) => Cow::Borrowed(tiles[index].as_slice()),
            None => Cow::Owned(tile(&synthesis, first)),
        });
        let pool_patches = search.pool.patches;
        let (mut smallest, mut scale) = (Vec::new(), vec![1.0; pool_patches]);
        if let Some(alpha) = alpha {
            let of_tiles = tiles.clone().zip(&firsts);
            smallest = of_tiles
                .map(|(tile, &first)| search.smallest(&tile, &counts[first..]))
                .reduce(
                    || vec![f32::INFINITY; pool_patches],
                    |a, b| a.iter().zip(b).map(|(a, b)| a.min(b)).collect(),
                );
            scale = smallest.iter().map(|&min| alpha as f32 + min).collect();
        }
        let found = tiles.flat_map_iter(|tile| search.first_smallest(&tile, &scale));
        let found = found.collect::<Vec<(usize, f32)>>().into_iter();
        let (mut nearest, distances): (Vec<usize>, Vec<f32>) = found.unzip();
        if self.continuity > 0.0 {
            continued(current, self.pool, self.continuity, &mut nearest);
        }
        self.cache = cached.map(|tiles| Cache {
            synthesis,
            rows,
            tiles,
        });
        Matches {
            nearest,
            distances,
            smallest,
        }
    }

    /// Recomputes the rows of a tile whose patches have a frame that `changed`; `first` is the
    /// first patch of the tile.
    fn renew(&self, tile: &mut [f32], synthesis: &Padded, first: usize, changed: &[bool]) {
        let (p, width) = (self.pool.patch_size, self.padded.frames());
        let rows = tile.len() / width;
        let stale = |row: usize| changed[first + row..first + row + p].contains(&true);
        let mut renewed = Vec::new();
        let mut row = 0;
        while row < rows {
            if !stale(row) {
                row += 1;
                continue;
            }
            // The run ends at a gap long enough that no frame is compared twice.
            let mut end = row + 1;
            let mut ahead = end;
            while ahead < rows.min(end + p) {
                ahead += 1;
                if stale(ahead - 1) {
                    end = ahead;
                }
            }
            self.fill(&mut renewed, synthesis, first + row, end - row);
            tile[row * width..end * width].copy_from_slice(&renewed[..(end - row) * width]);
            row = end;
        }
    }

    /// Distances of `rows` patches from `first` on to all example patches, `[rows, frames of the
    /// pool]`; columns beyond the number of patches are undefined.
    fn tile(&self, synthesis: &Padded, first: usize, rows: usize) -> Vec<f32> {
        let mut distances = Vec::new();
        self.fill(&mut distances, synthesis, first, rows);
        distances.truncate(rows * self.padded.frames());
        distances
    }

    /// Writes a [`tile`](Self::tile) to the beginning of `distances`.
    fn fill(&self, distances: &mut Vec<f32>, synthesis: &Padded, first: usize, rows: usize) {
        let (p, width) = (self.pool.patch_size, self.padded.frames());
        let frames = rows + p - 1;
        distances.resize(frames * width, 0.0);
        let mut summed = 0;
        // Frame distances are summed while they are in the cache.
        for start in (0..frames).step_by(AT_A_TIME) {
            let end = frames.min(start + AT_A_TIME);
            let part = &mut distances[start * width..end * width];
            squared(synthesis, first + start, &self.padded, part);
            let ready = (end + 1).saturating_sub(p);
            Arch::new().dispatch(Diagonals {
                pool: self.pool,
                distance: self.distance,
                distances,
                patches: summed..ready,
                still: &synthesis.still[first..],
            });
            summed = ready;
        }
    }

    /// The rows of a tile.
    fn rows<'b>(&self, distances: &'b [f32]) -> impl Iterator<Item = &'b [f32]> + use<'b> {
        let patches = self.pool.patches;
        let rows = distances.chunks_exact(self.padded.frames());
        rows.map(move |row| &row[..patches])
    }

    /// The distance of each example patch to the nearest counted patch of the tile.
    fn smallest(&self, distances: &[f32], counts: &[bool]) -> Vec<f32> {
        let mut smallest = vec![f32::INFINITY; self.pool.patches];
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let rows = self.rows(distances).zip(counts);
                for (row, _) in rows.filter(|(_, counts)| **counts) {
                    for (smallest, value) in smallest.iter_mut().zip(row) {
                        *smallest = smallest.min(*value);
                    }
                }
            },
        );
        smallest
    }

    /// The first example patch with the smallest scaled distance, for each patch of the tile.
    fn first_smallest(&self, distances: &[f32], scale: &[f32]) -> Vec<(usize, f32)> {
        let mut scaled = vec![0.0; self.pool.patches];
        let rows = self.rows(distances);
        let found = rows.map(|row| {
            Arch::new().dispatch(Scaled {
                row,
                scale,
                scaled: &mut scaled,
            })
        });
        found.collect()
    }
}

/// Divides a row by `scale`; returns index and value of the first smallest quotient.
struct Scaled<'a> {
    row: &'a [f32],
    scale: &'a [f32],
    scaled: &'a mut [f32],
}

impl WithSimd for Scaled<'_> {
    type Output = (usize, f32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (usize, f32) {
        let values = self.row.iter().zip(self.scale);
        for (scaled, (value, scale)) in self.scaled.iter_mut().zip(values) {
            *scaled = value / scale;
        }
        let mut lanes = [f32::INFINITY; 16];
        let (chunks, rest) = self.scaled.as_chunks::<16>();
        for chunk in chunks {
            for (lane, value) in lanes.iter_mut().zip(chunk) {
                *lane = if *value < *lane { *value } else { *lane };
            }
        }
        let mut least = f32::INFINITY;
        for value in lanes.iter().chain(rest) {
            least = least.min(*value);
        }
        for (number, chunk) in self.scaled.chunks(64).enumerate() {
            let mut there = false;
            for value in chunk {
                there |= *value == least;
            }
            if there {
                let at = chunk.iter().position(|value| *value == least);
                return (64 * number + at.unwrap_or(0), least);
            }
        }
        (0, least)
    }
}
