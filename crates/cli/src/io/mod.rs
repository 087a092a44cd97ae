//! Finds, reads and writes motion files.

mod bvh;
mod find;
mod motion;
mod outputs;
mod samples;
mod unusable;

pub use bvh::{
    BvhReading, CENTIMETRES, Capture, LEGS_SHORT, as_bvh, bvh_file, bvh_text, is_bvh, is_foot,
    names, read_body, read_bvh, read_figures, unit_and_axis,
};
pub use find::{file_stem, files_in, has_extension, is_companion, motion_files, with_raw};
pub use motion::{Motion, MotionArray, not_finite};
pub use outputs::{Content, must_be_new, stem, with_ending, write_all};
pub use samples::{Files, Written, must_be_finite};
pub use unusable::{exit_code, unusable_path, unusable_stem};
