//! Reports: tables, side-by-side columns, CSV and plots of named values.

mod columns;
mod picture;
mod table;

pub use columns::{Column, Section, columns_csv, columns_table};
pub use picture::{Panel, PictureError, Series, check_ending, draw};
pub use table::{facts, grouped, rows, table};
