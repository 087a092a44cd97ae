//! What the program writes and prints: atomic [files](write()), [text](message) without control
//! characters, and [paths](path_text) in JSON.
//!
//! No other crate of kinegrad opens a file for writing.
//!
//! ```
//! # fn main() -> std::io::Result<()> {
//! # let folder = tempfile::tempdir()?;
//! let page = folder.path().join("page.html");
//! kinegrad_output::write(&page, b"old")?;
//! kinegrad_output::write(&page, b"new")?;
//! assert_eq!(std::fs::read(page)?, b"new");
//! assert_eq!(kinegrad_output::message("a\u{1b}[2Jb"), "a\\u{1b}[2Jb");
//! # Ok(())
//! # }
//! ```

mod file;
mod folder;
mod paths;
mod text;

pub use file::{
    Unfinished, append, is_unfinished, lock, must_be_writable, remove_unfinished, write, write_new,
};
pub use folder::UnfinishedFolder;
pub use paths::{PathText, path_text};
pub use text::{MOST, block, cell, is_formula, line, message};
