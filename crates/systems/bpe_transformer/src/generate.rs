//! Motion composed of texts, from a checkpoint.

use std::ops::ControlFlow;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{
    ClipRange, GaussianDiffusion, Guidance, Networks, NoiseKeys, SamplerConfig, Steering, Time,
    sample, sample_with, steered_prediction,
};
use kinegrad_motion::humanml::Features;
use kinegrad_motion::{Representation, Statistics};
use kinegrad_random::Key;
use kinegrad_train::checkpoint::State;
use kinegrad_train::clips::captions::TextInput;
use kinegrad_train::clips::path_condition::of_path;
use kinegrad_train::clips::path_target::{Fastest, PathTarget};
use kinegrad_train::clips::{FeatureSpace, TimedPrompt};
use kinegrad_train::config::Config;
use kinegrad_train::{Error, TrainedModel};

use super::load::{text_input, trained};
use super::path::PathControl;
use super::{BpeTables, ComposeEvaluationConfig};
use crate::network::{BlendedTransformer, Composed, Segment, Switch, TextSegments};

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
    /// If the checkpoint is damaged.
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

    /// The run's config.
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    pub(super) fn statistics(&self) -> Result<&Statistics, Error> {
        self.state.clip_statistics()
    }

    /// The largest speed of a root in training.
    pub(super) fn fastest(&self) -> Result<Fastest, Error> {
        let skeleton = self.config().data.humanml3d.skeleton();
        Ok(Fastest::of_clips(self.statistics()?, &skeleton))
    }

    /// One motion for all `lines`, without overlaps or transitions; each line starts at the end of
    /// the previous line. A `target` is followed according to `settings.path`; the caller moves the
    /// motion onto the target.
    ///
    /// # Errors
    /// For an unknown text, an invalid setting, or a result that is not finite.
    ///
    /// # Panics Panics if `lines` is empty or a line has no frame.
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
        let mut path = None;
        if let Some(target) = target.filter(|_| settings.path.method.conditions()) {
            self.must_have_path()?;
            let fps = humanml3d.skeleton().description().fps;
            path = Some(of_path(
                &target.at_origin().course.points,
                fps,
                &self.device,
            ));
        }
        let composed = |network| Composed {
            network,
            segments: segments.clone(),
            path: path.clone(),
            path_guidance_scale: settings.path.path_guidance_scale,
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
            // Without any text, both passes of the guidance are equal.
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
                let (diffusion, on_step) = (&self.diffusion, &mut on_sampled);
                let x = sample_with(diffusion, &mut predict, start, &sampler, keys, on_step)?;
                control.last(x)
            }
        };
        let mut found = self
            .space
            .features(x, humanml3d, |_| "the motion".to_owned())?;
        Ok(found.pop().expect("one motion"))
    }

    fn must_have_path(&self) -> Result<(), Error> {
        if self.plain.has_path() {
            return Ok(());
        }
        Err(Error::usage(
            "option `method tokens`, and a run whose network has no path condition",
            "teach it with recipe `path_adapter`, or use another method (docs/compose.md)",
        ))
    }

    /// The text conditions of the lines, `[lines, text channels, 1]`; lines without a text have
    /// zeros.
    fn text_conditions(&self, lines: &[TimedPrompt]) -> Result<Tensor<3>, Error> {
        let channels = self.text.channels();
        let mut values = Vec::with_capacity(lines.len() * channels);
        for line in lines {
            values.extend(self.text.values_or_zeros(line.text.as_ref())?);
        }
        let data = TensorData::new(values, [lines.len(), channels, 1]);
        Ok(Tensor::from_data(data, &self.device))
    }
}
