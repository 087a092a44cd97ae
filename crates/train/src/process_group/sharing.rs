//! Work shared by the ranks of a run.

use kinegrad_ranks::{Sharing, shared};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::ProcessGroup;
use crate::error::Error;

impl ProcessGroup {
    /// The results of `make` for `count` items, in order, shared among the ranks. Collective.
    ///
    /// # Errors
    /// The first error of this rank, or [`Error::OtherRank`].
    pub fn each<T: Serialize + DeserializeOwned>(
        &self,
        count: usize,
        make: impl FnMut(usize) -> Result<T, Error>,
    ) -> Result<Vec<T>, Error> {
        shared(
            self,
            0..count,
            |number| number,
            |own| own.into_iter().map(make).collect(),
        )
    }

    /// The number of this rank's items before `number`, and the total of this rank's items.
    pub(crate) fn own_of(&self, number: usize, count: usize) -> [usize; 2] {
        let (rank, size) = (self.ranks().rank(), self.ranks().size());
        [number, count].map(|end| end.saturating_sub(rank).div_ceil(size))
    }
}

impl Sharing<Error> for ProcessGroup {
    fn rank(&self) -> usize {
        self.ranks().rank()
    }

    fn size(&self) -> usize {
        self.ranks().size()
    }

    fn exchange(&self, own: Result<Vec<u8>, Error>) -> Result<Vec<Vec<u8>>, Error> {
        let all = self.verdict(own.map(|own| Some(((), own))))?;
        let (_, all) = all.expect("no rank stops here");
        Ok(all)
    }
}

impl Sharing<kinegrad_data::Error> for ProcessGroup {
    fn rank(&self) -> usize {
        self.ranks().rank()
    }

    fn size(&self) -> usize {
        self.ranks().size()
    }

    fn exchange(
        &self,
        own: Result<Vec<u8>, kinegrad_data::Error>,
    ) -> Result<Vec<Vec<u8>>, kinegrad_data::Error> {
        let all = Sharing::<Error>::exchange(self, own.map_err(Error::from));
        all.map_err(|error| match error {
            Error::Data(own) => own,
            Error::Interrupted => kinegrad_data::Error::Interrupted,
            Error::OtherRank { rank, code } => kinegrad_data::Error::OtherReader { rank, code },
            other => unreachable!("an error of data, not {other}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_process_makes_all() {
        let group = ProcessGroup::alone();
        let made = group.each(4, |number| Ok(number * 2));
        assert_eq!(made.expect("nothing failed"), [0, 2, 4, 6]);
        assert_eq!(group.own_of(3, 4), [3, 4]);
        let failed = group.each(4, |number| match number {
            2 => Err(Error::Interrupted),
            _ => Ok(number),
        });
        assert!(matches!(failed, Err(Error::Interrupted)));
    }
}
