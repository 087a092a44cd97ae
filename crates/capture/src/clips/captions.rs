//! Captions of clips: sentences made from labels, and their mirror images.

use std::collections::BTreeMap;
use std::ops::Range;

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

/// The text of a mirrored clip: left and right exchanged, in any spelling. The verb, as in "he left
/// the room", stays.
pub(super) fn mirrored(text: &str) -> String {
    let words = words(text);
    // True if only spaces separate a word from the next word.
    let is_joined = |index: &usize| {
        let pair = words.get(*index).zip(words.get(*index + 1));
        pair.is_some_and(|(word, next)| text[word.end..next.start].trim().is_empty())
    };
    let word_at = |index: usize| text[words[index].clone()].to_lowercase();
    let before = |index: usize| index.checked_sub(1).filter(is_joined).map(word_at);
    let after = |index: usize| -> Vec<String> {
        let joined = (index..index + 3).take_while(is_joined);
        joined.map(|index| word_at(index + 1)).collect()
    };
    let mut result = String::with_capacity(text.len());
    let mut end = 0;
    for (index, range) in words.iter().enumerate() {
        result += &text[end..range.start];
        end = range.end;
        let word = &text[range.clone()];
        let lower = word.to_lowercase();
        let is_verb = || left_is_verb(before(index).as_deref(), &after(index));
        match opposite_prefix(&result, &lower) {
            Some(prefix) => {
                result.truncate(result.len() - prefix);
                result += word;
            }
            None if lower == "left" && is_verb() => result += word,
            None if lower == "right" && is_no_side(before(index).as_deref(), &after(index)) => {
                result += word;
            }
            None => result += &exchanged(word, &lower),
        }
    }
    result + &text[end..]
}

/// The ranges of the words of a text.
fn words(text: &str) -> Vec<Range<usize>> {
    let mut words: Vec<Range<usize>> = Vec::new();
    for (start, letter) in text.char_indices().filter(|(_, c)| c.is_alphabetic()) {
        let end = start + letter.len_utf8();
        match words.last_mut() {
            Some(word) if word.end == start => word.end = end,
            _ => words.push(start..end),
        }
    }
    words
}

/// The word of the other side, in the same spelling.
fn exchanged(word: &str, lower: &str) -> String {
    let exchanged = match lower {
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
        (Some(first), _) if first.is_uppercase() => exchanged[..1].to_uppercase() + &exchanged[1..],
        _ => exchanged.to_owned(),
    }
}

/// Length of a "counter-" or "anti-" before a "clockwise".
fn opposite_prefix(before: &str, lower: &str) -> Option<usize> {
    let prefixes = ["counter-", "anti-"].into_iter();
    let is_before = |prefix: &&str| {
        let start = before.len().checked_sub(prefix.len());
        let tail = start.and_then(|start| before.get(start..));
        tail.is_some_and(|tail| tail.eq_ignore_ascii_case(prefix))
    };
    let prefix = prefixes.filter(|_| lower == "clockwise").find(is_before)?;
    Some(prefix.len())
}

/// Words before the verb "left", whatever follows.
const PRONOUNS: &str = "he she they who we i you";

/// Words before the verb "left" at the end of a sentence, or before its object; plurals in -s too.
const SUBJECTS: &str = "has have had having person people man men woman women someone somebody \
     everyone everybody nobody dancer actor actress actresses performer player character figure \
     guy girl boy child children kid adult lady ladies couple partner friend student human \
     individual other";

/// Words behind the verb "left".
const OBJECTS: &str = "the a an his her their its my your our this that these those it him them me \
     us behind alone home";

/// Words before "left" as a side, whatever follows; verbs also with -s.
const BEFORE_A_SIDE: &str = "the a his her their its my your our to from on of at with toward \
     towards far went ran turn step go move walk look lean run jump kick bend swing reach veer \
     shift hop slide stretch rotate face crawl dodge jog leap lunge march pivot roll shuffle \
     sidestep skip spin sprint stride stumble sway tilt twist";

/// Words of times and distances behind "left the" and "left a", as in "turns left the second time".
const OF_TIMES: &str = "time times way";
const OF_DISTANCES: &str = "little bit lot few couple second moment while step pace metre meter \
     quarter half";

/// True if "left" between these words is the past of "to leave".
fn left_is_verb(before: Option<&str>, after: &[String]) -> bool {
    let next = after.first().map(String::as_str);
    let has_object = next.is_some_and(|next| is_in(OBJECTS, next)) && !is_adverb(after);
    let Some(before) = before else {
        return has_object;
    };
    // Also without the ending of plurals and of verbs.
    let is_of = |list: &str| {
        let without = ["s", "es"].map(|end| before.strip_suffix(end));
        let mut forms = without.into_iter().flatten().chain([before]);
        forms.any(|form| is_in(list, form))
    };
    let goes_on = || {
        next.is_some_and(|next| next.ends_with("ing"))
            || matches!(after, [next, third, ..] if next == "and" && third != "right")
    };
    if is_in(PRONOUNS, before) || is_in("that which", before) && !has_side(after) {
        return true;
    }
    if is_in("is are was were be been", before) {
        return next.is_some_and(|next| is_in("behind alone over", next));
    }
    if is_of(SUBJECTS) {
        return has_object || goes_on() || next.is_none_or(|next| next.ends_with("ly"));
    }
    let is_participle = ["ing", "ed"].iter().any(|end| before.ends_with(end));
    has_object && !is_participle && !is_of(BEFORE_A_SIDE)
}

/// True if a side follows, as in "that left hand": "left" is one itself.
fn has_side(after: &[String]) -> bool {
    let parts = "arm leg foot hand elbow knee shoulder hip side heel toe ankle wrist turn step";
    after.first().is_some_and(|next| is_in(parts, next))
}

/// True if "right" between these words is none, as in "right away" and "all right".
fn is_no_side(before: Option<&str>, after: &[String]) -> bool {
    let next = after.first().map_or("", String::as_str);
    before == Some("all") || is_in("away now", next)
}

/// True if words are a time or a distance, not the object of a verb.
fn is_adverb(words: &[String]) -> bool {
    let Some((first, rest)) = words.split_first() else {
        return false;
    };
    let has = |list: &str| rest.iter().any(|word| is_in(list, word));
    match first.as_str() {
        "the" | "this" | "that" => has(OF_TIMES),
        "a" | "an" => has(OF_DISTANCES),
        _ => false,
    }
}

/// True if `word` is among the words of `list`.
fn is_in(list: &str, word: &str) -> bool {
    list.split(' ').any(|listed| listed == word)
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

    #[test]
    fn the_verb_left_stays() {
        for (text, expected) in [
            (
                "she left the room, then turns left",
                "she left the room, then turns right",
            ),
            ("He left.", "He left."),
            (
                "a man left walking to the left",
                "a man left walking to the right",
            ),
            ("the one that left first", "the one that left first"),
            (
                "person left and turned right",
                "person left and turned left",
            ),
            ("right away he left", "right away he left"),
            ("all right, then turns right", "all right, then turns left"),
            (
                "a person left the chair and walks left",
                "a person left the chair and walks right",
            ),
            ("the man has left", "the man has left"),
            (
                "they suddenly left their places",
                "they suddenly left their places",
            ),
            (
                "who left a bag on the left?",
                "who left a bag on the right?",
            ),
            ("the hand left the ground", "the hand left the ground"),
            ("Left the room to the left.", "Left the room to the right."),
            (
                "turns left and left the room",
                "turns right and left the room",
            ),
            ("he was left behind", "he was left behind"),
            (
                "the dancers left the room, one turns left",
                "the dancers left the room, one turns right",
            ),
            ("Both boys left.", "Both boys left."),
            ("the performers left quickly", "the performers left quickly"),
            (
                "her heavy boots left the floor",
                "her heavy boots left the floor",
            ),
            ("The actress left the stage", "The actress left the stage"),
            ("James left a chair behind", "James left a chair behind"),
            ("the man's left the room", "the man's left the room"),
            (
                "his hands left his sides, then the ground",
                "his hands left his sides, then the ground",
            ),
            (
                "two steps left, and the others left the left door open",
                "two steps right, and the others left the right door open",
            ),
        ] {
            assert_eq!(mirrored(text), expected);
        }
        for (text, expected) in [
            ("that left hand is up", "that right hand is up"),
            ("a person left and right", "a person right and left"),
            ("turns left and left", "turns right and right"),
            (
                "a person has left arm raised",
                "a person has right arm raised",
            ),
            ("turns left the second time", "turns right the second time"),
            ("the man turns left", "the man turns right"),
            ("glances left a little", "glances right a little"),
            ("dances left a few steps", "dances right a few steps"),
            ("drifts left the whole way", "drifts right the whole way"),
            ("he walks left and leaves", "he walks right and leaves"),
            (
                "the man's left arm swings left",
                "the man's right arm swings right",
            ),
            (
                "swings his arms left, the hips left",
                "swings his arms right, the hips right",
            ),
            (
                "spins left his arms stretched out",
                "spins right his arms stretched out",
            ),
            ("takes three steps left", "takes three steps right"),
            (
                "a step to the left, the arms up",
                "a step to the right, the arms up",
            ),
            ("raises his left", "raises his right"),
            (
                "looking left, a person walks",
                "looking right, a person walks",
            ),
            ("left foot, left hand", "right foot, right hand"),
            (
                "the person left of the table",
                "the person right of the table",
            ),
        ] {
            assert_eq!(mirrored(text), expected);
            assert_eq!(mirrored(expected), text);
        }
        // A look back over all of the text at each word would take minutes.
        let long = "he left the room, anti-clockwise ".repeat(100_000);
        assert_eq!(
            mirrored(&long),
            "he left the room, clockwise ".repeat(100_000)
        );
    }
}
