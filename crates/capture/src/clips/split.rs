//! Division of takes into training, validation and test sets.

use std::collections::BTreeMap;

use kinegrad_data::matches;

use super::captions::Labels;
use crate::plan::SplitPlan;

/// The set of a clip.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(super) enum Part {
    Train,
    Val,
    Test,
}

impl Part {
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The file with the ids of its clips.
    pub fn list(self) -> &'static str {
        match self {
            Self::Train => "train.txt",
            Self::Val => "val.txt",
            Self::Test => "test.txt",
        }
    }

    /// `train`, `val` or `test`.
    pub fn name(self) -> &'static str {
        self.list().trim_end_matches(".txt")
    }
}

/// The properties of a take that decide its set.
#[derive(Clone, Debug)]
pub(super) struct SplitTake<'a> {
    pub name: &'a str,
    /// Takes with the same labels are a group.
    pub labels: &'a Labels,
    /// Its number within the group.
    pub number: Option<u64>,
    /// Takes of one motion file are in the same set.
    pub file: String,
}

/// The sets of a plan's takes.
#[derive(Clone, Debug, Eq, PartialEq)]
pub(super) struct Parts {
    /// The set of each take, in their order.
    pub lists: Vec<Part>,
    /// Notes for the report.
    pub notes: Vec<String>,
}

impl SplitPlan {
    /// The set of each of the `takes`. A set without patterns gets the last takes of each group by
    /// number. The test set gets the very last takes, and the validation set the takes before.
    /// Neighbouring takes may be of one actor, so ranges are held out, not every n-th take. A group
    /// has at least one training take, and takes of one file stay together.
    pub(super) fn parts(&self, takes: &[SplitTake<'_>]) -> Parts {
        let mut lists: Vec<Part> = takes.iter().map(|take| self.named(take.name)).collect();
        let fraction = |patterns: &[String], fraction: f64| match patterns.is_empty() {
            true => fraction,
            false => 0.0,
        };
        let test = fraction(&self.test, self.test_fraction.unwrap_or_default());
        let val = fraction(&self.validation, self.fraction);
        let mut groups: BTreeMap<&Labels, Vec<usize>> = BTreeMap::new();
        for (place, take) in takes.iter().enumerate() {
            if lists[place] == Part::Train {
                groups.entry(take.labels).or_default().push(place);
            }
        }
        let mut of_file: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (place, take) in takes.iter().enumerate() {
            of_file.entry(take.file.as_str()).or_default().push(place);
        }
        let (mut count, mut too_small) = (0, 0);
        for mut group in groups.into_values() {
            // The takes of a file count as one take in the group of the last.
            group.retain(|place| of_file[takes[*place].file.as_str()].last() == Some(place));
            if group.is_empty() {
                continue;
            }
            group.sort_by_key(|&place| (takes[place].number, takes[place].name));
            let share = |fraction: f64| (fraction * group.len() as f64).round() as usize;
            let spare = group.len() - 1;
            let test = share(test).min(spare);
            let val = share(val).min(spare - test);
            count += 1;
            too_small += usize::from(test + val == 0);
            for (back, &place) in group.iter().rev().enumerate() {
                let part = match back {
                    _ if back < test => Part::Test,
                    _ if back < test + val => Part::Val,
                    _ => continue,
                };
                for &window in &of_file[takes[place].file.as_str()] {
                    if lists[window] == Part::Train {
                        lists[window] = part;
                    }
                }
            }
        }
        let mut notes = Vec::new();
        if test + val > 0.0 && too_small > 0 {
            notes.push(format!(
                "{too_small} of {count} groups of takes with the same labels are too small for a share \
                 to be held out; split.validation and split.test name takes"
            ));
        }
        for (part, share) in [(Part::Val, val), (Part::Test, test)] {
            if share > 0.0 && !lists.contains(&part) {
                notes.push(format!("no take is held out for {}", part.list()));
            }
        }
        for windows in of_file.values() {
            let Some(other) = windows.iter().find(|&&w| lists[w] != lists[windows[0]]) else {
                continue;
            };
            let [one, two] = [windows[0], *other].map(|w| (takes[w].name, lists[w].name()));
            notes.push(format!(
                "takes `{}` and `{}` are of one file and on different lists: {} and {}",
                one.0, two.0, one.1, two.1
            ));
        }
        Parts { lists, notes }
    }

    /// The set that the patterns assign to the take `name`.
    pub(super) fn named(&self, name: &str) -> Part {
        let any = |patterns: &[String]| patterns.iter().any(|pattern| matches(pattern, name));
        match (any(&self.test), any(&self.validation)) {
            (true, _) => Part::Test,
            (false, true) => Part::Val,
            (false, false) => Part::Train,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(style: &str) -> Labels {
        Labels::from([("style".to_owned(), style.to_owned())])
    }

    fn parts(plan: &SplitPlan, takes: &[(String, Labels, Option<u64>)]) -> Parts {
        let takes: Vec<SplitTake<'_>> = takes
            .iter()
            .map(|(name, labels, number)| SplitTake {
                name,
                labels,
                number: *number,
                file: name.split('@').next().expect("a part").to_owned(),
            })
            .collect();
        plan.parts(&takes)
    }

    #[test]
    fn the_last_numbers_of_each_group_are_held_out() {
        let mut takes = Vec::new();
        // Numbers that are not in the order of their names.
        for number in [2, 10, 1, 3, 4, 5, 6, 7, 8, 9] {
            takes.push((format!("a_{number}"), labels("happy"), Some(number)));
        }
        for number in 1..=3 {
            takes.push((format!("b_{number}"), labels("sad"), Some(number)));
        }
        takes.push(("alone".to_owned(), labels("tired"), None));
        let plan = SplitPlan {
            fraction: 0.2,
            test_fraction: Some(0.1),
            ..SplitPlan::default()
        };
        let found = parts(&plan, &takes);
        assert!(found.notes[0].starts_with("1 of 3 groups"), "{found:?}");
        for ((name, _, number), part) in takes.iter().zip(found.lists) {
            let expected = match (name.as_bytes()[0], number) {
                (b'a', Some(10)) => Part::Test,
                (b'a', Some(8 | 9)) | (b'b', Some(3)) if name.as_bytes()[1] == b'_' => Part::Val,
                _ => Part::Train,
            };
            assert_eq!(part, expected, "{name}");
        }
        let greedy = SplitPlan {
            fraction: 0.9,
            test_fraction: Some(0.9),
            ..SplitPlan::default()
        };
        let found = parts(&greedy, &takes);
        assert_eq!(found.lists.iter().filter(|p| **p == Part::Train).count(), 3);
    }

    #[test]
    fn patterns_go_before_shares() {
        let takes = ["walk_1", "walk_2", "run_1"];
        let takes = takes.map(|name| (name.to_owned(), labels("happy"), None));
        let plan = SplitPlan {
            validation: vec!["*_1".to_owned()],
            test: vec!["run*".to_owned()],
            ..SplitPlan::default()
        };
        let found = parts(&plan, &takes);
        assert_eq!(found.lists, [Part::Val, Part::Train, Part::Test]);
        assert_eq!(found.notes, [""; 0]);
    }

    #[test]
    fn a_list_without_patterns_gets_its_share_of_what_the_other_leaves() {
        let takes: Vec<_> = (0..12)
            .map(|number| (format!("walk_{number}"), labels("happy"), Some(number)))
            .collect();
        let plan = SplitPlan {
            test: vec!["walk_0".to_owned(), "walk_11".to_owned()],
            fraction: 0.2,
            ..SplitPlan::default()
        };
        let found = parts(&plan, &takes).lists;
        let places =
            |part| -> Vec<usize> { (0..12).filter(|&place| found[place] == part).collect() };
        assert_eq!(places(Part::Test), [0, 11]);
        assert_eq!(places(Part::Val), [9, 10]);
    }

    #[test]
    fn windows_of_one_file_are_on_one_list() {
        // Two windows of each file, the second of another label.
        let mut takes = Vec::new();
        for number in 1..=5 {
            takes.push((format!("f{number}@a"), labels("happy"), Some(number)));
            takes.push((format!("f{number}@b"), labels("sad"), Some(number)));
        }
        let plan = SplitPlan {
            fraction: 0.2,
            ..SplitPlan::default()
        };
        let found = parts(&plan, &takes).lists;
        for (place, part) in found.iter().enumerate() {
            let expected = match place {
                8 | 9 => Part::Val,
                _ => Part::Train,
            };
            assert_eq!(*part, expected, "{place}");
        }
        let torn = SplitPlan {
            validation: vec!["f1@a".to_owned()],
            ..SplitPlan::default()
        };
        let notes = parts(&torn, &takes).notes;
        assert!(
            notes.iter().any(|note| note.contains("of one file")),
            "{notes:?}"
        );
    }

    #[test]
    fn a_note_states_that_no_take_is_held_out() {
        let takes = [
            ("a".to_owned(), labels("happy"), None),
            ("b".to_owned(), labels("sad"), None),
        ];
        let notes = parts(&SplitPlan::default(), &takes).notes;
        assert_eq!(
            notes.last().expect("a note"),
            "no take is held out for val.txt"
        );
    }
}
