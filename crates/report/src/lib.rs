//! Results for people and for other programs: tables, columns side by side, CSV and pictures.
//!
//! Takes names and numbers, and knows nothing of where they come from.

mod columns;
mod picture;
mod table;

pub use columns::{Column, Section, columns_csv, columns_table};
pub use picture::{Panel, PictureError, Series, check_ending, draw};
pub use table::{facts, grouped, rows, table};
