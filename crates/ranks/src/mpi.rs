//! Processes of one MPI job.

use std::fmt;

use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{
    AsRaw, Buffer, BufferMut, Communicator, CommunicatorCollectives, Equivalence, Root,
};
use mpi::{Count, Threading, ffi};

use crate::cores;
use crate::{Local, Ranks, Receivers, pairwise_with};

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

/// Values, how many of them go to or come from each rank, and where those begin.
type Parts<'a, P> = (P, &'a [Count], &'a [Count]);

impl Mpi {
    /// Sends parts of values to each rank, and puts what each sends where it belongs; the two may lie in
    /// one list, in parts that do not overlap. Collective.
    fn all_to_all(&self, sent: Parts<'_, *const f32>, into: Parts<'_, *mut f32>) {
        let floats = f32::equivalent_datatype().as_raw();
        // SAFETY: all parts lie in lists that live as long as the call, and those received in ones that
        // are the caller's alone; each rank sends as many as the other expects.
        #[allow(unsafe_code)]
        unsafe {
            ffi::MPI_Alltoallv(
                sent.0.cast(),
                sent.1.as_ptr(),
                sent.2.as_ptr(),
                floats,
                into.0.cast(),
                into.1.as_ptr(),
                into.2.as_ptr(),
                floats,
                self.world.as_raw(),
            );
        }
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

    fn scatter_sums(&self, values: &mut [f32], lengths: &[usize], received: &mut Vec<f32>) {
        let (rank, size) = (self.rank(), self.size());
        let each = lengths[rank];
        // Nothing is sent to oneself: it is added where it is.
        let but_own = |length: usize, of: usize| if of == rank { 0 } else { length };
        received.resize(each * (size - 1), 0.0);
        let (_, starts) = places(lengths.iter().copied());
        let sent = (0..size).map(|of| but_own(lengths[of], of) as Count);
        let from = places((0..size).map(|of| but_own(each, of)));
        self.all_to_all(
            (values.as_ptr(), &sent.collect::<Vec<_>>(), &starts),
            (received.as_mut_ptr(), &from.0, &from.1),
        );
        let first = starts[rank] as usize;
        pairwise_with(&mut values[first..first + each], rank, received);
    }

    fn gather_parts(&self, values: &mut [f32], lengths: &[usize]) {
        let (rank, size) = (self.rank(), self.size());
        let (mut into, starts) = places(lengths.iter().copied());
        let each = std::mem::take(&mut into[rank]);
        let sent = (0..size).map(|of| if of == rank { 0 } else { each });
        let from_own = vec![starts[rank]; size];
        let values = values.as_mut_ptr();
        self.all_to_all(
            (values, &sent.collect::<Vec<_>>(), &from_own),
            (values, &into, &starts),
        );
    }

    fn abort(&self, code: i32) -> ! {
        self.world.abort(code)
    }
}
