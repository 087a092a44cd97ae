//! Phrases of a dataset: their statistics, and how they are read or made up.

use kinegrad_motion::kinematics::mean_jerk_norm;
use kinegrad_motion::{ChannelMoments, TrainingStatistics};

use crate::files::Files;
use crate::item::{Item, ItemSet};
use crate::layout::{features_path, motion_path};
use crate::library::{Origin, Reading};
use crate::listing::Expected;
use crate::npy::MAX_MOTION_BYTES;
use crate::npz::MAX_FEATURES_BYTES;
use crate::phrase::Named;
use crate::{Error, FileError, Phrase, SyntheticConfig, synthetic};

/// Phrases in the order of their ids. A clone is another handle to the same ones.
pub type PhraseSet = ItemSet<Phrase>;

impl Item for Phrase {
    const KIND: &'static str = "phrase";

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
}

impl ItemSet<Phrase> {
    /// The statistics of their motion, some phrases at a time.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    ///
    /// # Panics
    /// Panics if there are no phrases: a dataset has at least one to train on.
    pub fn statistics(&self) -> Result<TrainingStatistics, Error> {
        let mut moments: Option<ChannelMoments> = None;
        let mut jerks = Vec::with_capacity(self.len());
        let measure = |phrase: &Phrase| {
            let moments = ChannelMoments::compute([&phrase.motion]);
            let moments = moments.expect("phrases hold finite numbers only");
            Ok((moments, mean_jerk_norm(&phrase.motion)))
        };
        self.measure(measure, |(of_phrase, jerk)| {
            jerks.push(jerk);
            match &mut moments {
                Some(moments) => moments.merge(&of_phrase),
                None => moments = Some(of_phrase),
            }
        })?;
        let moments = moments.expect("a phrase to train on");
        Ok(TrainingStatistics::from_moments(moments, jerks))
    }
}

/// Phrases of the layout of CC-MotionGen, section 1.3.
#[derive(Debug)]
pub(crate) struct PhraseFiles(pub Files);

impl Origin<Phrase> for PhraseFiles {
    fn read(
        &self,
        _number: usize,
        id: &str,
        expected: &[Expected],
        recorded: &'static str,
    ) -> Result<Reading<Phrase>, FileError> {
        let [motion, audio] = expected else {
            unreachable!("a phrase has two files");
        };
        let Self(files) = self;
        let paths = (motion_path(id), features_path(id));
        let (motion, motion_digest) = files.read(&paths.0, motion, MAX_MOTION_BYTES, recorded)?;
        let (audio, audio_digest) = files.read(&paths.1, audio, MAX_FEATURES_BYTES, recorded)?;
        let names = (files.store.name_of(&paths.0), files.store.name_of(&paths.1));
        let motion = Named {
            bytes: &motion,
            name: &names.0,
        };
        let audio = Named {
            bytes: &audio,
            name: &names.1,
        };
        let (phrase, note) = Phrase::parse(id, motion, audio)?;
        Ok(Reading {
            note,
            content: vec![motion_digest, audio_digest],
            ..Reading::of(phrase)
        })
    }
}

/// Phrases that are made up anew each time.
#[derive(Debug)]
pub(crate) struct MadeUpPhrases(pub SyntheticConfig);

impl Origin<Phrase> for MadeUpPhrases {
    fn read(
        &self,
        number: usize,
        _id: &str,
        _expected: &[Expected],
        _recorded: &'static str,
    ) -> Result<Reading<Phrase>, FileError> {
        let SyntheticConfig { frames, seed, .. } = self.0;
        Ok(Reading::of(synthetic::phrase(number, frames, seed)))
    }

    fn fingerprint(&self) -> String {
        format!("{:?}", self.0)
    }
}
