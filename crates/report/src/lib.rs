//! Reports: tables, side-by-side columns, CSV, plots of named values, and motion to look at.

mod columns;
mod export;
pub mod gif;
pub mod glb;
pub mod mp4;
pub mod page;
mod picture;
pub mod raster;
pub mod scene;
mod table;
pub mod viewer;

pub use columns::{Column, Section, columns_csv, columns_table};
pub use export::{ExportError, check as must_be_exportable};
pub use picture::{
    Panel, PictureError, Png, Pose, Series, body_panels, check_ending, draw, draw_png,
};
pub use table::{facts, grouped, rows, table};
