//! Words of captions, with parts of speech and vectors.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt;

use kinegrad_random::{Key, Purpose};
use thiserror::Error;

/// Largest number of words read from a caption.
pub const MAX_WORDS: usize = 20;

/// Replacement of words without a vector.
const UNKNOWN: &str = "unk";

/// Classes of words, in the order of the one-hot vectors. Some words have a fixed class.
#[derive(Clone, Copy, Debug, Eq, Hash, PartialEq)]
pub enum PartOfSpeech {
    /// `VERB`.
    Verb,
    /// `NOUN`.
    Noun,
    /// `DET`, a determiner.
    Determiner,
    /// `ADP`, an adposition.
    Adposition,
    /// `NUM`, a numeral.
    Numeral,
    /// `AUX`, an auxiliary verb.
    Auxiliary,
    /// `PRON`, a pronoun.
    Pronoun,
    /// `ADJ`, an adjective.
    Adjective,
    /// `ADV`, an adverb.
    Adverb,
    /// `Loc_VIP`: a direction.
    Direction,
    /// `Body_VIP`: a part of the body.
    BodyPart,
    /// `Obj_VIP`: an object.
    Object,
    /// `Act_VIP`: an action.
    Action,
    /// `Desc_VIP`: a manner.
    Manner,
    /// `OTHER`, and every part of speech without a class.
    Other,
}

impl PartOfSpeech {
    /// All classes in order, with their names in caption files.
    pub const ALL: [(Self, &'static str); 15] = [
        (Self::Verb, "VERB"),
        (Self::Noun, "NOUN"),
        (Self::Determiner, "DET"),
        (Self::Adposition, "ADP"),
        (Self::Numeral, "NUM"),
        (Self::Auxiliary, "AUX"),
        (Self::Pronoun, "PRON"),
        (Self::Adjective, "ADJ"),
        (Self::Adverb, "ADV"),
        (Self::Direction, "Loc_VIP"),
        (Self::BodyPart, "Body_VIP"),
        (Self::Object, "Obj_VIP"),
        (Self::Action, "Act_VIP"),
        (Self::Manner, "Desc_VIP"),
        (Self::Other, "OTHER"),
    ];

    /// The name in caption files.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// The class of that name; [`Other`](Self::Other) for unknown names.
    pub fn from_name(name: &str) -> Self {
        let found = Self::ALL.into_iter().find(|(_, known)| *known == name);
        found.map_or(Self::Other, |(class, _)| class)
    }

    /// The fixed class of a word.
    fn of_word(word: &str) -> Option<Self> {
        Some(match word {
            "left" | "right" | "clockwise" | "counterclockwise" | "anticlockwise" | "forward"
            | "back" | "backward" | "up" | "down" | "straight" | "curve" => Self::Direction,
            "arm" | "chin" | "foot" | "feet" | "face" | "hand" | "mouth" | "leg" | "waist"
            | "eye" | "knee" | "shoulder" | "thigh" => Self::BodyPart,
            "stair" | "dumbbell" | "chair" | "window" | "floor" | "car" | "ball" | "handrail"
            | "baseball" | "basketball" => Self::Object,
            "walk" | "run" | "swing" | "pick" | "bring" | "kick" | "put" | "squat" | "throw"
            | "hop" | "dance" | "jump" | "turn" | "stumble" | "stop" | "sit" | "lift" | "lower"
            | "raise" | "wash" | "stand" | "kneel" | "stroll" | "rub" | "bend" | "balance"
            | "flap" | "jog" | "shuffle" | "lean" | "rotate" | "spin" | "spread" | "climb" => {
                Self::Action
            }
            "slowly" | "carefully" | "fast" | "careful" | "slow" | "quickly" | "happy"
            | "angry" | "sad" | "happily" | "angrily" | "sadly" => Self::Manner,
            _ => return None,
        })
    }
}

/// A word of a caption. Displays as `word/POS`.
#[derive(Clone, Debug, Eq, Hash, PartialEq)]
pub struct Token {
    /// The word in its dictionary form.
    pub word: String,
    /// Its part of speech in the caption file.
    pub part_of_speech: PartOfSpeech,
}

impl Token {
    /// Parses words `word/POS` separated by spaces. A word without `/POS` is
    /// [`PartOfSpeech::Other`]; empty words are skipped.
    pub fn parse_all(text: &str) -> Vec<Self> {
        text.split_whitespace()
            .map(|token| token.rsplit_once('/').unwrap_or((token, "")))
            .filter(|(word, _)| !word.is_empty())
            .map(|(word, name)| Self {
                word: word.to_owned(),
                part_of_speech: PartOfSpeech::from_name(name),
            })
            .collect()
    }
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.word, self.part_of_speech.name())
    }
}

/// Unusable word vectors.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("the word vectors have {found}, expected {expected}")]
pub struct WordVectorsError {
    /// The finding.
    pub found: String,
    /// The expectation.
    pub expected: &'static str,
}

/// A vector for each word.
#[derive(Clone, Debug, PartialEq)]
pub struct WordVectors {
    /// Row of each word, and the values of all rows. Without values, every word has a random
    /// vector.
    table: Option<(HashMap<String, usize>, Vec<f32>)>,
    width: usize,
}

impl WordVectors {
    /// The vectors `[words, width]` of distinct words, including `unk`.
    ///
    /// # Errors
    /// Fails if the values are not one finite vector per word, a word occurs twice, or `unk` is
    /// missing.
    pub fn new(words: Vec<String>, values: Vec<f32>) -> Result<Self, WordVectorsError> {
        let refused = |found, expected| WordVectorsError { found, expected };
        let (count, width) = (words.len(), values.len() / words.len().max(1));
        if width == 0 || values.len() != count * width {
            let found = format!("{} values for {count} words", values.len());
            return Err(refused(found, "as many values for each word"));
        }
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            let found = format!("{} in row {}", values[place], place / width);
            return Err(refused(found, "finite numbers"));
        }
        let mut places = HashMap::with_capacity(count);
        for (row, word) in words.into_iter().enumerate() {
            if let Some(first) = places.insert(word.clone(), row) {
                let found = format!("the word `{word}` in rows {first} and {row}");
                return Err(refused(found, "different words"));
            }
        }
        if !places.contains_key(UNKNOWN) {
            let found = format!("no word `{UNKNOWN}`");
            return Err(refused(found, "a vector for it: that of words without one"));
        }
        Ok(Self {
            table: Some((places, values)),
            width,
        })
    }

    /// A normal random vector of `width` numbers for every word.
    pub fn random(width: usize) -> Self {
        Self { table: None, width }
    }

    /// Numbers of a vector.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The vector of a word, if known.
    pub fn vector(&self, word: &str) -> Option<Cow<'_, [f32]>> {
        let Some((places, values)) = &self.table else {
            let key = Key::new(0, Purpose::WordVectors).named(word);
            return Some(Cow::Owned(key.normals(self.width)));
        };
        let start = places.get(word)? * self.width;
        Some(Cow::Borrowed(&values[start..start + self.width]))
    }

    /// Vectors and classes of a caption's first [`MAX_WORDS`] words, between `sos` and `eos`. Words
    /// without a vector use the vector of `unk` and are [`PartOfSpeech::Other`].
    pub fn sentence(&self, tokens: &[Token]) -> Vec<(Cow<'_, [f32]>, PartOfSpeech)> {
        let words = tokens.iter().take(MAX_WORDS);
        let words = words.map(|token| (token.word.as_str(), token.part_of_speech));
        let [start, end] = ["sos", "eos"].map(|word| std::iter::once((word, PartOfSpeech::Other)));
        let read = |(word, stated)| match self.vector(word) {
            Some(vector) => (vector, PartOfSpeech::of_word(word).unwrap_or(stated)),
            None => (self.vector(UNKNOWN).expect("checked"), PartOfSpeech::Other),
        };
        start.chain(words).chain(end).map(read).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vectors() -> WordVectors {
        let words = ["unk", "sos", "eos", "walk", "man"].map(str::to_owned);
        WordVectors::new(words.into(), (0..10u8).map(f32::from).collect()).unwrap()
    }

    #[test]
    fn classes_are_in_their_order_and_found_by_name() {
        for (index, (class, _)) in PartOfSpeech::ALL.into_iter().enumerate() {
            assert_eq!(class as usize, index);
            assert_eq!(PartOfSpeech::from_name(class.name()), class);
        }
        assert_eq!(PartOfSpeech::from_name("PUNCT"), PartOfSpeech::Other);
    }

    #[test]
    fn tokens_are_read_leniently_and_written_back() {
        let tokens = Token::parse_all(" a/DET  1/2/NUM and /NOUN x/PUNCT / ");
        let written: Vec<String> = tokens.iter().map(Token::to_string).collect();
        assert_eq!(written, ["a/DET", "1/2/NUM", "and/OTHER", "x/OTHER"]);
        assert_eq!(Token::parse_all(&written.join(" ")), tokens);
        assert!(Token::parse_all(" ").is_empty());
    }

    #[test]
    fn a_sentence_is_framed_and_unknown_words_are_unk() {
        let vectors = vectors();
        let sentence = vectors.sentence(&Token::parse_all("man/NOUN walk/VERB left/ADV"));
        let expected: [(&[f32], PartOfSpeech); 5] = [
            (&[2.0, 3.0], PartOfSpeech::Other),
            (&[8.0, 9.0], PartOfSpeech::Noun),
            (&[6.0, 7.0], PartOfSpeech::Action),
            (&[0.0, 1.0], PartOfSpeech::Other),
            (&[4.0, 5.0], PartOfSpeech::Other),
        ];
        let expected = expected.map(|(vector, class)| (Cow::Borrowed(vector), class));
        assert_eq!(sentence, expected);
        let long = Token::parse_all(&"man/NOUN ".repeat(30));
        assert_eq!(vectors.sentence(&long).len(), MAX_WORDS + 2);
        assert_eq!(vectors.sentence(&[]).len(), 2);
    }

    #[test]
    fn every_word_has_a_random_vector_of_its_own() {
        let vectors = WordVectors::random(5);
        let [walk, again, run] = ["walk", "walk", "run"].map(|word| vectors.vector(word).unwrap());
        assert_eq!((walk.len(), &walk), (5, &again));
        assert_ne!(walk, run);
        let sentence = vectors.sentence(&Token::parse_all("zyx/NOUN walk/VERB"));
        let classes = sentence.iter().map(|(_, class)| *class);
        let other = PartOfSpeech::Other;
        let expected = [other, PartOfSpeech::Noun, PartOfSpeech::Action, other];
        assert_eq!(classes.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn unusable_vectors_are_refused() {
        let refused = |words: &[&str], values: Vec<f32>| {
            let words = words.iter().map(|word| word.to_string()).collect();
            WordVectors::new(words, values).unwrap_err().to_string()
        };
        for (words, values, message) in [
            (&[][..], vec![], "0 values for 0 words"),
            (&["unk", "a"], vec![1.0; 3], "3 values for 2 words"),
            (&["unk", "a"], vec![], "0 values for 2 words"),
            (&["unk", "a", "a"], vec![1.0; 3], "`a` in rows 1 and 2"),
            (&["b", "a"], vec![1.0; 2], "no word `unk`"),
            (&["unk", "a"], vec![1.0, f32::NAN], "NaN in row 1"),
        ] {
            let found = refused(words, values);
            assert!(found.contains(message), "{found}");
        }
    }
}
