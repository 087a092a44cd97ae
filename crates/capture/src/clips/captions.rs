//! Captions of clips: sentences made from labels, and their mirror images.

use std::collections::BTreeMap;

use crate::plan::{CaptionsPlan, Part, parts};

/// Values by label.
pub type Labels = BTreeMap<String, String>;

impl CaptionsPlan {
    /// The captions of a clip with these labels. Templates and wordings are used in turn until all
    /// were used. No caption may contain `#`, which ends captions in files.
    pub(super) fn of(&self, labels: &Labels) -> Result<Vec<String>, String> {
        let templates = self.templates.iter().map(|template| parts(template));
        let templates: Vec<Vec<Part<'_>>> = templates.collect::<Result<_, _>>()?;
        let phrases = |label: &str, value: &str| {
            let words = self.words.get(label).and_then(|words| words.get(value));
            let value = || vec![value.replace(['-', '_'], " ")];
            words.map_or_else(value, |phrases| phrases.all().to_vec())
        };
        let mut most = templates.len();
        for name in templates.iter().flatten() {
            if let Part::Name(name) = name {
                let missing = || format!("it has no label `{name}`, which a template names");
                let value = labels.get(*name).ok_or_else(missing)?;
                most = most.max(phrases(name, value).len());
            }
        }
        let mut captions: Vec<String> = Vec::new();
        for turn in 0..if templates.is_empty() { 0 } else { most } {
            let template = &templates[turn % templates.len()];
            let part = |part: &Part<'_>| match part {
                Part::Text(text) => (*text).to_owned(),
                Part::Name(name) => {
                    let phrases = phrases(name, &labels[*name]);
                    phrases[turn % phrases.len()].clone()
                }
            };
            let text: String = template.iter().map(part).collect();
            // An empty wording leaves a gap.
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            if text.contains('#') {
                return Err(format!(
                    "its caption would be `{text}`: no # allowed, which ends captions in their \
                     files; give the label's value a phrase in captions.words"
                ));
            }
            if !text.is_empty() && !captions.contains(&text) {
                captions.push(text);
            }
        }
        Ok(captions)
    }
}

/// The text of a mirrored clip: left and right exchanged, in any spelling.
pub(super) fn mirrored(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    let mut word = String::new();
    let exchange = |word: &str| {
        let exchanged = match word.to_lowercase().as_str() {
            "left" => "right",
            "right" => "left",
            "lefts" => "rights",
            "rights" => "lefts",
            "leftward" => "rightward",
            "rightward" => "leftward",
            "leftwards" => "rightwards",
            "rightwards" => "leftwards",
            "clockwise" => "counterclockwise",
            "counterclockwise" | "anticlockwise" => "clockwise",
            _ => return word.to_owned(),
        };
        let mut letters = word.chars();
        match (letters.next(), letters.next()) {
            (Some(first), Some(second)) if second.is_uppercase() && first.is_uppercase() => {
                exchanged.to_uppercase()
            }
            (Some(first), _) if first.is_uppercase() => {
                exchanged[..1].to_uppercase() + &exchanged[1..]
            }
            _ => exchanged.to_owned(),
        }
    };
    for letter in text.chars().chain(['\n']) {
        if letter.is_alphabetic() {
            word.push(letter);
            continue;
        }
        match opposite(&result, &word) {
            Some(begin) => {
                result.truncate(begin);
                result += &word;
            }
            None => result += &exchange(&word),
        }
        word.clear();
        result.push(letter);
    }
    result.pop();
    result
}

/// Start of a "counter-" or "anti-" before a "clockwise".
fn opposite(before: &str, word: &str) -> Option<usize> {
    let before = before.to_lowercase();
    let mut prefixes = ["counter-", "anti-"].into_iter();
    let prefix = prefixes.find(|prefix| before.ends_with(prefix))?;
    (word.to_lowercase() == "clockwise").then(|| before.len() - prefix.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> CaptionsPlan {
        let plan: CaptionsPlan = toml::from_str(text).unwrap();
        plan.check().unwrap();
        plan
    }

    fn labels(pairs: &[(&str, &str)]) -> Labels {
        let named = pairs
            .iter()
            .map(|(a, b)| ((*a).to_owned(), (*b).to_owned()));
        named.collect()
    }

    #[test]
    fn templates_and_phrases_take_turns() {
        let plan = plan(
            "templates = [\"a person {content} {style}\", \"someone {content}\"]\n\
             words.content.run = [\"runs\", \"jogs\", \"hurries\"]\n\
             words.style = { normal = \"\" }",
        );
        let happy = labels(&[("content", "run"), ("style", "not-sad")]);
        assert_eq!(
            plan.of(&happy).unwrap(),
            [
                "a person runs not sad",
                "someone jogs",
                "a person hurries not sad"
            ]
        );
        let normal = labels(&[("content", "walk-back"), ("style", "normal")]);
        let expected = ["a person walk back", "someone walk back"];
        assert_eq!(plan.of(&normal).unwrap(), expected);
        let message = plan.of(&labels(&[("content", "run")])).unwrap_err();
        assert!(message.contains("no label `style`"), "{message}");
        assert_eq!(CaptionsPlan::default().of(&happy).unwrap(), [""; 0]);
    }

    #[test]
    fn left_and_right_are_exchanged_as_whole_words() {
        for (text, expected) in [
            ("turns left, then right", "turns right, then left"),
            ("walk-turn-left", "walk-turn-right"),
            ("Left LEFT lefty leftover", "Right RIGHT lefty leftover"),
            ("steps rightwards_left", "steps leftwards_right"),
            ("turns clockwise", "turns counterclockwise"),
            ("all right", "all left"),
            ("", ""),
        ] {
            assert_eq!(mirrored(text), expected);
            assert_eq!(mirrored(expected), text);
        }
        assert_eq!(mirrored("anticlockwise"), "clockwise");
        assert_eq!(mirrored("turns counter-clockwise."), "turns clockwise.");
        assert_eq!(mirrored("Anti-clockwise"), "clockwise");
        assert_eq!(mirrored("left-handed"), "right-handed");
    }
}
