//! Selecting the best step by metrics of samples (`validation.select_by`).

use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{Batch, PhraseItem, PhraseSet, Songs};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::GradientSum;
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::SelectBy;
use kinegrad_train::{Error, Loss, Measured, ProcessGroup, Recipe, Score, StepKey};

use super::CondSource;
use super::beat_warnings::HeldOutBeats;
use super::evaluate::{EvaluationReport, HeldOut, SampleSettings, evaluate};
use super::generate::Generator;
use super::lengths::leading;
use crate::network::{MotionDecoder, UNet1d};

/// Seed of the samples; equal at each validation and in all runs, so that only weights differ.
const SEED: u64 = 0;

/// Denoiser and optional decoder of a trained model.
pub(super) type NetworksOf<M> = fn(&M) -> (UNet1d, Option<MotionDecoder>);

/// The held-out phrases of the samples.
pub(super) struct Selection {
    by: SelectBy,
    phrases: Vec<Arc<PhraseItem>>,
    diffusion: GaussianDiffusion,
    /// The state of a checkpoint.
    state: State,
    /// The processes that share the sampling.
    group: Rc<ProcessGroup>,
}

impl Selection {
    /// The selection by `validation.select_by` in the state's config, on the first phrases of
    /// `held_out`, at least two. `None` for selection by the loss or without validation.
    pub fn new(
        held_out: &PhraseSet,
        diffusion: &GaussianDiffusion,
        state: State,
        group: &Rc<ProcessGroup>,
    ) -> Result<Option<Self>, Error> {
        let validation = &state.config.validation;
        let by = validation.select_by;
        if by == SelectBy::Loss || !validation.is_enabled() || held_out.is_empty() {
            return Ok(None);
        }
        if held_out.len() < 2 {
            return Err(Error::usage(
                "`validation.select_by` compares sets of samples, and one phrase is held out",
                "hold out more phrases (`data.validation`), or select by \"loss\"",
            ));
        }
        let longest = state.config.data.target_frames;
        let phrases = held_out.first(validation.select_samples)?;
        Ok(Some(Self {
            by,
            phrases: phrases.iter().map(|one| leading(one, longest)).collect(),
            diffusion: diffusion.clone(),
            state,
            group: group.clone(),
        }))
    }

    /// The score of networks on the plain `device`, from one sample per phrase.
    fn score(
        &self,
        (unet, decoder): (UNet1d, Option<MotionDecoder>),
        device: &Device,
    ) -> Result<Score, Error> {
        let (diffusion, state) = (self.diffusion.clone(), self.state.clone());
        let generator = Generator::of(unet, decoder, diffusion, state, device);
        let settings = SampleSettings {
            seeds: 1,
            seed: SEED,
            cond: CondSource::Phrases,
        };
        let no_progress = &mut |_, _, _| ControlFlow::Continue(());
        let held_out = HeldOut {
            phrases: &self.phrases,
            songs: &Songs::default(),
            beats_per_bar: None,
        };
        let report = evaluate(
            &generator,
            held_out,
            &[],
            settings,
            &self.group,
            no_progress,
        )?;
        Ok(score(self.by, &report))
    }
}

/// The score of an evaluation; infinity if a sample is not finite.
fn score(by: SelectBy, report: &EvaluationReport) -> Score {
    let (sampled, real) = (&report.processed, &report.real);
    let ratio = sampled.diversity.zip(real.diversity);
    let value = match by {
        SelectBy::Loss => None,
        SelectBy::Frechet => sampled.frechet_held_out,
        SelectBy::Diversity => ratio.map(|(sampled, real)| (sampled / real).ln().abs()),
    };
    let metrics = [
        ("frechet", sampled.frechet_held_out),
        ("diversity", sampled.diversity),
    ];
    let metrics = metrics.into_iter();
    Score {
        value: value
            .filter(|value| !value.is_nan())
            .unwrap_or(f64::INFINITY),
        metrics: metrics
            .filter_map(|(name, value)| Some((name, value.filter(|value| value.is_finite())?)))
            .collect(),
    }
}

/// A recipe with optional selection of the best step by samples.
pub(super) struct Selecting<R: Recipe> {
    /// The trained part.
    pub recipe: R,
    /// The criterion of the best step, if not the loss.
    pub selection: Option<Selection>,
    /// The held-out phrases whose beats samples should follow.
    pub beats: HeldOutBeats,
    /// The networks that generate the samples.
    pub networks: NetworksOf<R::Model>,
}

impl<R: Recipe> Recipe for Selecting<R> {
    type Model = R::Model;
    type Pending = R::Pending;

    fn group_of(&self, parameter: &str) -> usize {
        self.recipe.group_of(parameter)
    }

    fn measures_first(&self) -> bool {
        self.recipe.measures_first()
    }

    fn weight(&self, batch: &Batch) -> f64 {
        self.recipe.weight(batch)
    }

    fn loss(
        &self,
        model: &Self::Model,
        batch: &Batch,
        key: StepKey,
        device: &Device,
    ) -> Loss<Self::Pending> {
        self.recipe.loss(model, batch, key, device)
    }

    fn backward(&self, model: &Self::Model, loss: Loss<Self::Pending>) -> GradientSum {
        self.recipe.backward(model, loss)
    }

    fn validation_loss(&self, model: &Self::Model, device: &Device) -> Measured {
        self.recipe.validation_loss(model, device)
    }

    fn score(&self, model: &Self::Model, device: &Device) -> Result<Option<Score>, Error> {
        let score = |selection: &Selection| selection.score((self.networks)(model), device);
        self.selection.as_ref().map(score).transpose()
    }

    fn warning(&self, model: &Self::Model, device: &Device) -> Result<Option<String>, Error> {
        self.beats.warning((self.networks)(model), device)
    }
}
