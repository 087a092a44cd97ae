//! Processes of one training run, and their communication.
//!
//! All ranks call the collective methods of [`Ranks`] in the same order. Sums follow one
//! [tree](split) for any number of ranks, so two or four ranks produce the same bytes as one rank.

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

/// The position of a process among the processes on its machine, which share cores and GPUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Local {
    /// Number of this process, from 0.
    pub rank: usize,
    /// Number of processes on the machine.
    pub size: usize,
    /// Number of processes that may run on this process's cores: all, unless the launcher binds
    /// processes.
    pub sharing: usize,
}

/// Receivers of gathered values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receivers {
    /// Every rank.
    All,
    /// The first rank, which writes files.
    First,
}

/// The processes of one training run.
pub trait Ranks: Debug {
    /// Number of this process, from 0.
    fn rank(&self) -> usize;

    /// Number of processes.
    fn size(&self) -> usize;

    /// The position of this process on its machine.
    fn local(&self) -> Local {
        Local {
            rank: 0,
            size: 1,
            sharing: 1,
        }
    }

    /// Gathers the bytes of every rank, in rank order. Collective.
    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>>;

    /// Gathers `lengths[r]` values of each rank r, concatenated, into `values` of the receivers.
    /// Other ranks keep `values` unchanged. Collective.
    fn gather_into(&self, own: &[f32], lengths: &[usize], to: Receivers, values: &mut [f32]);

    /// Reduce-scatter: `values` contains `lengths[r]` values for each rank r, concatenated; all
    /// lengths are equal. The rank's own part becomes its sum over the ranks in [pairwise] order,
    /// which `MPI_Reduce_scatter` does not guarantee. `received` is a reused buffer. Collective.
    fn scatter_sums(&self, values: &mut [f32], lengths: &[usize], received: &mut Vec<f32>);

    /// All-gather: each rank r sends its own part of `values`, `lengths[r]` values, to all ranks.
    /// `sent` is a reused buffer. Collective.
    fn gather_parts(&self, values: &mut [f32], lengths: &[usize], sent: &mut Vec<f32>);

    /// Ends all ranks after a panic; otherwise the other ranks would wait forever.
    fn abort(&self, code: i32) -> !;

    /// True if this process writes files and messages.
    fn is_first(&self) -> bool {
        self.rank() == 0
    }

    /// This rank's consecutive share of `count` items; all shares are equal. Panics if `count` is
    /// not divisible by the number of ranks.
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
