//! What the ranks of a run agree on: all of them go on, or all of them end at the same point.
//!
//! Whatever one rank alone may meet (a signal, a file that is bad, a full disk, a number that is none) is
//! said to all before the next thing that they do together, so that none waits for one that has gone.

use std::cell::Cell;
use std::rc::Rc;

use kinegrad_data::Digest;
use kinegrad_ranks::{Alone, Ranks};

use crate::error::Error;

/// What a rank says of itself.
#[derive(Clone, Copy, PartialEq)]
enum Status {
    Goes = 0,
    Stops = 1,
    Failed = 2,
    /// It failed for its data: what was learned is worth keeping.
    FailedData = 3,
}

/// The ranks of a run.
#[derive(Debug)]
pub struct Together {
    ranks: Rc<dyn Ranks>,
    /// Whether they have agreed on anything yet.
    agreed: Cell<bool>,
}

impl Together {
    /// The ranks of a run that has not begun.
    pub fn new(ranks: Rc<dyn Ranks>) -> Rc<Self> {
        Rc::new(Self {
            ranks,
            agreed: Cell::new(false),
        })
    }

    /// A process by itself.
    pub fn alone() -> Rc<Self> {
        Self::new(Rc::new(Alone))
    }

    /// The ranks.
    pub fn ranks(&self) -> &dyn Ranks {
        &*self.ranks
    }

    /// Whether this process writes what there is to write.
    pub fn writes(&self) -> bool {
        self.ranks.is_first()
    }

    /// Whether the ranks have agreed on anything yet: what fails before has still to be said.
    pub fn has_agreed(&self) -> bool {
        self.agreed.get()
    }

    /// This rank's outcome and what all ranks say, if all of them go on; none if one stops. Collective.
    ///
    /// # Errors
    /// This rank's own error, or [`Error::OtherRank`].
    pub fn agree<T>(
        &self,
        own: Result<Option<T>, Error>,
        said: &[f64],
    ) -> Result<Option<(T, Vec<Vec<f64>>)>, Error> {
        self.agreed.set(true);
        if self.ranks.size() == 1 {
            return own.map(|own| own.map(|own| (own, vec![said.to_vec()])));
        }
        let (status, code) = match &own {
            Ok(Some(_)) => (Status::Goes, 0),
            Ok(None) => (Status::Stops, 130),
            Err(error @ Error::Data(_)) => (Status::FailedData, error.exit_code()),
            Err(error) => (Status::Failed, error.exit_code()),
        };
        let mut message = vec![status as u8, code];
        message.extend(said.iter().flat_map(|value| value.to_le_bytes()));
        let all = self.ranks.gather(&message);
        let failed = |message: &Vec<u8>| message[0] >= Status::Failed as u8;
        if let Some(rank) = all.iter().position(failed) {
            return Err(match own {
                Err(error) => error,
                Ok(_) => Error::OtherRank {
                    rank,
                    code: all[rank][1],
                    of_data: all[rank][0] == Status::FailedData as u8,
                },
            });
        }
        let goes = |message: &Vec<u8>| message[0] == Status::Goes as u8;
        if !all.iter().all(goes) {
            return Ok(None);
        }
        let values = |message: &Vec<u8>| {
            let (values, _) = message[2..].as_chunks::<8>();
            values
                .iter()
                .map(|value| f64::from_le_bytes(*value))
                .collect()
        };
        let said = all.iter().map(values).collect();
        Ok(own?.map(|own| (own, said)))
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
        let mut bytes = Vec::with_capacity(4 * weights.iter().map(Vec::len).sum::<usize>());
        let values = weights.iter().flatten();
        bytes.extend(values.flat_map(|value| value.to_le_bytes()));
        let own = Digest::of(&bytes).to_string();
        let all = self.ranks.gather(own.as_bytes());
        let differs = |other: &Vec<u8>| other != &all[0];
        match all.iter().position(differs) {
            None => Ok(()),
            Some(rank) => Err(Error::RanksDiffer { step, rank }),
        }
    }
}
