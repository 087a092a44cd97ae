//! Source frames of a motion, from the record that `kinegrad match` wrote beside it.

use std::path::{Path, PathBuf};

use kinegrad_data::file::read_file;
use kinegrad_report::scene::{Origins, PartOrigins};
use serde::Deserialize;

use crate::io::file_stem;

/// Largest record, bytes.
const LARGEST: u64 = 1 << 26;

/// The parts of a record that are read.
#[derive(Deserialize)]
struct Record {
    examples: Vec<PathBuf>,
    example_frames: Vec<usize>,
    frames: usize,
    parts: Vec<PartOrigins>,
}

/// The source frames of a motion with `frames` frames in a file; `None` without a matching record.
pub fn beside(motion: &Path, frames: usize) -> Option<Origins> {
    let bytes = read_file(&motion.with_extension("json"), LARGEST).ok()?;
    let record: Record = serde_json::from_slice(&bytes).ok()?;
    let lengths = &record.example_frames;
    if record.frames != frames || lengths.len() != record.examples.len() {
        return None;
    }
    for part in &record.parts {
        let mut next = 0;
        for &[start, example, first, frames] in &part.runs {
            let within = first.checked_add(frames)? <= *lengths.get(example)?;
            if start != next || frames == 0 || !within {
                return None;
            }
            next = start.checked_add(frames)?;
        }
        if next != frames {
            return None;
        }
    }
    let names = record.examples.iter().map(|path| file_stem(path));
    let examples = names.zip(record.example_frames).collect();
    let parts = record.parts;
    (!parts.is_empty()).then_some(Origins { examples, parts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_of_this_motion_alone_have_origins() {
        let folder = tempfile::tempdir().unwrap();
        let motion = folder.path().join("new.bvh");
        let record = |runs: &str| {
            let text = format!(
                r#"{{"examples": ["a/walk.bvh", "run.bvh"], "example_frames": [40, 30],
                    "frames": 9, "parts": [{{"name": "body", "runs": {runs}}}], "seed": 1}}"#
            );
            std::fs::write(folder.path().join("new.json"), text).unwrap();
        };
        assert!(beside(&motion, 9).is_none());
        record("[[0, 1, 24, 6], [6, 0, 3, 3]]");
        let origins = beside(&motion, 9).unwrap();
        assert_eq!(
            origins.examples,
            [("walk".to_string(), 40), ("run".to_string(), 30)]
        );
        assert_eq!(origins.parts[0].runs[1][2], 3);
        assert!(beside(&motion, 10).is_none());
        for runs in [
            "[[0, 1, 25, 6], [6, 0, 3, 3]]",
            "[[0, 2, 0, 9]]",
            "[[0, 0, 0, 6], [7, 0, 3, 2]]",
            "[[0, 0, 0, 6]]",
            "[]",
            "[[0, 0, 18446744073709551615, 9]]",
        ] {
            record(runs);
            assert!(beside(&motion, 9).is_none(), "{runs}");
        }
        std::fs::write(folder.path().join("new.json"), r#"{"seed": 1}"#).unwrap();
        assert!(beside(&motion, 9).is_none());
    }
}
