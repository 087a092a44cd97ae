//! Agreement of ranks: all continue, or all end at the same point.
//!
//! A failure of one rank is reported to all ranks before the next collective operation, so that no
//! rank waits for a rank that has ended.

mod sharing;

use std::cell::Cell;
use std::rc::Rc;

use kinegrad_data::Digest;
use kinegrad_kernels::Mode;
use kinegrad_ranks::{Alone, Ranks};

use crate::error::Error;

/// The status of a rank.
#[derive(Clone, Copy, PartialEq)]
enum Status {
    Continues = 0,
    Stops = 1,
    Failed = 2,
    /// The rank's data failed, so progress should be saved.
    FailedData = 3,
}

/// A rank's own value and the values of all ranks, in order; `None` if a rank stops.
pub type Agreed<T, S = Vec<f64>> = Option<(T, Vec<S>)>;

/// The ranks of a run.
#[derive(Debug)]
pub struct ProcessGroup {
    ranks: Rc<dyn Ranks>,
    /// True if a failure was reported to all ranks.
    failure_reported: Cell<bool>,
    /// See [`saves_progress`](Self::saves_progress).
    saves_progress: Cell<bool>,
}

/// The kind of a message between ranks, stored in the message's first byte.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Tag {
    Outcome = 1,
    Plan = 2,
    Weights = 3,
    Losses = 4,
    Squares = 5,
    End = 6,
}

impl Default for ProcessGroup {
    /// A single process.
    fn default() -> Self {
        Self {
            ranks: Rc::new(Alone),
            failure_reported: Cell::new(false),
            saves_progress: Cell::new(false),
        }
    }
}

impl ProcessGroup {
    /// The group of `ranks`.
    pub fn new(ranks: Rc<dyn Ranks>) -> Rc<Self> {
        Rc::new(Self {
            ranks,
            ..Self::default()
        })
    }

    /// A single process.
    pub fn alone() -> Rc<Self> {
        Rc::default()
    }

    /// The ranks.
    pub fn ranks(&self) -> &dyn Ranks {
        &*self.ranks
    }

    /// True if this process writes the files.
    pub fn writes(&self) -> bool {
        self.ranks.is_first()
    }

    /// The values of all ranks for one tag, in rank order. Collective.
    ///
    /// # Panics
    /// Panics if another rank has another tag: the ranks are out of step.
    pub(crate) fn gather(&self, tag: Tag, own: &[u8]) -> Vec<Vec<u8>> {
        let mut message = vec![tag as u8];
        message.extend(own);
        let mut all = self.ranks.gather(&message);
        if let Some(other) = all.iter().position(|message| message[0] != tag as u8) {
            let own = self.ranks.rank();
            panic!("rank {own} sends {tag:?}, rank {other} sends another tag");
        }
        for message in &mut all {
            message.remove(0);
        }
        all
    }

    /// This rank's outcome and the values of all ranks; `None` if a rank stops. Collective.
    pub(crate) fn agree<T>(
        &self,
        own: Result<Option<T>, Error>,
        values: &[f64],
    ) -> Result<Agreed<T>, Error> {
        let bytes = || {
            values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect()
        };
        let agreed = self.verdict(own.map(|own| own.map(|own| (own, bytes()))))?;
        let decoded = |message: &Vec<u8>| {
            let (values, _) = message.as_chunks::<8>();
            let values = values.iter().map(|value| f64::from_le_bytes(*value));
            values.collect()
        };
        Ok(agreed.map(|(own, all)| (own, all.iter().map(decoded).collect())))
    }

    /// [`agree`](Self::agree) with bytes as the values of each rank.
    fn verdict<T>(
        &self,
        own: Result<Option<(T, Vec<u8>)>, Error>,
    ) -> Result<Agreed<T, Vec<u8>>, Error> {
        if self.ranks.size() == 1 {
            self.saves_progress.set(matches!(own, Err(Error::Data(_))));
            return own.map(|own| own.map(|(own, bytes)| (own, vec![bytes])));
        }
        let (status, code, bytes) = match &own {
            Ok(Some((_, bytes))) => (Status::Continues, 0, bytes.as_slice()),
            Ok(None) => (Status::Stops, 130, &[][..]),
            Err(error @ Error::Data(_)) => (Status::FailedData, error.exit_code(), &[][..]),
            Err(error) => (Status::Failed, error.exit_code(), &[][..]),
        };
        let mut message = vec![status as u8, code];
        message.extend(bytes);
        let mut all = self.gather(Tag::Outcome, &message);
        let is = |message: &Vec<u8>, status: Status| message[0] == status as u8;
        let failed =
            |message: &Vec<u8>| is(message, Status::Failed) || is(message, Status::FailedData);
        let first = all.iter().position(failed);
        // The verdict is the same on all ranks.
        let by_data_alone = !all.iter().any(|message| is(message, Status::Failed));
        self.saves_progress.set(first.is_some() && by_data_alone);
        if let Some(rank) = first {
            self.failure_reported.set(true);
            let code = all[rank][1];
            return Err(match own {
                Err(error) => error,
                Ok(_) => Error::OtherRank { rank, code },
            });
        }
        if !all.iter().all(|message| is(message, Status::Continues)) {
            return Ok(None);
        }
        for message in &mut all {
            message.drain(..2);
        }
        Ok(own?.map(|(own, _)| (own, all)))
    }

    /// True if only data failed, on any rank. Progress should then be saved before returning the
    /// error of [`agree`](Self::agree). The value is equal on all ranks.
    pub(crate) fn saves_progress(&self) -> bool {
        self.saves_progress.get()
    }

    /// Rejects ranks whose results could differ. Collective.
    ///
    /// # Errors
    /// As [`must_match`](Self::must_match).
    pub fn must_compute_alike(&self) -> Result<(), Error> {
        // Summation in kinegrad's kernels does not depend on the number of threads.
        let threads = match Mode::from_environment() {
            Ok(Mode::Composed) => rayon::current_num_threads().to_string(),
            _ => String::new(),
        };
        self.must_match(&[
            ("version of the program", env!("CARGO_PKG_VERSION")),
            ("number of threads", &threads),
            ("value of KINEGRAD_KERNELS", crate::device::kernels()),
        ])
    }

    /// A warning if several processes of a machine share a card. Collective.
    pub(crate) fn shared_card(&self, name: &str) -> Option<String> {
        // Some launchers show each process only its own card.
        let shown = std::env::var("CUDA_VISIBLE_DEVICES").unwrap_or_default();
        let machine = sysinfo::System::host_name().unwrap_or_default();
        let own = format!("`{name}` of {machine} {shown}");
        let all = self.gather(Tag::Plan, own.as_bytes());
        let sharing = |own: &&Vec<u8>| all.iter().filter(|other| other == own).count();
        let shared = all.iter().find(|own| sharing(own) > 1)?;
        Some(format!(
            "{} processes compute on one device, {}: start one for each card",
            sharing(&shared),
            String::from_utf8_lossy(shared).trim()
        ))
    }

    /// Rejects ranks with different values of `what`. Collective.
    ///
    /// # Errors
    /// [`Error::Usage`] names the first value that differs.
    pub fn must_match(&self, what: &[(&str, &str)]) -> Result<(), Error> {
        if self.ranks.size() == 1 {
            return Ok(());
        }
        for (name, own) in what {
            let all = self.gather(Tag::Plan, Digest::of(own.as_bytes()).to_string().as_bytes());
            if let Some(rank) = all.iter().position(|other| other != &all[0]) {
                return Err(Error::usage(
                    format!("rank {rank} has another {name} than rank 0"),
                    "all ranks need the same program, command and environment, and see the same files: \
                     data, configs and checkpoints belong on a file system that they share",
                ));
            }
        }
        Ok(())
    }

    /// The first rank that failed itself, and its exit code; `None` if no rank failed. Collective.
    pub fn first_failure(&self, own: Option<&Error>) -> Option<(usize, u8)> {
        let own = own.filter(|error| !matches!(error, Error::OtherRank { .. }));
        let message = own.map_or([0, 0], |error| [1, error.exit_code()]);
        let all = self.gather(Tag::End, &message);
        let rank = all.iter().position(|message| message[0] == 1)?;
        Some((rank, all[rank][1]))
    }

    /// Waits for all ranks, because launchers end all ranks when one returns a nonzero code.
    /// Collective.
    pub fn barrier(&self) {
        self.gather(Tag::End, &[]);
    }

    /// Reports a failure of this rank to all ranks, unless it was reported before. Collective on
    /// failure.
    ///
    /// # Errors
    /// The error of `outcome`.
    pub fn report_failure<T>(&self, outcome: Result<T, Error>) -> Result<T, Error> {
        match &outcome {
            Err(_) if !self.failure_reported.get() => self.done(outcome),
            _ => outcome,
        }
    }

    /// [`agree`](Self::agree) on a result that cannot be a stop.
    ///
    /// # Errors
    /// As [`agree`](Self::agree).
    pub fn done<T>(&self, own: Result<T, Error>) -> Result<T, Error> {
        let agreed = self.agree(own.map(Some), &[])?;
        let (own, _) = agreed.expect("no rank stops here");
        Ok(own)
    }

    /// Rejects weights that differ between ranks. Collective.
    pub(crate) fn must_have_equal(&self, step: u64, weights: &[Vec<f32>]) -> Result<(), Error> {
        if self.ranks.size() == 1 {
            return Ok(());
        }
        let parts = weights.iter().map(|values| bytemuck::cast_slice(values));
        let own = Digest::of_parts(parts).to_string();
        let all = self.gather(Tag::Weights, own.as_bytes());
        let other = all.iter().position(|other| other != &all[0]);
        other.map_or(Ok(()), |rank| Err(Error::RanksDiffer { step, rank }))
    }
}
