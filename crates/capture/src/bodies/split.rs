//! Which takes are held out.

use std::collections::BTreeMap;
use std::fmt;

use kinegrad_data::matches;
use serde::{Deserialize, Serialize};

use super::captions::Labels;
use crate::prepare::SplitPlan;

/// The list that a clip is on.
#[derive(Clone, Copy, Debug, Deserialize, Eq, Ord, PartialEq, PartialOrd, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// To train on.
    Train,
    /// Held out to watch training by.
    Val,
    /// Held out for the end.
    Test,
}

impl Part {
    /// All of them, in the order of their lists.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The file with the ids of its clips.
    pub fn list(self) -> &'static str {
        match self {
            Self::Train => "train.txt",
            Self::Val => "val.txt",
            Self::Test => "test.txt",
        }
    }
}

impl fmt::Display for Part {
    /// `train`, `val` or `test`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// What decides on which side a take is.
#[derive(Clone, Debug)]
pub struct SplitTake<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its labels: takes with the same ones are of one group.
    pub labels: &'a Labels,
    /// Its number within the group.
    pub number: Option<u64>,
}

impl SplitPlan {
    /// The list that each of the `takes` is on. What patterns name is held out. Without any, the
    /// last takes of each group with the same labels are, in the order of their numbers: at the very
    /// end those of `test_fraction`, before them those of `fraction`. Neighbours may be of one actor,
    /// so ranges are held out. A group keeps at least one take to train on.
    pub(crate) fn parts(&self, takes: &[SplitTake<'_>]) -> Vec<Part> {
        if !self.validation.is_empty() || !self.test.is_empty() {
            let part = |take: &SplitTake<'_>| match () {
                () if any_matches(&self.test, take.name) => Part::Test,
                () if any_matches(&self.validation, take.name) => Part::Val,
                () => Part::Train,
            };
            return takes.iter().map(part).collect();
        }
        let mut groups: BTreeMap<&Labels, Vec<usize>> = BTreeMap::new();
        for (place, take) in takes.iter().enumerate() {
            groups.entry(take.labels).or_default().push(place);
        }
        let mut parts = vec![Part::Train; takes.len()];
        for mut group in groups.into_values() {
            group.sort_by_key(|&place| (takes[place].number, takes[place].name));
            let share = |fraction: f64| (fraction * group.len() as f64).round() as usize;
            let spare = group.len() - 1;
            let test = share(self.test_fraction.unwrap_or_default()).min(spare);
            let val = share(self.fraction).min(spare - test);
            for (back, &place) in group.iter().rev().enumerate() {
                parts[place] = match back {
                    _ if back < test => Part::Test,
                    _ if back < test + val => Part::Val,
                    _ => Part::Train,
                };
            }
        }
        parts
    }

    /// Whether a pattern holds the take of this name out.
    pub(crate) fn names(&self, name: &str) -> bool {
        any_matches(&self.validation, name) || any_matches(&self.test, name)
    }
}

fn any_matches(patterns: &[String], name: &str) -> bool {
    patterns.iter().any(|pattern| matches(pattern, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(style: &str) -> Labels {
        Labels::from([("style".to_owned(), style.to_owned())])
    }

    fn parts(plan: &SplitPlan, takes: &[(String, Labels, Option<u64>)]) -> Vec<Part> {
        let takes: Vec<SplitTake<'_>> = takes
            .iter()
            .map(|(name, labels, number)| SplitTake {
                name,
                labels,
                number: *number,
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
        for ((name, _, number), part) in takes.iter().zip(found) {
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
        assert_eq!(found.iter().filter(|p| **p == Part::Train).count(), 3);
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
        assert_eq!(parts(&plan, &takes), [Part::Val, Part::Train, Part::Test]);
    }
}
