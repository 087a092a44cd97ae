//! Reports: tables, columns side by side, CSV, plots, and motion as pages, pictures and files.

mod columns;
mod drawing;
mod encoder;
mod escape;
mod export;
mod font;
pub mod gif;
pub mod glb;
pub mod mp4;
pub mod page;
mod picture;
mod raster;
pub mod scene;
mod table;
pub mod viewer;

pub use columns::{Column, Section, columns_csv, columns_table};
pub use export::{ExportError, Stop, check as must_be_exportable};
pub use picture::{Panel, PictureError, Series, body_panels, check_ending, draw, draw_png};
pub use table::{facts, grouped, rows, rows_within, table, wrapped};
