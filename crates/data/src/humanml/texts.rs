//! The captions of a clip: `texts/ID.txt`, one caption per line.

use std::borrow::Cow;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use kinegrad_motion::metrics::text_motion::{PartOfSpeech, Token};

use crate::FileError;
use crate::file::read_file;

/// Folder of all captions; its files are `ID.txt`.
pub const TEXTS: &str = "texts";

/// Largest file of captions.
pub(super) const MAX_BYTES: u64 = 1 << 20;

/// Format of a line.
const LINE: &str = "`CAPTION#TOKENS#FROM#TO`";

/// Path of the captions of clip `id` in its dataset.
pub fn texts_path(id: &str) -> String {
    format!("{TEXTS}/{id}.txt")
}

/// A caption of a clip or of a frame range.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Caption {
    /// The sentence.
    pub text: String,
    /// Words with parts of speech for the text-motion evaluator; may be empty.
    pub tokens: Vec<Token>,
    /// The caption range in seconds; `None` for the whole clip.
    pub seconds: Option<(f64, f64)>,
    /// The caption's embedding, `[512]`, if the dataset has embeddings.
    pub embedding: Option<Arc<[f32]>>,
}

impl Caption {
    /// The tokens of the caption or, without tokens, the words of its text.
    pub fn words(&self) -> Cow<'_, [Token]> {
        if !self.tokens.is_empty() {
            return Cow::Borrowed(&self.tokens);
        }
        let words = self.text.split(|letter: char| !letter.is_alphanumeric());
        let token = |word: &str| Token {
            word: word.to_lowercase(),
            part_of_speech: PartOfSpeech::Other,
        };
        words.filter(|word| !word.is_empty()).map(token).collect()
    }

    /// The caption range in frames, in a clip of `frames` frames.
    pub fn frames(&self, frames: usize, fps: f64) -> Range<usize> {
        let Some((from, to)) = self.seconds else {
            return 0..frames;
        };
        // Casts of floats saturate.
        let frame = |seconds: f64| ((seconds * fps) as usize).min(frames);
        frame(from)..frame(to).max(frame(from))
    }

    /// The caption's line in `texts/ID.txt`, as [`parse_captions`] reads it.
    pub fn line(&self) -> String {
        let tokens: Vec<String> = self.tokens.iter().map(Token::to_string).collect();
        let (from, to) = self.seconds.unwrap_or_default();
        format!("{}#{}#{from:?}#{to:?}\n", self.text, tokens.join(" "))
    }
}

/// Parses a file of captions; `file` names the file in errors.
///
/// A line is `CAPTION#TOKENS#FROM#TO`: sentence, words with parts of speech ([`Token::parse_all`]),
/// and the range in seconds. A range from 0.0 to 0.0 (or NaN) is the whole clip. Empty lines are
/// skipped. Fails with [`FileError::Unusable`], which names the line.
pub fn parse_captions(bytes: &[u8], file: &str) -> Result<Vec<Caption>, FileError> {
    let text = str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()]
            .iter()
            .filter(|&&byte| byte == b'\n')
            .count();
        FileError::unexpected(
            format!("{file}, line {line}"),
            "bytes that are not UTF-8",
            "UTF-8 text",
            "save the file again as UTF-8",
        )
    })?;
    let lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let lines = lines.filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(number, line)| {
            parse_line(line).map_err(|(found, expected)| {
                FileError::unexpected(
                    format!("{file}, line {}", number + 1),
                    found,
                    expected,
                    "as in `a person walks.#a/DET person/NOUN walk/VERB#0.0#0.0`; FROM and TO are \
                     seconds, and 0.0#0.0 is the whole clip",
                )
            })
        })
        .collect()
}

/// Reads the captions of every clip in a local dataset `folder`, by id. Fails with [`FileError`]
/// for a folder without texts, and as [`parse_captions`].
pub fn read_captions(folder: &Path) -> Result<Vec<(String, Vec<Caption>)>, FileError> {
    let texts = folder.join(TEXTS);
    let listed = fs::read_dir(&texts).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let listed = listed.map_err(FileError::read(&texts))?;
    let mut paths: Vec<PathBuf> = listed.into_iter().map(|entry| entry.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "txt"));
    paths.sort();
    let read = |path: PathBuf| {
        let bytes = read_file(&path, MAX_BYTES).map_err(FileError::read(&path))?;
        let captions = parse_captions(&bytes, &path.display().to_string())?;
        let id = path.file_stem().unwrap_or_default();
        Ok((id.to_string_lossy().into_owned(), captions))
    };
    let clips = paths.into_iter().map(read);
    let mut clips: Vec<(String, Vec<Caption>)> = clips.collect::<Result<_, FileError>>()?;
    clips.retain(|(_, captions)| !captions.is_empty());
    match clips.is_empty() {
        false => Ok(clips),
        true => Err(FileError::unexpected(
            texts.display().to_string(),
            "no caption",
            "texts/ID.txt with a caption a line",
            "docs/dataset.md describes the layout of HumanML3D",
        )),
    }
}

/// Parses a caption. The error is the found and the expected text.
fn parse_line(line: &str) -> Result<Caption, (String, String)> {
    let mut fields = line.rsplitn(4, '#');
    let (Some(to), Some(from), Some(tokens), Some(text)) =
        (fields.next(), fields.next(), fields.next(), fields.next())
    else {
        return Err((format!("`{}`", shortened(line)), LINE.to_owned()));
    };
    let text = text.trim();
    if text.is_empty() {
        return Err(("no caption before the first `#`".into(), LINE.to_owned()));
    }
    let seconds = |field: &str, name: &str| match field.trim().parse::<f64>() {
        Ok(value) if value.is_nan() => Ok(0.0),
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err((
            format!("{name} `{}`", shortened(field)),
            "a number of seconds, 0 or more".to_owned(),
        )),
    };
    let (from, to) = (seconds(from, "FROM")?, seconds(to, "TO")?);
    Ok(Caption {
        text: text.to_owned(),
        tokens: Token::parse_all(tokens),
        seconds: (from != 0.0 || to != 0.0).then_some((from, to)),
        embedding: None,
    })
}

/// The beginning of a long text.
fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn captions_of_whole_clips_and_of_ranges_are_read() {
        let text = "\u{feff}a man walks.#a/DET man/NOUN#0.0#0.0\r\n\n\
                    steps #2 and turns#x#nan#NaN\n he sits #y# 1.25 #3.5";
        let captions = parse_captions(text.as_bytes(), "a.txt").unwrap();
        let found: Vec<_> = captions
            .iter()
            .map(|caption| (caption.text.as_str(), caption.seconds))
            .collect();
        assert_eq!(
            found,
            [
                ("a man walks.", None),
                ("steps #2 and turns", None),
                ("he sits", Some((1.25, 3.5)))
            ]
        );
        assert_eq!(captions[0].frames(90, 20.0), 0..90);
        assert_eq!(captions[2].frames(90, 20.0), 25..70);
        assert_eq!(captions[2].frames(60, 20.0), 25..60);
        assert_eq!(captions[2].frames(20, 20.0), 20..20);
    }

    #[test]
    fn words_keep_their_parts_of_speech() {
        let text = "a man #1 walks.#a/DET man/NOUN walk/VERB#0.0#0.0\nsits##0.0#0.0";
        let captions = parse_captions(text.as_bytes(), "a.txt").unwrap();
        let tokens: Vec<String> = captions[0].tokens.iter().map(Token::to_string).collect();
        assert_eq!(tokens, ["a/DET", "man/NOUN", "walk/VERB"]);
        assert_eq!(captions[1].tokens, []);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, line, found) in [
            ("good#t#0.0#0.0\nbad line", 2, "`bad line`"),
            ("one#0.0#0.0", 1, "`one#0.0#0.0`"),
            ("\n\n #t#0.0#0.0", 3, "no caption"),
            ("a#t#minus#0.0", 1, "FROM `minus`"),
            ("a#t#0.0#-1", 1, "TO `-1`"),
            ("a#t#0.0#inf", 1, "TO `inf`"),
        ] {
            let message = parse_captions(text.as_bytes(), "texts/a.txt")
                .unwrap_err()
                .to_string();
            assert!(
                message.starts_with(&format!("texts/a.txt, line {line}: found {found}")),
                "{message}"
            );
        }
        let message = parse_captions(b"a#t#0.0#0.0\n\xff", "a.txt").unwrap_err();
        assert!(message.to_string().contains("a.txt, line 2: found bytes"));
    }

    proptest! {
        #[test]
        fn any_bytes_give_captions_or_an_error(
            bytes in proptest::collection::vec(any::<u8>(), 0..80),
            text in "[a#0-9.\nnN-]{0,60}",
            frames in 0usize..300,
        ) {
            for bytes in [&bytes[..], text.as_bytes()] {
                for caption in parse_captions(bytes, "a.txt").unwrap_or_default() {
                    let range = caption.frames(frames, 20.0);
                    prop_assert!(range.start <= range.end && range.end <= frames);
                }
            }
        }

        #[test]
        fn a_written_caption_is_read_back(
            text in "[a-z#]([a-z# ]{0,20}[a-z])?",
            from in 0u32..2000,
            length in 1u32..2000,
        ) {
            let seconds = (f64::from(from) / 100.0, f64::from(from + length) / 100.0);
            let line = format!("{text}#t/NOUN#{}#{}\n", seconds.0, seconds.1);
            let found = parse_captions(line.as_bytes(), "a.txt").unwrap();
            prop_assert_eq!(&found[0].text, &text);
            prop_assert_eq!(found[0].seconds, Some(seconds));
        }
    }
}
