//! CLIP's tokenizer: byte pairs within words, with the vocabulary of the encoder's folder.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use instant_clip_tokenizer::{Token, Tokenizer as BytePairs};
use kinegrad_data::file::read_text;
use serde_json::Value;
use unicode_normalization::UnicodeNormalization as _;

use super::{json_of, refused};
use crate::error::Error;

/// Maximum size of a text, bytes, because merging takes quadratic time in the length of a word.
const MAX_TEXT: usize = 4096;

/// Number of tokens that are not merges: the bytes, within and at the end of a word.
const BYTES: usize = 512;

/// Start and end of a text.
const MARKS: [&str; 2] = ["<|startoftext|>", "<|endoftext|>"];

/// The tokenizer.
pub(super) struct Tokenizer(BytePairs);

impl Tokenizer {
    /// The tokenizer of the vocabulary in `folder`, which must have `vocab_size` tokens.
    ///
    /// # Errors
    /// [`Error::TextEncoder`] for missing or inconsistent files.
    pub fn read(folder: &Path, vocab_size: usize) -> Result<Self, Error> {
        let Vocabulary {
            path,
            merges,
            numbers,
        } = Vocabulary::read(folder)?;
        let count = merges.len();
        let wrong = |reason: String| Err(refused(&path, reason));
        if BYTES + count + MARKS.len() != vocab_size || numbers.len() != vocab_size {
            return wrong(format!(
                "{} tokens and {count} merges found, {vocab_size} tokens needed by config.json, \
                 {} of them merges",
                numbers.len(),
                vocab_size.saturating_sub(BYTES + MARKS.len())
            ));
        }
        // The tokenizer numbers tokens by position, which must agree with the file's numbers.
        let merged = merges.iter().map(|[one, other]| format!("{one}{other}"));
        let named = merged.chain(MARKS.map(String::from));
        for (place, token) in named.enumerate() {
            let expected = (BYTES + place) as u64;
            match numbers.get(&token) {
                Some(&found) if found == expected => {}
                Some(found) => {
                    return wrong(format!("token `{token}` is {found}, {expected} needed"));
                }
                None => return wrong(format!("it has no token `{token}`")),
            }
        }
        let lines = merges.iter().map(|[one, other]| format!("{one} {other}\n"));
        let text: String = std::iter::once("merges\n".to_owned())
            .chain(lines)
            .collect();
        let size = u16::try_from(vocab_size);
        let size = size.map_err(|_| refused(&path, "more than 65535 tokens"))?;
        let pairs = BytePairs::with_vocabulary(Cursor::new(text), size);
        pairs
            .map(Self)
            .map_err(|error| refused(&path, format!("its merges: {error}")))
    }

    /// The tokens of a text: start, at most `most` words, end.
    ///
    /// # Errors
    /// [`Error::Usage`] for a text that is too long to be a sentence.
    pub fn tokens(&self, text: &str, most: usize) -> Result<Vec<u16>, Error> {
        if text.len() > MAX_TEXT {
            let start: String = text.chars().take(40).collect();
            return Err(Error::usage(
                format!(
                    "the text `{start}...` has {} bytes, allowed: at most {MAX_TEXT}",
                    text.len()
                ),
                "a text is a sentence: only the first words of longer texts count",
            ));
        }
        let text: String = text.nfc().collect();
        let mut tokens = Vec::new();
        self.0.encode(&text, &mut tokens);
        tokens.truncate(most);
        let (start, end) = (self.0.start_of_text(), self.0.end_of_text());
        let all = [start].into_iter().chain(tokens).chain([end]);
        Ok(all.map(Token::to_u16).collect())
    }
}

/// The merged pairs in order, and the number of each token.
struct Vocabulary {
    path: PathBuf,
    merges: Vec<[String; 2]>,
    numbers: HashMap<String, u64>,
}

impl Vocabulary {
    /// Reads `vocab.json` and `merges.txt`, or `tokenizer.json`.
    fn read(folder: &Path) -> Result<Self, Error> {
        let [vocab, merges, single] =
            ["vocab.json", "merges.txt", "tokenizer.json"].map(|name| folder.join(name));
        if vocab.exists() && merges.exists() {
            let text = read_text(&merges).map_err(|error| refused(&merges, error))?;
            let lines = text.lines().filter(|line| !line.starts_with("#version"));
            let lines = lines.filter(|line| !line.trim().is_empty());
            let pairs = lines.map(|line| pair_of(line).ok_or_else(|| no_pair(&merges, line)));
            return Ok(Self {
                merges: pairs.collect::<Result<_, _>>()?,
                numbers: numbers_of(&json_of(&vocab)?, &vocab)?,
                path: vocab,
            });
        }
        if !single.exists() {
            let reason = "it has no vocab.json with merges.txt, and no tokenizer.json";
            return Err(refused(folder, reason));
        }
        let all = json_of(&single)?;
        let model = &all["model"];
        let pairs = model["merges"].as_array();
        let pairs = pairs.ok_or_else(|| refused(&single, "it has no `model.merges`"))?;
        let pairs = pairs.iter().map(|pair| {
            // A pair is a string in older files and a list of two strings in newer files.
            let read = match pair {
                Value::String(line) => pair_of(line),
                other => serde_json::from_value(other.clone()).ok(),
            };
            read.ok_or_else(|| no_pair(&single, &pair.to_string()))
        });
        Ok(Self {
            merges: pairs.collect::<Result<_, _>>()?,
            numbers: numbers_of(&model["vocab"], &single)?,
            path: single,
        })
    }
}

fn pair_of(line: &str) -> Option<[String; 2]> {
    let (one, other) = line.trim_end().split_once(' ')?;
    let is_plain = !one.is_empty() && !other.is_empty() && !other.contains(' ');
    is_plain.then(|| [one.to_owned(), other.to_owned()])
}

fn no_pair(path: &Path, line: &str) -> Error {
    let start: String = line.chars().take(40).collect();
    refused(path, format!("`{start}` is not a pair of tokens"))
}

fn numbers_of(value: &Value, path: &Path) -> Result<HashMap<String, u64>, Error> {
    serde_json::from_value(value.clone())
        .map_err(|error| refused(path, format!("not a table of tokens: {error}")))
}
