//! Phrases of a dataset: listing, reading and synthesis.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

use kinegrad_motion::Phrases;
use kinegrad_settings::{InvalidSetting, counted};

use crate::audio_layout::AudioLayout;
use crate::beat_agreement::tracked_error;
use crate::files::Files;
use crate::item::Item;
use crate::item_set::ItemSet;
use crate::item_store::{ItemSource, ReadItem, ReadRequest};
use crate::labels::Labels;
use crate::layout::{features_path, motion_path};
use crate::listing::{Listed, Listing, ids};
use crate::npy::MAX_MOTION_BYTES;
use crate::npz::MAX_FEATURES_BYTES;
use crate::pattern::idle;
use crate::scan::{Listable, Scan};
use crate::split::Split;
use crate::store::Store;
use crate::{
    DataConfig, DataKind, Error, FileError, PhraseItem, Songs, SyntheticConfig, synthetic,
};

/// Phrases in the order of their ids. A clone shares the phrases.
pub type PhraseSet = ItemSet<PhraseItem>;

impl Item for PhraseItem {
    const KIND: &'static str = "phrase";

    type Representation = Phrases;

    fn id(&self) -> &str {
        &self.id
    }

    fn frames(&self) -> usize {
        self.motion.frames()
    }

    fn bytes(&self) -> usize {
        let values = self.motion.as_slice().len() + self.audio.as_slice().len();
        size_of_val(self) + self.id.len() + 4 * values
    }

    fn rows(&self, _representation: &Phrases) -> Cow<'_, [f32]> {
        Cow::Borrowed(self.motion.as_slice())
    }

    fn label(&self) -> Option<&str> {
        self.label.as_deref()
    }

    fn conditions(&self) -> Vec<(&'static str, &[f32])> {
        let arrays = self.audio.arrays();
        arrays.map(|(name, _, values)| (name, values)).collect()
    }

    fn tracked_beats(&self, songs: &Songs) -> Option<(String, f64)> {
        tracked_error(Arc::new(self.clone()), songs)
    }
}

impl Listable for PhraseItem {
    fn scan(config: &DataConfig) -> Result<Scan<Self>, Error> {
        let split = Split::new(&config.validation)?;
        let mut scan = match config.kind {
            DataKind::Phrases => phrase_files(config)?,
            DataKind::Synthetic => Scan {
                representation: Phrases,
                stored_statistics: None,
                split: None,
                source: Box::new(SyntheticPhrases(
                    config.synthetic.clone(),
                    config.audio_layout(),
                    Labels::new(&config.labels, HashMap::new()),
                )),
                warnings: Vec::new(),
                listed: Listed::synthetic(config.synthetic.phrases, synthetic::id),
            },
            kind @ (DataKind::Humanml3d | DataKind::SyntheticWalks) => {
                return Err(Error::wrong_kind(
                    kind,
                    "\"phrases\" or \"synthetic\"",
                    "clips are not phrases: use a recipe or command for clips",
                ));
            }
        };
        scan.warnings.extend(split.idle_entries(ids(&scan.listed)));
        let labelled = idle("data.labels", config.labels.keys(), ids(&scan.listed));
        scan.warnings.extend(labelled);
        scan.split = Some(split);
        Ok(scan)
    }
}

fn phrase_files(config: &DataConfig) -> Result<Scan<PhraseItem>, Error> {
    let source = config.source.as_deref().unwrap_or_default();
    let store = Store::open(source, &config.store)?;
    let mut listing = Listing::read(&store)?;
    let layout = config.audio_layout();
    if let Some(id) = listing.without_beats.filter(|_| layout.beats) {
        let found = "[\"ccmotion\", \"beats\"]";
        let allowed = format!(
            "[\"ccmotion\"]: {} was prepared without beat features (phrase `{id}`)",
            store.uri()
        );
        let refused = InvalidSetting::new("data.audio_features", found, allowed);
        return Err(refused
            .hint(
                "prepare it again with `phrases.audio_features = [\"ccmotion\", \"beats\"]` in the plan, or \
                 leave the key out",
            )
            .into());
    }
    let (motion, audio) = (&listing.only_motion, &listing.only_audio);
    if listing.phrases.is_empty() {
        let (source, motion, audio) = (store.uri(), motion.len(), audio.len());
        return Err(Error::NothingToTrainOn {
            problem: format!(
                "data.source: {source} contains no phrase ({motion} only in motion/, {audio} only in \
                 audio_features/)"
            ),
            hint:
                "a phrase ID is a folder of the same name under motion/ and under audio_features/"
                    .to_owned(),
        });
    }
    for (alone, place, lacking) in [
        (motion, "motion", "audio_features"),
        (audio, "audio_features", "motion"),
    ] {
        if let Some(first) = alone.first() {
            let folders = counted(alone.len(), "folder");
            listing.warnings.push(format!(
                "{folders} under {place}/ without a counterpart under {lacking}/ left out, the first: \
                 {first}"
            ));
        }
    }
    listing
        .phrases
        .truncate(config.num_phrases.unwrap_or(usize::MAX));
    let files = Files::open(store, config, &mut listing.warnings)?;
    Ok(Scan {
        representation: Phrases,
        stored_statistics: None,
        split: None,
        warnings: listing.warnings,
        listed: listing.phrases,
        source: Box::new(PhraseFiles(
            files,
            layout,
            Labels::new(&config.labels, listing.labels),
        )),
    })
}

/// Phrases in files (CC-MotionGen, section 1.3), with their audio layout and labels.
#[derive(Debug)]
pub(crate) struct PhraseFiles(pub Files, pub AudioLayout, pub Labels);

impl ItemSource<PhraseItem> for PhraseFiles {
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<PhraseItem>, FileError> {
        let ReadRequest { id, recorded, .. } = request;
        let [motion, audio] = request.expected else {
            unreachable!("a phrase has two files");
        };
        let Self(files, layout, labels) = self;
        let paths = (motion_path(id), features_path(id));
        let (motion, motion_digest) = files.read(&paths.0, motion, MAX_MOTION_BYTES, recorded)?;
        let (audio, audio_digest) = files.read(&paths.1, audio, MAX_FEATURES_BYTES, recorded)?;
        let names = (files.store.name_of(&paths.0), files.store.name_of(&paths.1));
        let (phrase, note) =
            PhraseItem::parse(id, (&motion, &names.0), (&audio, &names.1), *layout)?;
        let phrase = labelled(phrase, labels);
        Ok(ReadItem {
            note,
            content: vec![motion_digest, audio_digest],
            ..ReadItem::of(phrase)
        })
    }

    fn files(&self) -> Option<&Files> {
        Some(&self.0)
    }

    fn fingerprint(&self) -> String {
        self.2.fingerprint()
    }
}

/// Adds a phrase's label.
fn labelled(phrase: PhraseItem, labels: &Labels) -> PhraseItem {
    PhraseItem {
        label: labels.of(&phrase.id).map(str::to_owned),
        ..phrase
    }
}

/// Phrases that are synthesized on demand, with their audio layout and labels.
#[derive(Debug)]
pub(crate) struct SyntheticPhrases(pub SyntheticConfig, pub AudioLayout, pub Labels);

impl ItemSource<PhraseItem> for SyntheticPhrases {
    fn read(&self, request: ReadRequest<'_>) -> Result<ReadItem<PhraseItem>, FileError> {
        let SyntheticConfig { frames, seed, .. } = self.0;
        let Self(_, layout, labels) = self;
        let phrase = synthetic::phrase_in(*layout, request.number, frames, seed);
        Ok(ReadItem::of(labelled(phrase, labels)))
    }

    fn fingerprint(&self) -> String {
        match self.1.beats {
            false => format!("{:?}", self.0),
            true => format!("{:?} with beats", self.0),
        }
    }
}
