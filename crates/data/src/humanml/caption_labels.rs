//! Captions as labels: each distinct caption of a dataset has a learned embedding.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use kinegrad_ranks::Sharing;

use crate::progress::OpenProgress;
use crate::{Error, ItemSet};

use super::Clip;

/// Maximum number of captions with learned embeddings. HumanML3D has 45,000 captions, mostly
/// unique.
pub const MAX_CAPTIONS: usize = 4096;

/// The captions of a model, each with its row in the embedding table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptionLabels {
    captions: Arc<[String]>,
    rows: Arc<HashMap<String, usize>>,
}

impl CaptionLabels {
    /// Labels of distinct `captions`, in row order.
    pub fn new(captions: Vec<String>) -> Self {
        let rows = captions.iter().cloned().zip(0..).collect();
        Self {
            captions: captions.into(),
            rows: Arc::new(rows),
        }
    }

    /// The captions, in row order.
    pub fn captions(&self) -> &[String] {
        &self.captions
    }

    /// The row of a caption, by exact match.
    pub fn row(&self, caption: &str) -> Option<usize> {
        self.rows.get(caption).copied()
    }

    /// [`row`](Self::row), or the only row that differs just in capitals, spaces and final
    /// punctuation.
    pub fn row_of_typed(&self, text: &str) -> Option<usize> {
        let exact = self.row(text.trim());
        exact.or_else(|| {
            let wanted = plain(text);
            let rows = self.captions.iter().enumerate();
            let mut same = rows.filter(|(_, caption)| plain(caption) == wanted);
            match (same.next(), same.next()) {
                (Some((row, _)), None) => Some(row),
                _ => None,
            }
        })
    }

    /// The one-hot condition of a row, `[captions]`; zeros without a row.
    pub fn values(&self, row: Option<usize>) -> Vec<f32> {
        let mut values = vec![0.0; self.captions.len()];
        if let Some(row) = row {
            values[row] = 1.0;
        }
        values
    }
}

/// A caption without capitals, extra spaces and final punctuation.
fn plain(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    let text = words.join(" ").to_lowercase();
    text.trim_end_matches(['.', '!', '?', ' ']).to_owned()
}

impl ItemSet<Clip> {
    /// The distinct captions of the clips in alphabetical order, each with the id of its first
    /// clip. Each rank reads a part of the clips. Collective. Fails as
    /// [`measure_among`](Self::measure_among).
    pub fn captions_among(
        &self,
        progress: OpenProgress,
        sharing: &dyn Sharing<Error>,
    ) -> Result<BTreeMap<String, String>, Error> {
        let mut captions = BTreeMap::new();
        self.measure_among(
            |clip| {
                let texts = clip.captions.iter().map(|caption| caption.text.clone());
                (clip.id.clone(), texts.collect::<Vec<_>>())
            },
            |(id, texts)| {
                for text in texts {
                    captions.entry(text).or_insert_with(|| id.clone());
                }
            },
            progress,
            sharing,
        )?;
        Ok(captions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::{CaptionText, ClipSamples, Humanml3dConfig};
    use crate::loader::Samples as _;
    use crate::{Alone, no_progress};
    use crate::{DataConfig, DataKind, Dataset};

    fn labels() -> CaptionLabels {
        let captions = [
            "A man sits.",
            "a man sits",
            "someone  walks",
            "someone runs!",
        ];
        CaptionLabels::new(captions.map(String::from).to_vec())
    }

    #[test]
    fn typed_captions_are_found_if_only_one_can_be_meant() {
        let labels = labels();
        for (text, row) in [
            ("a man sits", Some(1)),
            ("A man sits.", Some(0)),
            // Two captions differ only in capitals and the full stop.
            ("A man sits", None),
            ("Someone walks.", Some(2)),
            ("  someone runs", Some(3)),
            ("someone", None),
            ("", None),
        ] {
            assert_eq!(labels.row_of_typed(text), row, "{text}");
        }
        assert_eq!(labels.row("Someone walks."), None);
        assert_eq!(labels.values(Some(2)), [0.0, 0.0, 1.0, 0.0]);
        assert_eq!(labels.values(None), [0.0; 4]);
    }

    #[test]
    fn samples_contain_the_index_of_their_caption() {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            target_frames: 40,
            humanml3d: Humanml3dConfig {
                text: CaptionText::Labels,
                ..Humanml3dConfig::default()
            },
            ..DataConfig::default()
        };
        config.synthetic.phrases = 9;
        let dataset = Dataset::<Clip>::open(&config).unwrap();
        let statistics = Arc::new(dataset.statistics().unwrap());
        let captions = dataset.train.captions_among(&no_progress, &Alone).unwrap();
        let clips = dataset.train.load().unwrap();
        let texts = clips.iter().flat_map(|clip| &clip.captions);
        assert!(texts.clone().all(|caption| caption.embedding.is_none()));
        let mut texts: Vec<&str> = texts.map(|caption| caption.text.as_str()).collect();
        texts.sort_unstable();
        texts.dedup();
        let found: Vec<&str> = captions.keys().map(String::as_str).collect();
        assert_eq!(found, texts);
        for (text, id) in &captions {
            let first = clips
                .iter()
                .find(|clip| clip.captions.iter().any(|caption| caption.text == *text));
            assert_eq!(first.map(|clip| &clip.id), Some(id));
        }

        let labels = CaptionLabels::new(captions.into_keys().collect());
        let (train, representation) = (dataset.train, dataset.representation);
        let samples = ClipSamples::new(train, representation, statistics, 263, &config, 1);
        let batch = samples.with_labels(labels.clone()).collate(0..clips.len());
        let batch = batch.unwrap();
        let text = batch.condition(crate::TEXT).unwrap();
        assert_eq!(text.channels, labels.captions().len());
        for (clip, values) in clips.iter().zip(text.values.chunks(text.channels)) {
            let expected = labels.row(&clip.captions[0].text);
            assert_eq!(values, labels.values(expected), "{}", clip.id);
            assert!(expected.is_some());
        }
    }
}
