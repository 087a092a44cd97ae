//! Processes of one MPI job.

use std::fmt;

use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Buffer, BufferMut, Communicator, CommunicatorCollectives, Equivalence, Root};
use mpi::{Count, Threading};

use crate::cores;
use crate::{Local, Ranks, Receivers, pairwise};

/// The processes that `mpirun` or `srun` has started.
pub struct Mpi {
    world: SimpleCommunicator,
    local: Local,
    /// Ends MPI when it is dropped, last.
    _universe: Universe,
}

impl Mpi {
    /// This process among those of its job; none if MPI has been started before.
    pub fn start() -> Option<Self> {
        // Threads compute, and the one that trains talks.
        let (universe, _) = mpi::initialize_with_threading(Threading::Funneled)?;
        let world = universe.world();
        let machine = world.split_shared(world.rank());
        let (own, size) = (cores::own(), machine.size() as usize);
        let mut all = vec![0; cores::WORDS * size];
        machine.all_gather_into(&own[..], &mut all[..]);
        let (all, _) = all.as_chunks::<{ cores::WORDS }>();
        let local = Local {
            rank: machine.rank() as usize,
            size,
            sharing: cores::sharing(&own, all),
        };
        Some(Self {
            world,
            local,
            _universe: universe,
        })
    }

    /// Whether a launcher has started this process.
    pub fn is_launched() -> bool {
        const TOLD: [&str; 4] = ["PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "PMI_FD"];
        TOLD.iter().any(|name| std::env::var_os(name).is_some())
    }
}

/// Numbers of elements in a row, and where each begins.
fn places(lengths: impl Iterator<Item = usize>) -> (Vec<Count>, Vec<Count>) {
    let mut end = 0;
    let place = |length: usize| {
        let length = Count::try_from(length).expect("fewer than two thousand million");
        let start = end;
        end += length;
        (length, start)
    };
    lengths.map(place).unzip()
}

impl Mpi {
    /// What every rank gives, in the order of ranks.
    fn gathered<T: Equivalence + Default + Clone>(&self, own: &[T]) -> Vec<Vec<T>>
    where
        [T]: Buffer,
        [T]: BufferMut,
    {
        let mut lengths = vec![0u64; self.size()];
        self.world
            .all_gather_into(&(own.len() as u64), &mut lengths[..]);
        let (counts, starts) = places(lengths.iter().map(|length| *length as usize));
        let mut all = vec![T::default(); lengths.iter().sum::<u64>() as usize];
        let mut parts = PartitionMut::new(&mut all[..], &counts[..], &starts[..]);
        self.world.all_gather_varcount_into(own, &mut parts);
        let mut rest = &all[..];
        let part = |count: &Count| {
            let (part, behind) = rest.split_at(*count as usize);
            rest = behind;
            part.to_vec()
        };
        counts.iter().map(part).collect()
    }
}

impl fmt::Debug for Mpi {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rank {} of {}", self.rank(), self.size())
    }
}

impl Ranks for Mpi {
    fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    fn size(&self) -> usize {
        self.world.size() as usize
    }

    fn local(&self) -> Local {
        self.local
    }

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        self.gathered(own)
    }

    fn gather_into(&self, own: &[f32], lengths: &[usize], to: Receivers, values: &mut [f32]) {
        let (counts, starts) = places(lengths.iter().copied());
        let first = self.world.process_at_rank(0);
        if to == Receivers::First && !self.is_first() {
            first.gather_varcount_into(own);
            return;
        }
        let mut parts = PartitionMut::new(values, &counts[..], &starts[..]);
        match to {
            Receivers::All => self.world.all_gather_varcount_into(own, &mut parts),
            Receivers::First => first.gather_varcount_into_root(own, &mut parts),
        }
    }

    fn scatter_sums(&self, values: &[f32], lengths: &[usize], own: &mut Vec<f32>) {
        let (counts, starts) = places(lengths.iter().copied());
        // As many from each rank as this one gives for itself.
        let each = lengths[self.rank()];
        let (received_counts, received_starts) = places(lengths.iter().map(|_| each));
        own.resize(each * self.size(), 0.0);
        let sent = Partition::new(values, &counts[..], &starts[..]);
        let mut into = PartitionMut::new(&mut own[..], &received_counts[..], &received_starts[..]);
        self.world.all_to_all_varcount_into(&sent, &mut into);
        if each > 0 {
            pairwise(own, each);
        }
        own.truncate(each);
    }

    fn abort(&self, code: i32) -> ! {
        self.world.abort(code)
    }
}
