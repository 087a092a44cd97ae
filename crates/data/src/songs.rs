//! Songs of phrases.

use std::collections::BTreeSet;

use kinegrad_random::{Key, Purpose};

use crate::synthetic;

/// The song of phrase `id`: the `audio_source` in the manifest or, without one, the take in ids
/// `TAKE_FIRSTFRAME`. Each synthetic phrase has its own music.
pub fn song_of(id: &str, audio_source: Option<&str>) -> String {
    let synthetic = || {
        let number = id.rsplit_once('_')?.1.parse().ok()?;
        (id == synthetic::id(number)).then_some(id)
    };
    let take = || id.rsplit_once('_').map_or(id, |(take, _)| take);
    let song = audio_source.or_else(synthetic);
    song.unwrap_or_else(take).to_owned()
}

/// The held-out songs in alphabetical order: the share `fraction` of `songs` with the lowest name
/// hashes, at least one if `fraction` is not 0, never all.
pub fn held_out_songs(songs: BTreeSet<String>, fraction: f64) -> Vec<String> {
    let most = songs.len().saturating_sub(1);
    let share = (fraction * songs.len() as f64).round() as usize;
    let wanted = if fraction > 0.0 { share.max(1) } else { 0 };
    let hash = |song: &String| Key::new(0, Purpose::Split).named(song).uniform();
    let mut order: Vec<(f64, String)> = songs.into_iter().map(|song| (hash(&song), song)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.truncate(wanted.min(most));
    let mut held_out: Vec<String> = order.into_iter().map(|(_, song)| song).collect();
    held_out.sort_unstable();
    held_out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_stand_for_songs_that_are_not_stated() {
        for (id, stated, song) in [
            ("C_5_00188", None, "C_5"),
            ("C_5_00188", Some("songs/cha.mp3"), "songs/cha.mp3"),
            ("alone", None, "alone"),
            ("synthetic_00007", None, "synthetic_00007"),
            ("synthetic_7", None, "synthetic"),
            ("a_synthetic_00007", None, "a_synthetic"),
        ] {
            assert_eq!(song_of(id, stated), song, "{id} {stated:?}");
        }
    }
}
