//! One file per command.

pub mod audio;
pub mod check;
pub mod config;
pub mod data;
pub mod devices;
mod estimate;
pub mod eval;
pub mod explain;
pub mod import;
pub mod init;
pub mod matching;
pub mod merge;
pub mod plot;
pub mod prepare;
pub mod report;
pub mod runs;
pub mod sample;
pub mod shell;
pub mod text;
pub mod train;
pub mod view;
pub mod warp;

/// The name in `names` nearest to `found`, if similar.
fn nearest<'a>(found: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let similar = names.map(|name| (strsim::jaro_winkler(found, name), name));
    let near = similar.filter(|(similarity, _)| *similarity > 0.8);
    near.max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}
