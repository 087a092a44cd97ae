//! Motion composed of texts, from a checkpoint.

use std::ops::ControlFlow;

use crate::network::{BlendedTransformer, Composed, Segment, Switch, TextSegments};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{
    ClipRange, GaussianDiffusion, Guidance, Networks, NoiseKeys, SamplerConfig, Space as _,
    Steering, Time, sample, sample_with, steered_prediction,
};
use kinegrad_motion::humanml::Features;
use kinegrad_motion::{Representation, Statistics};
use kinegrad_random::Key;

use super::load::{text_input, trained};
use super::path::{PathControl, path_condition};
use super::{BpeTables, ComposeEvaluationConfig};
use kinegrad_train::Error;
use kinegrad_train::TrainedModel;
use kinegrad_train::checkpoint::State;
use kinegrad_train::clips::FeatureSpace;
use kinegrad_train::clips::TimedPrompt;
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::path_target::{Fastest, PathTarget};
use kinegrad_train::config::Config;

/// A trained network, ready to compose motion.
pub struct Composer {
    plain: BlendedTransformer,
    tracked: BlendedTransformer,
    diffusion: GaussianDiffusion,
    space: FeatureSpace,
    text: TextInput,
    state: State,
    device: Device,
}

impl Composer {
    /// Loads the network of a trained model.
    ///
    /// # Errors
    /// If the checkpoint is damaged or does not fit its own config.
    pub fn load(model: &TrainedModel) -> Result<Self, Error> {
        let (device, state) = (&model.device, model.saved.state.clone());
        let network = trained(&model.saved, model.weights, &device.clone().autodiff())?;
        let own: &BpeTables = state.config.own();
        let statistics = state.clip_statistics()?;
        Ok(Self {
            plain: network.valid(),
            tracked: network.no_grad(),
            diffusion: GaussianDiffusion::new(&own.diffusion)?,
            space: FeatureSpace::new(&statistics.mean, &statistics.std, None, device),
            text: text_input(&state.config),
            state,
            device: device.clone(),
        })
    }

    /// The config the model was trained with.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    /// The statistics of its features.
    ///
    /// # Errors
    /// If the run is of another system.
    pub(super) fn statistics(&self) -> Result<&Statistics, Error> {
        self.state.clip_statistics()
    }

    /// The fastest that a root was in training, for what asks for more.
    ///
    /// # Errors
    /// If the run is of another system.
    pub(crate) fn fastest(&self) -> Result<Fastest, Error> {
        let skeleton = self.config().data.humanml3d.skeleton.skeleton();
        // Displacements of joint 0, in the facing frame, metres per frame.
        let first = skeleton.layout().velocities().start;
        let statistics = self.state.clip_statistics()?;
        Ok(Fastest::of(statistics, first, skeleton.description().fps))
    }

    /// One motion of all `lines`, without overlaps or transitions; each line starts where the
    /// previous one ends. With a `target` it is sampled along that according to `settings.path`,
    /// and the caller moves it onto the target. `on_step` is called with the steps done and in total.
    ///
    /// # Errors
    /// If the model does not know a text, the sampler's settings cannot work, or the result is not
    /// finite.
    ///
    /// # Panics
    /// Panics without a line, or for one without a frame.
    pub fn compose(
        &self,
        lines: &[TimedPrompt],
        sampler: &SamplerConfig,
        settings: &ComposeEvaluationConfig,
        target: Option<&PathTarget>,
        key: Key,
        on_step: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Features, Error> {
        let segments = lines.iter().enumerate().map(|(text, line)| Segment {
            text,
            frames: line.frames,
        });
        let segments = TextSegments::new([segments.collect()]);
        let humanml3d = &self.config().data.humanml3d;
        let path = match target.filter(|_| settings.path.method.conditions()) {
            Some(target) => {
                self.must_know_paths()?;
                let fps = humanml3d.skeleton.skeleton().description().fps;
                Some(path_condition(target, fps, &self.device))
            }
            None => None,
        };
        let composed = |network| Composed {
            network,
            segments: segments.clone(),
            path: path.clone(),
            switch: Switch {
                bpe_denoising_step: settings.bpe_denoising_step,
                num_train_timesteps: self.diffusion.config.num_train_timesteps,
            },
        };
        let (plain, tracked) = (composed(&self.plain), composed(&self.tracked));
        let cond = self.text_conditions(lines)?;
        let frames: usize = lines.iter().map(|line| line.frames).sum();
        let channels = humanml3d.representation().channels();
        let start = key.named("start").normals(channels * frames);
        let start = TensorData::new(start, [1, channels, frames]);
        let has_text = lines.iter().any(|line| line.text.is_some());
        let sampler = SamplerConfig {
            // Without any text both passes of the guidance are the same one.
            guidance_scale: if has_text {
                sampler.guidance_scale
            } else {
                0.0
            },
            ..sampler.clone()
        };
        let start = Tensor::from_data(start, &self.device);
        let numbered = [(key, 0)];
        let keys = NoiseKeys::Numbered(&numbered);
        let mut on_sampled = |done, all, _: &Tensor<3>| on_step(done, all);
        let x = match target.filter(|_| settings.path.method.acts()) {
            None => sample(
                &self.diffusion,
                &plain,
                start,
                &cond,
                &sampler,
                &ClipRange::None,
                keys,
                &mut on_sampled,
            )?,
            Some(target) => {
                let statistics = self.statistics()?;
                let control =
                    PathControl::new(&settings.path, target, humanml3d.root, statistics, key);
                let networks = Networks {
                    tracked: &tracked,
                    plain: &plain,
                };
                let mut predict = |x: Tensor<3>, time: &[Time]| {
                    let t = time[0].timestep();
                    let x = control.noisy(x, t, &self.diffusion);
                    let path = &settings.path;
                    let guided = path.method.guides() && path.through_network && control.acts(t);
                    let steering = Steering {
                        guidance: guided.then_some(Guidance {
                            objective: &control,
                            scale: path.guidance_step_size(humanml3d.root),
                            max_shift: Some(path.max_shift),
                        }),
                        imputation: None,
                    };
                    let mut prediction = steered_prediction(
                        &self.diffusion,
                        &networks,
                        x,
                        time,
                        &cond,
                        sampler.guidance(t),
                        &ClipRange::None,
                        steering,
                    )?;
                    prediction.x_start = control.clean(prediction.x_start, t);
                    // The noise follows from the clean motion, not from the network's output.
                    prediction.clipped = true;
                    Ok(prediction)
                };
                let diffusion = &self.diffusion;
                control.last(sample_with(
                    diffusion,
                    &mut predict,
                    start,
                    &sampler,
                    keys,
                    &mut on_sampled,
                )?)
            }
        };
        let rows = self.space.to_motion(x).swap_dims(1, 2);
        let values = rows.try_into_vec_as::<f32>().expect("samples are float32");
        if !values.iter().all(|value| value.is_finite()) {
            let sample = "the motion".to_owned();
            return Err(Error::SampleNotFinite { sample });
        }
        let layout = humanml3d.skeleton.skeleton().layout();
        Ok(Features::new(values, layout, humanml3d.root)?)
    }

    fn must_know_paths(&self) -> Result<(), Error> {
        match self.plain.has_path() {
            true => Ok(()),
            false => Err(Error::usage(
                "option `method tokens`, and a run whose network has no path condition",
                "teach it with recipe `path_adapter`, or use another method (docs/compose.md)",
            )),
        }
    }

    /// The text conditions of the lines, `[lines, text channels, 1]`; zeros without a text.
    fn text_conditions(&self, lines: &[TimedPrompt]) -> Result<Tensor<3>, Error> {
        let channels = self.text.channels();
        let mut values = Vec::with_capacity(lines.len() * channels);
        for line in lines {
            let value = line.text.as_ref().map(|text| self.text.values(text));
            let value = value.transpose()?.flatten();
            values.extend(value.unwrap_or_else(|| vec![0.0; channels]));
        }
        let data = TensorData::new(values, [lines.len(), channels, 1]);
        Ok(Tensor::from_data(data, &self.device))
    }
}
