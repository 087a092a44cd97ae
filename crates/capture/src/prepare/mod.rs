//! The preparation of datasets, whatever their items are.
//!
//! A plan lists takes. The items of each take are written, then an index of all items. Finished
//! takes are recorded in `prepare/takes/TAKE.json`: an interrupted preparation continues with the
//! remaining takes, and a take is not processed again until its plan or its files change.

mod driver;
pub(crate) mod files;
mod journal;
pub(crate) mod output;
mod report;

pub(crate) use driver::{Journals, Maker, Report, Row, make_takes};
pub use driver::{PrepareObserver, PrepareOptions};
pub use report::Rejection;
