//! Reports: tables, side-by-side columns, CSV, plots of named values, and motion to look at.

mod columns;
mod picture;
pub mod scene;
mod table;
pub mod viewer;

pub use columns::{Column, Section, columns_csv, columns_table};
pub use picture::{Panel, PictureError, Series, check_ending, draw};
pub use table::{facts, grouped, rows, table};
