//! Processes of one MPI job.

use std::fmt;

use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};

use crate::{Ranks, pairwise};

/// The processes that `mpirun` or `srun` has started.
pub struct Mpi {
    world: SimpleCommunicator,
    /// Ends MPI when it is dropped, last.
    _universe: Universe,
}

impl Mpi {
    /// This process among those of its job; none if MPI has been started before.
    pub fn start() -> Option<Self> {
        // Threads compute, and the one that trains talks.
        let (universe, _) = mpi::initialize_with_threading(Threading::Funneled)?;
        let world = universe.world();
        Some(Self {
            world,
            _universe: universe,
        })
    }

    /// Whether a launcher has started this process.
    pub fn is_launched() -> bool {
        const TOLD: [&str; 4] = ["PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "PMI_FD"];
        TOLD.iter().any(|name| std::env::var_os(name).is_some())
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

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        let mut lengths = vec![0i32; self.size()];
        let length = i32::try_from(own.len()).expect("what ranks say is short");
        self.world.all_gather_into(&length, &mut lengths[..]);
        let ends = lengths.iter().scan(0, |end, length| {
            *end += length;
            Some(*end)
        });
        let starts: Vec<i32> = ends
            .zip(&lengths)
            .map(|(end, length)| end - length)
            .collect();
        let mut all = vec![0u8; lengths.iter().sum::<i32>() as usize];
        let mut parts = PartitionMut::new(&mut all[..], &lengths[..], &starts[..]);
        self.world.all_gather_varcount_into(own, &mut parts);
        let part = |(start, length): (&i32, &i32)| {
            let start = *start as usize;
            all[start..start + *length as usize].to_vec()
        };
        starts.iter().zip(&lengths).map(part).collect()
    }

    /// Each rank sums its part of the values and sends it to all: an order of our own, where
    /// `MPI_Allreduce` has any.
    fn sum(&self, values: &mut Vec<f32>) {
        let (size, length) = (self.size(), values.len());
        if size == 1 {
            return;
        }
        let each = length.div_ceil(size);
        values.resize(each * size, 0.0);
        let mut received = vec![0.0f32; each * size];
        self.world.all_to_all_into(&values[..], &mut received[..]);
        let mut parts: Vec<Vec<f32>> = received.chunks(each.max(1)).map(<[f32]>::to_vec).collect();
        if each > 0 {
            let own = pairwise(&mut parts);
            self.world.all_gather_into(&own[..], &mut values[..]);
        }
        values.truncate(length);
    }

    fn abort(&self, code: i32) -> ! {
        self.world.abort(code)
    }
}
