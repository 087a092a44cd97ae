//! The split into training and validation phrases.

use std::collections::BTreeSet;
use std::fmt;
use std::path::Path;

use kinegrad_random::{Key, Purpose};
use serde::{Deserialize, Serialize};

use crate::file::read_text;
use crate::pattern::{idle, matches};
use crate::songs::{held_out_songs, song_of};
use crate::{Error, ValidationSplit};

/// Default share of held-out phrases.
const DEFAULT_FRACTION: f64 = 0.1;

/// The rule of a [`ValidationSplit`], with its file already read.
#[derive(Debug)]
pub(crate) struct Split {
    patterns: Vec<String>,
    rule: Rule,
}

/// A side of the split, as in a manifest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// To train on.
    Train,
    /// Held out.
    Validation,
}

impl fmt::Display for Side {
    /// `train` or `validation`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The rule of the split, except for patterns.
#[derive(Debug, PartialEq)]
enum Rule {
    /// Only phrases that match a pattern are held out.
    Listed,
    /// A hash of the id.
    Fraction(f64),
    /// The manifest.
    Manifest,
}

impl Split {
    /// The rule of `config`.
    pub fn new(config: &ValidationSplit) -> Result<Self, Error> {
        let mut patterns = config.patterns.clone();
        let listed = !patterns.is_empty() || config.ids_file.is_some();
        if let Some(file) = &config.ids_file {
            let text = read_text(Path::new(file))
                .map_err(|reason| Error::io("read data.validation.ids_file", file, reason))?;
            let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
            let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
            patterns.extend(lines.map(String::from));
        }
        let rule = match config.fraction {
            _ if listed => Rule::Listed,
            Some(fraction) => Rule::Fraction(fraction),
            None => Rule::Manifest,
        };
        Ok(Self { patterns, rule })
    }

    /// For each phrase, given by id and side in the manifest: true if it is held out. Phrases
    /// without a side are split by whole songs ([`held_out_songs`]), or singly if each phrase is a
    /// song or all phrases share one song.
    pub fn holds_out(&self, phrases: &[(&str, Option<Side>)]) -> Vec<bool> {
        // The hash is independent of the run's seed, so runs are comparable.
        let hashed =
            |id: &str, fraction| Key::new(0, Purpose::Split).named(id).uniform() < fraction;
        let unstated = || phrases.iter().filter(|(_, stated)| stated.is_none());
        let songs: BTreeSet<String> = unstated().map(|(id, _)| song_of(id, None)).collect();
        let by_song = songs.len() > 1 && songs.len() < unstated().count();
        let songs = by_song.then(|| held_out_songs(songs, DEFAULT_FRACTION));
        let holds_out = |(id, stated): &(&str, Option<Side>)| match (&self.rule, stated, &songs) {
            (Rule::Listed, ..) => self.patterns.iter().any(|pattern| matches(pattern, id)),
            (Rule::Fraction(fraction), ..) => hashed(id, *fraction),
            (Rule::Manifest, Some(side), _) => *side == Side::Validation,
            (Rule::Manifest, None, Some(songs)) => songs.contains(&song_of(id, None)),
            (Rule::Manifest, None, None) => hashed(id, DEFAULT_FRACTION),
        };
        phrases.iter().map(holds_out).collect()
    }

    /// A warning for each id or pattern that matches none of `ids`.
    pub fn idle_entries<'a>(&'a self, ids: impl Iterator<Item = &'a str> + Clone) -> Vec<String> {
        idle("data.validation", self.patterns.iter(), ids)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use proptest::prelude::*;

    fn split(
        fraction: impl Into<Option<f64>>,
        patterns: &[&str],
        ids_file: Option<String>,
    ) -> Split {
        let patterns = patterns.iter().map(|&pattern| pattern.to_owned()).collect();
        Split::new(&ValidationSplit {
            fraction: fraction.into(),
            patterns,
            ids_file,
        })
        .unwrap()
    }

    /// True if the rule holds out one phrase by itself.
    fn alone(split: &Split, id: &str, stated: Option<Side>) -> bool {
        split.holds_out(&[(id, stated)])[0]
    }

    #[test]
    fn the_fraction_is_met_and_adding_phrases_moves_none() {
        let rule = split(0.1, &[], None);
        let ids: Vec<String> = (0..5000).map(|i| format!("song_{i:05}")).collect();
        let held_out = ids.iter().filter(|id| alone(&rule, id, None)).count();
        assert!((430..570).contains(&held_out), "{held_out}");
        assert!(
            ids.iter()
                .all(|id| !alone(&split(0.0, &[], None), id, None))
        );
        let more = split(0.3, &[], None);
        assert!(
            ids.iter()
                .all(|id| !alone(&rule, id, None) || alone(&more, id, None))
        );
    }

    #[test]
    fn lists_replace_the_fraction_and_idle_entries_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ids.txt").display().to_string();
        fs::write(&file, "\u{feff}# held out\r\nW_1\r\n\r\n  X_*\n").unwrap();
        let rule = split(0.99, &["C_5_*"], Some(file.clone()));
        let ids = ["C_5_1", "C_2_1", "W_1", "W_10"];
        assert_eq!(
            ids.map(|id| alone(&rule, id, None)),
            [true, false, true, false]
        );
        assert_eq!(
            rule.idle_entries(ids.into_iter()),
            ["data.validation: `X_*` matches no phrase"]
        );
        fs::write(&file, "").unwrap();
        assert!(!alone(&split(0.99, &[], Some(file)), "C_5_1", None));
    }

    #[test]
    fn the_manifest_s_split_is_the_default() {
        let rule = split(None, &[], None);
        assert!(alone(&rule, "a", Some(Side::Validation)));
        assert!(!alone(&rule, "a", Some(Side::Train)));
        let tenth = split(0.1, &[], None);
        for id in ["a", "b", "c_00120", "d"] {
            assert_eq!(alone(&rule, id, None), alone(&tenth, id, None));
            assert_eq!(
                alone(&tenth, id, Some(Side::Validation)),
                alone(&tenth, id, None)
            );
        }
        let listed = split(None, &["a"], None);
        assert!(!alone(&listed, "b", Some(Side::Validation)));
        assert!(alone(&listed, "a", Some(Side::Train)));
    }

    #[test]
    fn songs_are_held_out_whole_by_default() {
        let rule = split(None, &[], None);
        let held_out = |ids: &[String]| -> BTreeSet<String> {
            let phrases: Vec<_> = ids.iter().map(|id| (id.as_str(), None)).collect();
            let held_out = ids.iter().zip(rule.holds_out(&phrases));
            held_out
                .filter(|(_, held_out)| *held_out)
                .map(|(id, _)| id.clone())
                .collect()
        };
        let of = |songs: &[&str], phrases: usize| -> Vec<String> {
            let of = |song: &&str| {
                (0..phrases)
                    .map(|k| format!("{song}_{:05}", 120 * k))
                    .collect()
            };
            songs
                .iter()
                .flat_map(|song| -> Vec<String> { of(song) })
                .collect()
        };
        // All phrases of a song lie on one side, for few songs and for many.
        for songs in [&["C_2", "W_1"][..], &["a", "b", "c", "d", "e", "f", "g"]] {
            let ids = of(songs, 9);
            let held_out = held_out(&ids);
            let sides: BTreeSet<&str> = held_out
                .iter()
                .map(|id| id.rsplit_once('_').unwrap().0)
                .collect();
            assert_eq!((held_out.len(), sides.len()), (9, 1), "{held_out:?}");
        }
        // Sides in the manifest are kept and do not count as songs.
        let stated = [
            ("x_0", Some(Side::Train)),
            ("x_1", None),
            ("y_0", None),
            ("y_1", None),
        ];
        let flags = rule.holds_out(&stated);
        assert!(
            !flags[0] && flags[1] != flags[2] && flags[2] == flags[3],
            "{flags:?}"
        );
        // A dataset of one song is split by phrase. Each synthetic phrase is a song.
        let one = of(&["C_2"], 200);
        assert!((5..40).contains(&held_out(&one).len()));
        let synthetic: Vec<String> = (0..200).map(crate::synthetic::id).collect();
        let alone = synthetic.iter().filter(|id| alone(&rule, id, None)).count();
        assert_eq!(held_out(&synthetic).len(), alone);
    }

    #[test]
    fn a_missing_file_is_named() {
        let config = ValidationSplit {
            ids_file: Some("/no/such/list".into()),
            ..Default::default()
        };
        let message = Split::new(&config).unwrap_err().to_string();
        assert!(
            message.contains("/no/such/list") && message.contains("ids_file"),
            "{message}"
        );
    }

    proptest! {
        #[test]
        fn a_pattern_made_from_an_id_matches_it(parts in proptest::collection::vec("[a-c]{0,3}", 1..6)) {
            prop_assert!(matches(&parts.join("*"), &parts.join("ab")));
            prop_assert!(matches(&parts.concat(), &parts.concat()));
            let longer = format!("{}d", parts.concat());
            prop_assert!(!matches(&parts.concat(), &longer));
        }
    }
}
