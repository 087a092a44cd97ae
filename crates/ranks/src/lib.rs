//! Processes that train one run, and their communication.
//!
//! Methods of [`Ranks`] marked as collective are called by all ranks in the same order. Sums follow
//! one [tree](split) for any number of ranks, so two or four of them produce the same bytes as one.

#[cfg(feature = "mpi")]
mod cores;
#[cfg(feature = "mpi")]
mod mpi;
mod sharing;
mod tree;

use std::fmt::Debug;
use std::ops::Range;

#[cfg(feature = "mpi")]
pub use self::mpi::Mpi;
pub use sharing::{Sharing, from_bytes, shared, to_bytes};
pub use tree::{add, pairwise, pairwise_with, split};

/// A process among those on its machine, which share cores and GPUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Local {
    /// Its number, from 0.
    pub rank: usize,
    /// Number of these processes.
    pub size: usize,
    /// Number of them that may run on its cores: all, unless the launcher binds them.
    pub sharing: usize,
}

/// Receivers of gathered values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receivers {
    /// Every rank.
    All,
    /// The first, which writes.
    First,
}

/// Processes that train one run.
pub trait Ranks: Debug {
    /// Number of this process, from 0.
    fn rank(&self) -> usize;

    /// Number of processes.
    fn size(&self) -> usize;

    /// This process among those on its machine.
    fn local(&self) -> Local {
        Local {
            rank: 0,
            size: 1,
            sharing: 1,
        }
    }

    /// Gathers the bytes of every rank, in rank order. Collective.
    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>>;

    /// Gathers the values of each rank, `lengths[r]` of rank r, concatenated into `values` of the
    /// receivers; `values` of other ranks are unchanged. Collective.
    fn gather_into(&self, own: &[f32], lengths: &[usize], to: Receivers, values: &mut [f32]);

    /// Reduce-scatter: `values` holds `lengths[r]` values for rank r, concatenated, all lengths
    /// equal. The own part is replaced by its sum over the ranks in [pairwise] order, which
    /// `MPI_Reduce_scatter` does not guarantee. `received` is a reused buffer. Collective.
    fn scatter_sums(&self, values: &mut [f32], lengths: &[usize], received: &mut Vec<f32>);

    /// All-gather: replaces the parts of `values`, `lengths[r]` of rank r, by those of their ranks.
    /// `sent` is a reused buffer. Collective.
    fn gather_parts(&self, values: &mut [f32], lengths: &[usize], sent: &mut Vec<f32>);

    /// Ends all ranks after a panic, as the others would wait forever.
    fn abort(&self, code: i32) -> !;

    /// True if this process writes files and messages.
    fn is_first(&self) -> bool {
        self.rank() == 0
    }

    /// The consecutive part of `count` items of this rank, equal for all ranks. Panics if the
    /// number of ranks does not divide them.
    fn share(&self, count: u64) -> Range<u64> {
        let (rank, size) = (self.rank() as u64, self.size() as u64);
        assert_eq!(count % size, 0, "{size} ranks share {count}");
        let each = count / size;
        rank * each..(rank + 1) * each
    }
}

/// One process.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        vec![own.to_vec()]
    }

    fn gather_into(&self, own: &[f32], _: &[usize], _: Receivers, values: &mut [f32]) {
        values.copy_from_slice(own);
    }

    fn scatter_sums(&self, _: &mut [f32], _: &[usize], _: &mut Vec<f32>) {}

    fn gather_parts(&self, _: &mut [f32], _: &[usize], _: &mut Vec<f32>) {}

    fn abort(&self, code: i32) -> ! {
        std::process::exit(code)
    }
}
