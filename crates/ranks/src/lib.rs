//! Processes that train one run together: who they are, and what they tell each other.
//!
//! Every method of [`Ranks`] that says so is collective: all ranks call it, in the same order. Sums are
//! formed in one [tree](split) whatever the number of ranks, so that two or four of them end with the
//! same bytes as one.

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

/// A process among those that share memory with it, which have its cores and graphics cards to share too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Local {
    /// Its number, from 0.
    pub rank: usize,
    /// How many there are.
    pub size: usize,
    /// How many of them may run on this one's cores, itself among them: all, unless the launcher has
    /// bound them to cores of their own.
    pub sharing: usize,
}

/// Who is given what all have said.
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

    /// What every rank says, in the order of ranks. Collective.
    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>>;

    /// Puts what each rank gives, `lengths[r]` values of rank r, one behind the other into `values` of
    /// those who receive it; those of others stay as they are. Collective.
    fn gather_into(&self, own: &[f32], lengths: &[usize], to: Receivers, values: &mut [f32]);

    /// Of what each rank gives for each, `lengths[r]` of `values` for rank r, one behind the other, and as many
    /// from all: puts the sum of what is for this one in the place of its own, [pairwise] over the ranks, an
    /// order of our own, where `MPI_Reduce_scatter` has any. `received` is room that is kept from one call to
    /// the next. Collective.
    fn scatter_sums(&self, values: &mut [f32], lengths: &[usize], received: &mut Vec<f32>);

    /// Puts what each rank has in its part of `values`, `lengths[r]` of rank r, one behind the other, there on
    /// all of them; `sent` is room as well. Collective.
    fn gather_parts(&self, values: &mut [f32], lengths: &[usize], sent: &mut Vec<f32>);

    /// Ends all ranks at once, after a panic: the others wait for something that does not come.
    fn abort(&self, code: i32) -> !;

    /// Whether this process writes what there is to write.
    fn is_first(&self) -> bool {
        self.rank() == 0
    }

    /// The part of `count` things in order that this rank takes: as many as any other, consecutive.
    ///
    /// # Panics
    /// Panics if the number of ranks does not divide them.
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
