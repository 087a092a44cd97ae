//! The training loop.

mod accumulation;
mod exchange;
mod gradients;
mod not_finite;
mod owners;
mod previews;
pub(crate) mod restore;
mod rows;
mod saving;
mod states;

use std::borrow::Cow;
use std::path::PathBuf;
use std::rc::Rc;

use burn::module::Module;
use burn::tensor::Device;
use kinegrad_data::{Digest, Loader};
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_motion::Statistics;
use kinegrad_ranks::Receivers;

use crate::checkpoint::{Checkpoint, Checkpoints, Progress, Weights};
use crate::config::{Config, RunLength};
use crate::error::Error;
use crate::observer::{Observer, StepReport};
use crate::optim::{clip_factor, learning_rate, norm_of_squares};
use crate::process_group::ProcessGroup;
use crate::recipe::{Measured, Recipe};
use crate::run::preview_page;
use crate::telemetry::{LoaderLog, Metrics, Record};
use accumulation::Averaged;
use exchange::Exchange;
use gradients::StepGradients;
use saving::Saving;
use states::States;

/// The outcome of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All steps are done.
    Finished,
    /// The validation loss stopped falling.
    EarlyStopped,
    /// Interrupted by the user.
    Interrupted,
}

/// Trains the networks of one recipe.
pub struct Trainer<R: Recipe> {
    parts: TrainerParts<R>,
    /// `None` only during an update.
    model: Option<R::Model>,
    infos: Vec<ParameterInfo>,
    /// Optimizer group of each parameter.
    groups: Vec<usize>,
    states: States,
    /// Indices of running statistics, which are their own average.
    running: Vec<usize>,
    /// The exchange between ranks; borrowed during a step.
    exchange: Option<Exchange>,
    /// Steps done.
    pub step: u64,
    /// The run's length and intervals.
    length: RunLength,
    /// The state of the search for the best weights.
    pub progress: Progress,
    /// The writer of metrics; `None` for a trainer that only times its steps.
    record: Option<(Metrics, LoaderLog)>,
    checkpoints: Checkpoints,
    last_saved: Option<PathBuf>,
}

/// The inputs of a [`Trainer`], in addition to the networks.
pub struct TrainerParts<R: Recipe> {
    /// The recipe.
    pub recipe: R,
    /// Names of its optimizer groups.
    pub groups: &'static [&'static str],
    /// Steps of an epoch.
    pub steps_per_epoch: u64,
    /// The resolved config.
    pub config: Config,
    /// Statistics of the training data.
    pub statistics: Statistics,
    /// The statistics of the networks' channels, if different.
    pub network_statistics: Option<Statistics>,
    /// Autodiff device.
    pub device: Device,
    /// True if the device computes in main memory.
    pub on_host: bool,
    /// The batches from the next step on.
    pub loader: Loader,
    /// The contents of the dataset.
    pub dataset: Digest,
    /// The run's folder.
    pub folder: PathBuf,
    /// The processes that train the run; the first process writes.
    pub group: Rc<ProcessGroup>,
}

impl<R: Recipe> Trainer<R> {
    /// A trainer of `model` at step 0 or at the step of `checkpoint`, from which `model` was
    /// loaded.
    pub fn new(
        parts: TrainerParts<R>,
        model: R::Model,
        checkpoint: Option<Checkpoint>,
        observer: &mut dyn Observer,
    ) -> Result<Self, Error> {
        let mut trainer = Self::unrecorded(parts, model, checkpoint);
        let parts = &trainer.parts;
        if !parts.group.writes() {
            return Ok(trainer);
        }
        let mut warn = |text: &str| observer.warning(text);
        let metrics = Metrics::open(&parts.folder, trainer.step, &mut warn)?;
        let loader_log = LoaderLog::open(&parts.folder, parts.loader.report())?;
        trainer.record = Some((metrics, loader_log));
        Ok(trainer)
    }

    /// [`new`](Self::new) without files, for measurements.
    pub fn unrecorded(
        parts: TrainerParts<R>,
        model: R::Model,
        checkpoint: Option<Checkpoint>,
    ) -> Self {
        let infos = parameters::infos(&model);
        let state = checkpoint.as_ref().map(|checkpoint| &checkpoint.state);
        let progress = state.map_or_else(Progress::default, |state| state.progress.clone());
        let checkpoint_step = state.map(|state| state.step);
        let groups = infos.iter().map(|info| parts.recipe.group_of(&info.name));
        let groups: Vec<usize> = groups.collect();
        let states = States::new(&model, checkpoint, &parts, &infos, &groups);
        let exchange = states.exchange(&model, parts.group.ranks());
        let checkpoints = Checkpoints::of(&parts.folder);
        let last_saved = checkpoint_step.map(|step| checkpoints.step_path(step));
        Self {
            model: Some(model),
            groups,
            running: parameters::running_statistics(&infos),
            states,
            exchange,
            record: None,
            infos,
            length: parts.config.length(parts.steps_per_epoch),
            parts,
            step: checkpoint_step.unwrap_or(0),
            progress,
            checkpoints,
            last_saved,
        }
    }

    /// Trains to the end or until stopped, with a checkpoint of the last step.
    pub fn run(&mut self, observer: &mut dyn Observer) -> Result<Ending, Error> {
        let RunLength {
            max_steps,
            checkpoint_every,
            validate_every,
        } = self.length;
        let validates = validate_every > 0;
        let first = self.step;
        if self.step == 0 && validates && self.parts.recipe.measures_first() {
            // Training may worsen the initial weights. A run stopped here measures the initial
            // weights again.
            self.progress = Progress::default();
            if self.validate(observer)? {
                self.save_unless_saved(observer)?;
                let marked = match self.parts.group.writes() {
                    true => self.checkpoints.set_best(self.progress.best().as_ref()),
                    false => Ok(()),
                };
                self.parts.group.done(marked)?;
            }
        }
        if self.previews_are_due() {
            // A process that ended at this step may not have written the previews.
            let exist = preview_page(&self.parts.folder, self.step).exists();
            self.preview(exist, observer)?;
        }
        let mut written = Ok(());
        let ending = loop {
            if self.step >= max_steps {
                break Ending::Finished;
            }
            if self.is_out_of_patience() {
                break Ending::EarlyStopped;
            }
            // A write error of this rank is reported here.
            let before = std::mem::replace(&mut written, Ok(()));
            let goes = before.map(|()| (!observer.stop_requested()).then_some(()));
            if self.parts.group.agree(goes, &[])?.is_none() {
                break Ending::Interrupted;
            }
            let record = match self.train_step(observer) {
                // The data failed, not the training, so progress is saved.
                Err(error) if self.parts.group.saves_progress() => {
                    self.save_unless_saved(observer)?;
                    return Err(error);
                }
                outcome => match outcome? {
                    Some((report, record)) => {
                        observer.stepped(&report);
                        record
                    }
                    None => break Ending::Interrupted,
                },
            };
            written = self.write(&record);
            let best = self.is_due(validate_every) && self.validate(observer)?;
            let previews = self.previews_are_due();
            if best || previews || self.is_due(checkpoint_every) {
                self.save(observer)?;
            }
            if previews {
                self.preview(false, observer)?;
            }
        };
        self.parts.group.done(written)?;
        self.save_unless_saved(observer)?;
        if ending != Ending::Interrupted && validates && self.step > first {
            let device = self.parts.device.clone().inner();
            let warning = self.parts.recipe.warning(&self.averaged_model(), &device);
            let warning = self.parts.group.done(warning)?;
            warning.iter().for_each(|text| observer.warning(text));
        }
        Ok(ending)
    }

    /// Writes metrics and loading statistics if due.
    fn write(&mut self, record: &Record) -> Result<(), Error> {
        let train = &self.parts.config.train;
        let last = self.step == self.length.max_steps;
        let due = self.step.is_multiple_of(train.log_every_steps) || last;
        if let Some((metrics, loader_log)) = self.record.as_mut().filter(|_| due) {
            metrics.write(record)?;
            loader_log.write(self.step, self.parts.loader.report())?;
        }
        Ok(())
    }

    fn save_unless_saved(&mut self, observer: &mut dyn Observer) -> Result<(), Error> {
        if self.last_saved.as_ref() == Some(&self.checkpoints.step_path(self.step)) {
            return Ok(());
        }
        self.save(observer)
    }

    /// True if an event with this interval is due; every event is due at the last step.
    fn is_due(&self, every: u64) -> bool {
        let last = self.step == self.length.max_steps;
        every > 0 && (self.step.is_multiple_of(every) || last)
    }

    fn is_out_of_patience(&self) -> bool {
        let patience = self.parts.config.train.patience;
        patience > 0 && self.progress.validations_since_best >= patience
    }

    /// One step; `None` if a stop was requested while waiting for data or between micro-batches.
    pub(crate) fn train_step(
        &mut self,
        observer: &mut dyn Observer,
    ) -> Result<Option<(StepReport, Record)>, Error> {
        let Config { train, optim, .. } = self.parts.config.clone();
        let Some(Averaged {
            mut gradients,
            loss,
            terms,
        }) = self.averaged(observer)?
        else {
            return Ok(None);
        };
        let squares = gradients.squares(&self.parts.group);
        let grad_norm = norm_of_squares(&squares);
        if !grad_norm.is_finite() {
            let broken = match &gradients {
                StepGradients::Host(_) | StepGradients::Ranks(_) => {
                    squares.iter().position(|square| !square.is_finite())
                }
                StepGradients::Device(rows) => rows.broken(),
            };
            let what = broken.map_or("the norm of the gradient".into(), |index| {
                format!("the gradient of `{}`", self.infos[index].name)
            });
            return Err(self.not_finite(self.step + 1, what));
        }
        let names = self.parts.groups.iter();
        let max_steps = self.length.max_steps;
        let rate_of = |name| learning_rate(&optim, optim.rate_of(name), self.step, max_steps);
        let rates: Vec<f64> = names.clone().map(|name| rate_of(name)).collect();
        let rate = rates[0];
        let of_parameters = self.groups.iter().map(|&group| rates[group]);
        let model = self.model.take().expect("present between updates");
        self.model = Some(self.states.update(
            model,
            &mut gradients,
            clip_factor(grad_norm, train.max_grad_norm),
            &of_parameters.collect::<Vec<_>>(),
            self.parts.group.ranks(),
        ));
        if let StepGradients::Ranks(exchange) = gradients {
            self.exchange = Some(exchange);
        }
        self.step += 1;
        let report = StepReport {
            step: self.step,
            max_steps,
            loss,
            learning_rate: rate,
            grad_norm,
        };
        let mut record = Record::new(self.step)
            .with("loss", loss)
            .with("lr", rate)
            .with("grad_norm", grad_norm);
        for (name, rate) in names.zip(rates) {
            record = record.with(format!("lr_{name}"), rate);
        }
        for (name, value) in terms {
            record = record.with(format!("loss_{name}"), value);
        }
        Ok(Some((report, record)))
    }

    /// The networks with EMA weights, without gradients. Collective.
    fn averaged_model(&self) -> R::Model {
        let model = self.model.as_ref();
        let model = model.expect("present between updates").valid();
        let averages = self.averages(Receivers::All);
        parameters::replace(model, averages.into_owned())
    }

    /// The averages of all parameters, on the ranks that receive them. Collective.
    fn averages(&self, to: Receivers) -> Cow<'_, [Vec<f32>]> {
        let averages = self.states.averages(self.parts.group.ranks(), to);
        if self.running.is_empty() {
            return averages;
        }
        let mut averages = averages.into_owned();
        let model = self.model.as_ref().expect("present between updates");
        let values = parameters::values_at(model, &self.running);
        for (&index, values) in self.running.iter().zip(values) {
            averages[index] = values;
        }
        averages.into()
    }

    /// Validates the EMA weights and records the loss, and the score that selects the best step.
    pub(crate) fn measure(&mut self) -> Result<(f64, Option<f64>), Error> {
        let device = self.parts.device.clone().inner();
        let averaged = self.averaged_model();
        let Measured { total, terms } = self.parts.recipe.validation_loss(&averaged, &device);
        if !total.is_finite() {
            let broken = terms.iter().find(|(_, value)| !value.is_finite());
            let what = broken.map_or("the validation loss".into(), |(name, _)| {
                format!("the validation term `{name}`")
            });
            let tensor = format!("{what} of the averaged weights");
            return Err(self.not_finite(self.step, tensor));
        }
        let score = self.parts.recipe.score(&averaged, &device)?;
        let mut record = Record::new(self.step).with("val_loss", total);
        for (name, value) in terms {
            record = record.with(format!("val_loss_{name}"), value);
        }
        for (name, value) in score.iter().flat_map(|score| &score.metrics) {
            record = record.with(format!("val_{name}"), *value);
        }
        if let Some((metrics, _)) = &mut self.record {
            metrics.write(&record)?;
        }
        Ok((total, score.map(|score| score.value)))
    }

    /// Validates and updates the best step; true if the weights are the best so far.
    fn validate(&mut self, observer: &mut dyn Observer) -> Result<bool, Error> {
        let measured = self.measure();
        let numbers =
            |(val_loss, score): &(f64, Option<f64>)| [*val_loss, score.unwrap_or(f64::NAN)];
        let own = measured.as_ref().map_or([f64::NAN; 2], numbers);
        let agreed = self.parts.group.agree(measured.map(Some), &own)?;
        let ((_, score), all) = agreed.expect("no rank stops here");
        // The first rank's measurement applies to all ranks, so that all ranks decide alike.
        let (val_loss, score) = (all[0][0], score.map(|_| all[0][1]));
        let best = match score {
            Some(score) => score < self.progress.best_score.unwrap_or(f64::INFINITY),
            None => self
                .progress
                .best_val_loss
                .is_none_or(|best| val_loss < best),
        };
        if best {
            self.progress = Progress {
                best_step: Some(self.step),
                best_val_loss: Some(val_loss),
                best_score: score,
                validations_since_best: 0,
            };
        } else {
            self.progress.validations_since_best += 1;
        }
        observer.validated(self.step, val_loss, best);
        Ok(best)
    }

    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), Error> {
        let weights = parameters::values(self.model.as_ref().expect("present between updates"));
        let group = self.parts.group.clone();
        group.must_have_equal(self.step, &weights)?;
        // The metrics up to this step must survive a crash once the checkpoint exists.
        let synced = match &mut self.record {
            Some((metrics, _)) => metrics.sync(),
            None => Ok(()),
        };
        group.done(synced)?;
        let mut saving = Saving::begin(self);
        saving.weights(Weights::Model, &weights);
        drop(weights);
        // The first rank gathers one part after the other, even if writing has failed.
        let (ranks, to) = (group.ranks(), Receivers::First);
        let averages = self.averages(to);
        saving.weights(Weights::Ema, &averages);
        drop(averages);
        let moments = self.states.moments(ranks, to);
        saving.moments(&moments);
        drop(moments);
        group.done(saving.finish())?;
        let path = self.checkpoints.step_path(self.step);
        observer.saved(&path);
        self.last_saved = Some(path);
        Ok(())
    }

    /// The error of `step`, in which `tensor` has an infinity or NaN.
    fn not_finite(&self, step: u64, tensor: String) -> Error {
        let path = self.last_saved.as_ref();
        Error::NotFinite {
            step,
            tensor,
            last_good: path.map_or("none yet".into(), |path| path.display().to_string()),
        }
    }
}

#[cfg(test)]
mod tests;
