//! The preparation of datasets: the items of each take of a plan, then an index of all items.
//!
//! Finished takes are recorded in `prepare/takes/TAKE.json`. A take is processed again only if its
//! plan or its files have changed.

mod driver;
pub(crate) mod files;
mod journal;
pub(crate) mod output;

pub(crate) use driver::{Journals, Maker, Report, Row, make_takes};
pub use driver::{PrepareObserver, PrepareOptions, Rejection};
