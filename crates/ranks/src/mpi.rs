//! Processes of one MPI job.

use std::fmt;

use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Root};
use mpi::{Count, Threading};

use crate::cores;
use crate::{Local, Ranks, Receivers, pairwise_with};

/// The processes started by `mpirun` or `srun`.
pub struct Mpi {
    world: SimpleCommunicator,
    local: Local,
    /// Dropping the universe ends MPI, so it is the last field.
    _universe: Universe,
}

impl Mpi {
    /// This process of the MPI job; `None` if MPI is already running.
    pub fn start() -> Option<Self> {
        // Threads only compute; the training thread alone communicates.
        let (universe, provided) = mpi::initialize_with_threading(Threading::Funneled)?;
        assert!(
            provided >= Threading::Funneled,
            "the MPI library allows no threads beside the one that communicates"
        );
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

    /// True if a launcher started this process.
    pub fn is_launched() -> bool {
        const VARIABLES: [&str; 4] = ["PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "PMI_FD"];
        VARIABLES
            .iter()
            .any(|name| std::env::var_os(name).is_some())
    }
}

/// Lengths and start offsets of concatenated parts.
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

/// Number of bytes that all ranks together send per round. MPI counts end near 2e9.
const ROUND: usize = 1 << 30;

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
        let mut lengths = vec![0u64; self.size()];
        self.world
            .all_gather_into(&(own.len() as u64), &mut lengths[..]);
        let most = lengths.iter().max().copied().unwrap_or(0) as usize;
        let mut all = vec![Vec::new(); self.size()];
        let part = (ROUND / self.size()).max(1);
        for first in (0..most).step_by(part) {
            let within = |length: usize| first.min(length)..(first + part).min(length);
            let (counts, starts) =
                places(lengths.iter().map(|&length| within(length as usize).len()));
            let mut round = vec![0; counts.iter().map(|&count| count as usize).sum()];
            let mut parts = PartitionMut::new(&mut round[..], &counts[..], &starts[..]);
            let own = &own[within(own.len())];
            self.world.all_gather_varcount_into(own, &mut parts);
            for ((gathered, &count), &start) in all.iter_mut().zip(&counts).zip(&starts) {
                gathered.extend_from_slice(&round[start as usize..(start + count) as usize]);
            }
        }
        all
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

    fn scatter_sums(&self, values: &mut [f32], lengths: &[usize], received: &mut Vec<f32>) {
        let (rank, size) = (self.rank(), self.size());
        let each = lengths[rank];
        // This rank's part is added in place and not sent.
        let (mut counts, starts) = places(lengths.iter().copied());
        counts[rank] = 0;
        let from = places((0..size).map(|of| if of == rank { 0 } else { each }));
        received.resize(each * (size - 1), 0.0);
        let sent = Partition::new(&values[..], &counts[..], &starts[..]);
        let mut into = PartitionMut::new(&mut received[..], &from.0[..], &from.1[..]);
        self.world.all_to_all_varcount_into(&sent, &mut into);
        let first = starts[rank] as usize;
        pairwise_with(&mut values[first..first + each], rank, received);
    }

    fn gather_parts(&self, values: &mut [f32], lengths: &[usize], sent: &mut Vec<f32>) {
        let (rank, size) = (self.rank(), self.size());
        let (mut counts, starts) = places(lengths.iter().copied());
        let each = std::mem::take(&mut counts[rank]);
        let first = starts[rank] as usize;
        // MPI forbids overlapping send and receive buffers.
        sent.clear();
        sent.extend_from_slice(&values[first..first + lengths[rank]]);
        // Each other rank receives this rank's whole part.
        let to = (0..size).map(|of| if of == rank { 0 } else { each });
        let (to, from_first) = (to.collect::<Vec<Count>>(), vec![0; size]);
        let sent = Partition::new(&sent[..], &to[..], &from_first[..]);
        let mut into = PartitionMut::new(values, &counts[..], &starts[..]);
        self.world.all_to_all_varcount_into(&sent, &mut into);
    }

    fn abort(&self, code: i32) -> ! {
        self.world.abort(code)
    }
}
