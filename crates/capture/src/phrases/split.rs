//! Division of phrases into training and validation sets.

use std::collections::BTreeSet;

use kinegrad_data::manifest::ManifestRow;
use kinegrad_data::{Side, held_out_songs, matches, song_of};

use crate::plan::SplitPlan;

/// The held-out songs.
#[derive(Debug, Default, PartialEq)]
pub(super) struct SplitResult {
    /// Songs that `fraction` holds out; a take without a song counts as one.
    pub held_out: Vec<String>,
    /// A note for the report.
    pub note: Option<String>,
}

impl SplitPlan {
    /// Sets the split of each row. Without patterns, `fraction` of the songs is held out: the songs
    /// whose names have the lowest hashes, at least one and never all.
    pub(super) fn divide(&self, rows: &mut [ManifestRow]) -> SplitResult {
        let side = |held_out| match held_out {
            true => Some(Side::Validation),
            false => Some(Side::Train),
        };
        if !self.validation.is_empty() {
            for row in rows {
                row.split = side(self.validation.iter().any(|p| matches(p, &row.id)));
            }
            return SplitResult::default();
        }
        let songs: BTreeSet<String> = rows.iter().map(song).collect();
        let alone = songs.len() == 1 && self.fraction > 0.0;
        let held_out = held_out_songs(songs, self.fraction);
        for row in rows {
            row.split = side(held_out.contains(&song(row)));
        }
        let note = "one song alone: no phrase is held out, because phrases of a training song do not \
                    measure generalisation (name some in `split.validation` to hold them out)";
        SplitResult {
            note: alone.then(|| note.to_owned()),
            held_out,
        }
    }
}

/// The song of a row, else its take.
fn song(row: &ManifestRow) -> String {
    song_of(&row.id, row.audio_source.as_deref())
}

#[cfg(test)]
mod tests {
    use kinegrad_data::Digest;

    use super::*;

    fn rows(songs: &[(&str, Option<&str>, usize)]) -> Vec<ManifestRow> {
        let row = |take: &str, song: &Option<&str>, k: usize| ManifestRow {
            id: format!("{take}_{:05}", 30 * k),
            motion_source: "m".to_owned(),
            audio_source: song.map(str::to_owned),
            first_frame: 0,
            frames: 30,
            fps: 30.0,
            beats: None,
            tempo: None,
            split: None,
            motion_bytes: 0,
            motion_sha256: Digest::of(b""),
            audio_bytes: 0,
            audio_sha256: Digest::of(b""),
            audio_features: None,
            label: None,
            flags: Vec::new(),
        };
        let of = |(take, song, phrases): &(&str, Option<&str>, usize)| {
            (0..*phrases)
                .map(|k| row(take, song, k))
                .collect::<Vec<_>>()
        };
        songs.iter().flat_map(of).collect()
    }

    fn held_out(rows: &[ManifestRow]) -> Vec<&str> {
        let rows = rows
            .iter()
            .filter(|row| row.split == Some(Side::Validation));
        rows.map(|row| row.id.as_str()).collect()
    }

    #[test]
    fn whole_songs_are_held_out_at_least_one_and_never_all() {
        for songs in 2..40 {
            let names: Vec<String> = (0..songs).map(|k| format!("{k}.mp3")).collect();
            // Two takes of every song, and one without.
            let takes: Vec<(String, Option<&str>, usize)> = names
                .iter()
                .flat_map(|name| [("a", name), ("b", name)])
                .map(|(take, name)| (format!("{take}{name}"), Some(name.as_str()), 3))
                .collect();
            let mut takes: Vec<(&str, Option<&str>, usize)> = takes
                .iter()
                .map(|(take, song, n)| (take.as_str(), *song, *n))
                .collect();
            takes.push(("alone", None, 2));
            let mut rows = rows(&takes);
            let divided = SplitPlan::default().divide(&mut rows);
            let found = &divided.held_out;
            let share = (0.1 * (songs + 1) as f64).round() as usize;
            assert_eq!(found.len(), share.max(1), "{found:?}");
            assert_eq!(divided.note, None);
            for row in &rows {
                let wanted = found.contains(&song(row));
                assert_eq!(row.split == Some(Side::Validation), wanted, "{}", row.id);
            }
            let mut again = rows.clone();
            again.reverse();
            assert_eq!(SplitPlan::default().divide(&mut again), divided);
        }
    }

    #[test]
    fn one_song_is_divided_only_if_the_plan_names_phrases() {
        let mut rows = rows(&[("a", Some("s"), 5), ("b", Some("s"), 5)]);
        let divided = SplitPlan::default().divide(&mut rows);
        assert!(held_out(&rows).is_empty() && divided.held_out.is_empty());
        assert!(divided.note.expect("a sentence").contains("one song alone"));
        let named = SplitPlan {
            validation: vec!["b_0003*".to_owned()],
            ..SplitPlan::default()
        };
        assert_eq!(named.divide(&mut rows), SplitResult::default());
        assert_eq!(held_out(&rows), ["b_00030"]);
        let none = SplitPlan {
            fraction: 0.0,
            ..SplitPlan::default()
        };
        assert_eq!(none.divide(&mut rows), SplitResult::default());
        assert!(held_out(&rows).is_empty());
    }
}
