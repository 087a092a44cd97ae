//! Some of the phrases of a dataset, read when they are asked for.

use std::sync::Arc;

use kinegrad_motion::kinematics::mean_jerk_norm;
use kinegrad_motion::{ChannelMoments, TrainingStatistics};
use rayon::prelude::*;

use crate::library::Library;
use crate::{Error, Phrase};

/// Phrases whose statistics are taken at a time: enough for all cores, few enough for any memory.
const CHUNK: usize = 256;

/// Phrases in the order of their ids. A clone is another handle to the same ones.
#[derive(Clone, Debug)]
pub struct PhraseSet {
    library: Arc<Library>,
    /// Their numbers in the library.
    indices: Arc<[usize]>,
}

impl PhraseSet {
    pub(crate) fn new(library: Arc<Library>, indices: Vec<usize>) -> Self {
        Self {
            library,
            indices: indices.into(),
        }
    }

    /// Number of phrases.
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// Their ids, in order.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.indices
            .iter()
            .map(|&index| self.library.entries[index].id.as_str())
    }

    /// Frames of phrase `position`, without reading it.
    ///
    /// # Panics
    /// Panics if there are not so many.
    pub fn frames(&self, position: usize) -> usize {
        self.library.entries[self.indices[position]].frames
    }

    /// Id of phrase `position`, without reading it.
    ///
    /// # Panics
    /// Panics if there are not so many.
    pub fn id(&self, position: usize) -> &str {
        &self.library.entries[self.indices[position]].id
    }

    /// Phrase `position`.
    ///
    /// # Errors
    /// [`Error::BadPhrase`] if its files are gone, have changed or cannot be read any more.
    ///
    /// # Panics
    /// Panics if there are not so many.
    pub fn get(&self, position: usize) -> Result<Arc<Phrase>, Error> {
        self.library.get(self.indices[position])
    }

    /// Whether phrase `position` is in memory now.
    pub(crate) fn is_at_hand(&self, position: usize) -> bool {
        self.library.is_at_hand(self.indices[position])
    }

    /// The phrases whose ids `choose` picks.
    #[must_use]
    pub fn filter(&self, choose: impl Fn(&str) -> bool) -> Self {
        let chosen = |index: &&usize| choose(&self.library.entries[**index].id);
        let indices = self.indices.iter().filter(chosen).copied().collect();
        Self::new(self.library.clone(), indices)
    }

    /// All of them at once, to be held in memory.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    pub fn load(&self) -> Result<Vec<Arc<Phrase>>, Error> {
        (0..self.len())
            .into_par_iter()
            .map(|position| self.get(position))
            .collect()
    }

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
        let positions: Vec<usize> = (0..self.len()).collect();
        for chunk in positions.chunks(CHUNK) {
            let measured: Vec<_> = chunk
                .par_iter()
                .map(|&position| {
                    let phrase = self.get(position)?;
                    let moments = ChannelMoments::compute([&phrase.motion]);
                    let moments = moments.expect("phrases hold finite numbers only");
                    Ok((moments, mean_jerk_norm(&phrase.motion)))
                })
                .collect::<Result<_, Error>>()?;
            for (of_phrase, jerk) in measured {
                jerks.push(jerk);
                match &mut moments {
                    Some(moments) => moments.merge(&of_phrase),
                    None => moments = Some(of_phrase),
                }
            }
        }
        let moments = moments.expect("a phrase to train on");
        Ok(TrainingStatistics::from_moments(moments, jerks))
    }

    pub(crate) fn counters(&self) -> &Arc<crate::Counters> {
        &self.library.counters
    }
}

impl From<Vec<Arc<Phrase>>> for PhraseSet {
    /// Phrases that stay in memory, in this order.
    fn from(phrases: Vec<Arc<Phrase>>) -> Self {
        let indices = (0..phrases.len()).collect();
        Self::new(Arc::new(Library::held(phrases)), indices)
    }
}
