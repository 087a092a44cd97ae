//! Selecting the best step by metrics of samples (`validation.select_by`).

use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

use burn::tensor::Device;
use kinegrad_data::{Batch, PhraseItem, PhraseSet};
use kinegrad_diffusion::GaussianDiffusion;
use kinegrad_models::GradientSum;
use kinegrad_train::checkpoint::State;
use kinegrad_train::config::SelectBy;
use kinegrad_train::{Error, Loss, Measured, ProcessGroup, Recipe, Score, StepKey};

use super::CondSource;
use super::evaluate::{EvaluationReport, SampleSettings, evaluate};
use super::generate::Generator;
use super::lengths::leading;
use crate::network::{MotionDecoder, MotionModel, UNet1d};

/// Seed of the samples, the same at each validation and in all runs, so that only weights differ.
const SEED: u64 = 0;

/// The networks of sampling.
pub(super) trait Networks {
    /// Denoiser and decoder, if there is one.
    fn networks(&self) -> (UNet1d, Option<MotionDecoder>);
}

impl Networks for UNet1d {
    fn networks(&self) -> (UNet1d, Option<MotionDecoder>) {
        (self.clone(), None)
    }
}

impl Networks for MotionModel {
    fn networks(&self) -> (UNet1d, Option<MotionDecoder>) {
        (self.unet.clone(), Some(self.decoder.clone()))
    }
}

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
    /// The selection that `validation.select_by` of the state's config names, on the first of the
    /// phrases `held_out`; none where that is the loss, or nothing is validated.
    ///
    /// # Errors
    /// If fewer than two phrases are held out, or if one cannot be read.
    pub fn new(
        held_out: &PhraseSet,
        diffusion: &GaussianDiffusion,
        state: State,
        group: &Rc<ProcessGroup>,
    ) -> Result<Option<Self>, Error> {
        let validation = &state.config.validation;
        let by = validation.select_by;
        if by == SelectBy::Loss || validation.every_steps == 0 || held_out.is_empty() {
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

    /// The score of networks on the plain `device`, by one sample for each phrase.
    fn score(&self, networks: &impl Networks, device: &Device) -> Result<Score, Error> {
        let (unet, decoder) = networks.networks();
        let (diffusion, state) = (self.diffusion.clone(), self.state.clone());
        let generator = Generator::of(unet, decoder, diffusion, state, device);
        let settings = SampleSettings {
            seeds: 1,
            seed: SEED,
            cond: CondSource::Phrases,
        };
        let no_progress = &mut |_, _, _| ControlFlow::Continue(());
        let (phrases, group) = (&self.phrases, &self.group);
        let report = evaluate(&generator, phrases, &[], settings, group, no_progress)?;
        Ok(score(self.by, &report))
    }
}

/// The score of an evaluation; infinite if samples are not finite.
fn score(by: SelectBy, report: &EvaluationReport) -> Score {
    let (sampled, real) = (&report.processed, &report.real);
    let metrics = [
        ("frechet", sampled.frechet_held_out),
        ("diversity", sampled.diversity),
    ];
    let ratio = sampled.diversity.zip(real.diversity);
    let value = match by {
        SelectBy::Loss => None,
        SelectBy::Frechet => sampled.frechet_held_out,
        SelectBy::Diversity => ratio.map(|(sampled, real)| (sampled / real).ln().abs()),
    };
    let finite = |metric: (&'static str, Option<f64>)| {
        let value = metric.1.filter(|value| value.is_finite())?;
        Some((metric.0, value))
    };
    Score {
        value: value
            .filter(|value| !value.is_nan())
            .unwrap_or(f64::INFINITY),
        metrics: metrics.into_iter().filter_map(finite).collect(),
    }
}

/// A recipe whose best step is selected by samples, if so.
pub(super) struct Selecting<R> {
    /// The trained part.
    pub recipe: R,
    /// The criterion of the best step, if other than the loss.
    pub selection: Option<Selection>,
}

impl<R: Recipe<Model: Networks>> Recipe for Selecting<R> {
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
        let selection = self.selection.as_ref();
        selection.map(|by| by.score(model, device)).transpose()
    }
}
