//! Agreement of ranks: all continue, or all end at the same point.
//!
//! An event of one rank (a signal, a bad file, a full disk, a non-finite number) is reported to all
//! ranks before the next collective operation, so that none waits for a rank that has ended.

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
    Goes = 0,
    Stops = 1,
    Failed = 2,
    /// It failed for its data: what was learned is worth keeping.
    FailedData = 3,
}

/// A rank's own value and the values of all ranks, in order; `None` if one of them stops.
pub type Agreed<T, S = Vec<f64>> = Option<(T, Vec<S>)>;

/// The ranks of a run.
#[derive(Debug)]
pub struct ProcessGroup {
    ranks: Rc<dyn Ranks>,
    /// True if all ranks know of a failure.
    knows: Cell<bool>,
    /// See [`saves_progress`](Self::saves_progress).
    keeps: Cell<bool>,
}

/// The kind of a message between ranks, its first byte.
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
    /// A process by itself.
    fn default() -> Self {
        Self::of(Rc::new(Alone))
    }
}

impl ProcessGroup {
    /// The ranks of a run that has not begun.
    pub fn new(ranks: Rc<dyn Ranks>) -> Rc<Self> {
        Rc::new(Self::of(ranks))
    }

    fn of(ranks: Rc<dyn Ranks>) -> Self {
        Self {
            ranks,
            knows: Cell::new(false),
            keeps: Cell::new(false),
        }
    }

    /// A process by itself.
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
    pub(crate) fn gather(&self, about: Tag, own: &[u8]) -> Vec<Vec<u8>> {
        let mut message = vec![about as u8];
        message.extend(own);
        let mut all = self.ranks.gather(&message);
        if let Some(other) = all.iter().position(|said| said[0] != about as u8) {
            let own = self.ranks.rank();
            panic!("rank {own} speaks of {about:?}, and rank {other} of something else");
        }
        for said in &mut all {
            said.remove(0);
        }
        all
    }

    /// This rank's outcome and the values of all ranks, if all continue; `None` if one stops.
    /// Collective.
    ///
    /// # Errors
    /// This rank's own error, or [`Error::OtherRank`].
    pub fn agree<T>(
        &self,
        own: Result<Option<T>, Error>,
        said: &[f64],
    ) -> Result<Agreed<T>, Error> {
        let bytes = || said.iter().flat_map(|value| value.to_le_bytes()).collect();
        let agreed = self.verdict(own.map(|own| own.map(|own| (own, bytes()))))?;
        let values = |message: &Vec<u8>| {
            let (values, _) = message.as_chunks::<8>();
            let values = values.iter().map(|value| f64::from_le_bytes(*value));
            values.collect()
        };
        Ok(agreed.map(|(own, said)| (own, said.iter().map(values).collect())))
    }

    /// [`agree`](Self::agree), each rank saying some bytes with what it has.
    fn verdict<T>(
        &self,
        own: Result<Option<(T, Vec<u8>)>, Error>,
    ) -> Result<Agreed<T, Vec<u8>>, Error> {
        if self.ranks.size() == 1 {
            self.keeps.set(matches!(own, Err(Error::Data(_))));
            return own.map(|own| own.map(|(own, said)| (own, vec![said])));
        }
        let (status, code, said) = match &own {
            Ok(Some((_, said))) => (Status::Goes, 0, said.as_slice()),
            Ok(None) => (Status::Stops, 130, &[][..]),
            Err(error @ Error::Data(_)) => (Status::FailedData, error.exit_code(), &[][..]),
            Err(error) => (Status::Failed, error.exit_code(), &[][..]),
        };
        let mut message = vec![status as u8, code];
        message.extend(said);
        let mut all = self.gather(Tag::Outcome, &message);
        let is = |message: &Vec<u8>, status: Status| message[0] == status as u8;
        let failed =
            |message: &Vec<u8>| is(message, Status::Failed) || is(message, Status::FailedData);
        let first = all.iter().position(failed);
        // One verdict, the same on all ranks whatever each has met itself.
        let by_data_alone = !all.iter().any(|message| is(message, Status::Failed));
        self.keeps.set(first.is_some() && by_data_alone);
        if let Some(rank) = first {
            self.knows.set(true);
            let code = all[rank][1];
            return Err(match own {
                Err(error) => error,
                Ok(_) => Error::OtherRank { rank, code },
            });
        }
        if !all.iter().all(|message| is(message, Status::Goes)) {
            return Ok(None);
        }
        for message in &mut all {
            message.drain(..2);
        }
        Ok(own?.map(|(own, _)| (own, all)))
    }

    /// True if progress before the error of [`agree`](Self::agree) should be saved, equal on all
    /// ranks: only the data failed, on any of them.
    pub fn saves_progress(&self) -> bool {
        self.keeps.get()
    }

    /// Rejects ranks of which one and the same work may come out differently. Collective.
    ///
    /// # Errors
    /// As [`must_match`](Self::must_match).
    pub fn must_compute_alike(&self) -> Result<(), Error> {
        // kinegrad's own kernels add in one order whatever the number of threads.
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

    /// A warning if several processes of a machine compute on one card. Collective.
    pub(crate) fn shared_card(&self, name: &str) -> Option<String> {
        // A launcher that gives each process a card shows it no other.
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

    /// Rejects ranks that are not about to do the same. Collective.
    ///
    /// # Errors
    /// [`Error::Usage`] names the first of `what` that differs, by its name.
    pub fn must_match(&self, what: &[(&str, &str)]) -> Result<(), Error> {
        if self.ranks.size() == 1 {
            return Ok(());
        }
        for (name, own) in what {
            let all = self.gather(Tag::Plan, Digest::of(own.as_bytes()).to_string().as_bytes());
            if let Some(rank) = all.iter().position(|said| said != &all[0]) {
                return Err(Error::usage(
                    format!("rank {rank} has another {name} than rank 0"),
                    "all ranks need the same program, command and environment, and see the same files: \
                     data, configs and checkpoints belong on a file system that they share",
                ));
            }
        }
        Ok(())
    }

    /// The end of the run, if any rank failed: the first rank with an error of its own, and its
    /// exit code. Collective.
    pub fn first_failure(&self, own: Option<&Error>) -> Option<(usize, u8)> {
        let own = own.filter(|error| !matches!(error, Error::OtherRank { .. }));
        let message = own.map_or([0, 0], |error| [1, error.exit_code()]);
        let all = self.gather(Tag::End, &message);
        let rank = all.iter().position(|said| said[0] == 1)?;
        Some((rank, all[rank][1]))
    }

    /// Waits until all ranks have come as far as this: launchers end the others as soon as one has returned a
    /// code that is not 0. Collective.
    pub fn part(&self) {
        self.gather(Tag::End, &[]);
    }

    /// Reports this rank's own failure to all ranks between two collective operations, unless they
    /// know it. Collective if it has failed.
    ///
    /// # Errors
    /// The error of `outcome`.
    pub fn report_failure<T>(&self, outcome: Result<T, Error>) -> Result<T, Error> {
        match &outcome {
            Err(_) if !self.knows.get() => self.done(outcome),
            _ => outcome,
        }
    }

    /// [`agree`](Self::agree) of what either is done or fails.
    ///
    /// # Errors
    /// As [`agree`](Self::agree).
    pub fn done<T>(&self, own: Result<T, Error>) -> Result<T, Error> {
        let agreed = self.agree(own.map(Some), &[])?;
        let (own, _) = agreed.expect("nobody stops here");
        Ok(own)
    }

    /// Rejects weights that are not the same on all ranks. Collective.
    ///
    /// # Errors
    /// [`Error::RanksDiffer`].
    pub fn must_have_equal(&self, step: u64, weights: &[Vec<f32>]) -> Result<(), Error> {
        if self.ranks.size() == 1 {
            return Ok(());
        }
        let parts = weights.iter().map(|values| bytemuck::cast_slice(values));
        let own = Digest::of_parts(parts).to_string();
        let all = self.gather(Tag::Weights, own.as_bytes());
        let differs = |other: &Vec<u8>| other != &all[0];
        match all.iter().position(differs) {
            None => Ok(()),
            Some(rank) => Err(Error::RanksDiffer { step, rank }),
        }
    }
}
