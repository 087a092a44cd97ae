//! Labels of phrases, such as the dance style, for networks with `model.style`.

use std::collections::{BTreeMap, HashMap};

use kinegrad_settings::{InvalidSetting, Refused, require};

use crate::pattern::matches;

/// The labels of a dataset's phrases.
#[derive(Clone, Debug, Default)]
pub(crate) struct Labels {
    /// Labels by id pattern, which override the dataset's labels.
    patterns: BTreeMap<String, String>,
    /// Labels of the dataset, by id.
    stated: HashMap<String, String>,
}

impl Labels {
    /// Labels from `patterns` (`data.labels`) and from the dataset (`stated`).
    pub fn new(patterns: &BTreeMap<String, String>, stated: HashMap<String, String>) -> Self {
        Self {
            patterns: patterns.clone(),
            stated,
        }
    }

    /// The label of the longest matching pattern or, without a match, of the dataset. Empty labels
    /// are `None`.
    pub fn of(&self, id: &str) -> Option<&str> {
        let matching = self.patterns.iter();
        let matching = matching.filter(|(pattern, _)| matches(pattern, id));
        let longest = matching.max_by_key(|(pattern, _)| pattern.len());
        let label = match longest {
            Some((_, label)) => label,
            None => self.stated.get(id)?,
        };
        Some(label.trim()).filter(|label| !label.is_empty())
    }

    /// The dataset's labels as text; empty without labels.
    pub fn fingerprint(&self) -> String {
        if self.stated.is_empty() {
            return String::new();
        }
        format!("labels {:?}", BTreeMap::from_iter(&self.stated))
    }
}

/// Rejects labels that look like style numbers.
pub(crate) fn check_patterns(patterns: &BTreeMap<String, String>) -> Result<(), InvalidSetting> {
    for (pattern, label) in patterns {
        let key = format!("data.labels.{pattern}");
        require(
            is_label(label) || label.trim().is_empty(),
            key,
            format!("\"{label}\""),
            "a word without a comma that is not a number, or nothing for no label",
        )
        .hint("labels are such as \"waltz\" or \"cha-cha\"")?;
    }
    Ok(())
}

/// True if a text can be a label: a word without commas that is not a number.
pub fn is_label(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty() && !text.contains(',') && text.parse::<f64>().is_err()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::idle;

    fn labels() -> Labels {
        let named = |(a, b): (&str, &str)| (a.to_owned(), b.to_owned());
        let patterns = [("W_*", "waltz"), ("W_3_*", "slow waltz"), ("C_9*", "")];
        let stated = [
            ("W_1_00000", "ballet"),
            ("C_2_00000", "cha-cha"),
            ("C_9_00000", "cha-cha"),
        ];
        Labels::new(
            &patterns.map(named).into_iter().collect(),
            stated.map(named).into_iter().collect(),
        )
    }

    #[test]
    fn the_longest_pattern_decides_then_what_the_dataset_states() {
        let labels = labels();
        for (id, expected) in [
            ("W_1_00000", Some("waltz")),
            ("W_3_00120", Some("slow waltz")),
            ("C_2_00000", Some("cha-cha")),
            ("C_9_00000", None),
            ("R_1_00000", None),
        ] {
            assert_eq!(labels.of(id), expected, "{id}");
        }
        let ids = ["W_1_00000", "C_2_00000"].into_iter();
        let idle = idle("data.labels", labels.patterns.keys(), ids);
        assert_eq!(idle.len(), 2, "{idle:?}");
        assert!(idle[0].contains("`C_9*` matches no phrase"), "{idle:?}");
    }

    #[test]
    fn labels_are_words() {
        for good in ["waltz", "cha-cha", "slow waltz", "2-step"] {
            assert!(is_label(good), "{good}");
        }
        for bad in ["", " ", "0.5", "1,2", "a,b", "inf", "NaN", "-3"] {
            assert!(!is_label(bad), "{bad}");
        }
    }
}
