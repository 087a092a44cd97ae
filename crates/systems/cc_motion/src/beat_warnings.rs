//! Warnings of training about music that the motion does not follow.

use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{
    BeatAgreement, BeatPhrase, DataConfig, Dataset, PhraseItem, PhraseSet, Songs, tracked_error,
};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_train::checkpoint::State;
use kinegrad_train::evaluation::for_each_item;
use kinegrad_train::sampling::item_seed;
use kinegrad_train::{Error, Observer, ProcessGroup};

use super::evaluate::beat_verdict::beat_verdict;
use super::generate::{Generator, keys};
use super::lengths::leading;
use crate::network::{MotionDecoder, UNet1d};

/// Most training phrases whose beats are tracked.
const MOST_TRACKED: usize = 24;

/// Most held-out phrases that are sampled.
const MOST_SAMPLED: usize = 16;

/// Warns if the phase of the training phrases does not follow the beats tracked in their music. Each
/// process reads a part of them. Collective.
pub(super) fn warn_of_data(
    dataset: &Dataset<PhraseItem>,
    data: &DataConfig,
    group: &ProcessGroup,
    observer: &mut dyn Observer,
) -> Result<(), Error> {
    let songs = group.done(Songs::read(data).map_err(Error::from))?;
    let all = dataset.train.len();
    let count = all.min(MOST_TRACKED);
    let no_progress = &mut |_, _, _| ControlFlow::Continue(());
    let errors = for_each_item(group, count, no_progress, |index, _| {
        let phrase = dataset.train.get(index * all / count)?;
        Ok(tracked_error(phrase, &songs))
    })?;
    let agreement = BeatAgreement::of(errors.into_iter().flatten());
    let agreement = agreement.filter(|_| group.writes());
    if let Some(beats) = agreement.filter(BeatAgreement::is_at_chance) {
        observer.warning(&format!(
            "the phase of the training phrases does not follow the beats tracked in their music: \
             {beats}; a model cannot learn the beat from the music"
        ));
    }
    Ok(())
}

/// The held-out phrases whose beats samples should follow.
pub(super) struct HeldOutBeats {
    phrases: Vec<BeatPhrase>,
    diffusion: GaussianDiffusion,
    /// The state of a checkpoint.
    state: State,
    /// The processes that share the sampling.
    group: Rc<ProcessGroup>,
}

impl HeldOutBeats {
    /// Some phrases of `held_out` with beats, cut to the training length.
    pub fn new(
        held_out: &PhraseSet,
        diffusion: &GaussianDiffusion,
        state: State,
        group: &Rc<ProcessGroup>,
    ) -> Result<Self, Error> {
        let songs = Songs::read(&state.config.data)?;
        let longest = state.config.data.target_frames;
        let phrases: Vec<Arc<PhraseItem>> = held_out.evenly(MOST_SAMPLED)?;
        let phrases = phrases.iter().map(|phrase| leading(phrase, longest));
        Ok(Self {
            phrases: phrases
                .filter_map(|phrase| BeatPhrase::new(phrase, &songs, None))
                .collect(),
            diffusion: diffusion.clone(),
            state,
            group: group.clone(),
        })
    }

    /// The verdict on networks on the plain `device`, if their samples do not follow the beats: from
    /// one sample per phrase, of enough phrases for a verdict. Collective.
    pub fn warning(
        &self,
        (unet, decoder): (UNet1d, Option<MotionDecoder>),
        device: &Device,
    ) -> Result<Option<String>, Error> {
        let (diffusion, state) = (self.diffusion.clone(), self.state.clone());
        let generator = Generator::of(unet, decoder, diffusion, state, device);
        let no_progress = &mut |_, _, _| ControlFlow::Continue(());
        let errors = for_each_item(&self.group, self.phrases.len(), no_progress, |index, _| {
            let phrase = &self.phrases[index];
            let seed = item_seed(0, &phrase.phrase.id);
            let audio = std::iter::once(phrase.phrase.audio.clone());
            let mut error = f64::NAN;
            generator.sample_each(
                audio.zip(keys(seed, 1)),
                &self.state.config.sampling,
                &mut |_, _| ControlFlow::Continue(()),
                &mut |sample| {
                    error = phrase.phase_error(&sample.motion);
                    Ok(())
                },
            )?;
            Ok(error)
        })?;
        let songs = self.phrases.iter().map(|phrase| phrase.song.clone());
        let agreement = BeatAgreement::of(songs.zip(errors));
        let unrelated = agreement.filter(BeatAgreement::is_at_chance);
        Ok(unrelated.map(|agreement| {
            format!(
                "{}; beat features (`data.audio_features`), more steps or more songs help",
                beat_verdict(&agreement.error, self.phrases.len(), None)
            )
        }))
    }
}
