//! The reference's toy denoiser, and the inputs of single steps.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    BetaSchedule, ClipRange, Ddpm, Denoiser, DiffusionConfig, GaussianDiffusion, Networks,
    PredictionType, Steering, Time, ddpm_step, steered_prediction,
};
use kinegrad_gmd::network::Backbone;
use kinegrad_gmd::network::GmdUnetConfig;
use kinegrad_gmd::network::TextDenoiser;
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_tests::golden::{Golden, GoldenTensors, Reference, ReferenceTensors, wide};
use kinegrad_tests::{gmd, weights};
use kinegrad_train::clips::FeatureSpace;

/// The process of the published models with this prediction type.
pub fn process(prediction_type: PredictionType) -> GaussianDiffusion {
    GaussianDiffusion::new(&DiffusionConfig {
        beta_schedule: BetaSchedule::Cosine,
        beta_min: 0.0,
        beta_max: 0.999,
        prediction_type,
        ..DiffusionConfig::default()
    })
    .expect("a valid process")
}

/// `s tanh(W x + v t / 1000)` of every frame.
pub struct Toy {
    w: Tensor<3>,
    v: Tensor<3>,
    s: f64,
}

impl Toy {
    fn read(golden: &Golden, prefix: &str, device: &Device) -> Self {
        let w = golden.tensor::<2>(&format!("{prefix}W"), device);
        let v = golden.tensor::<1>(&format!("{prefix}v"), device);
        Self {
            w: w.unsqueeze(),
            v: v.unsqueeze::<2>().unsqueeze_dim(2),
            s: golden.get(&format!("{prefix}s")).scalar(),
        }
    }
}

impl Denoiser for Toy {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], _: &Tensor<3>) -> Tensor<3> {
        let t = time[0].0 / 1000.0;
        (self.w.clone().matmul(x_t) + self.v.clone() * t).tanh() * self.s
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.clone()
    }
}

/// The result of a step.
pub struct Step {
    /// The less noisy motion.
    pub prev_sample: Tensor<3>,
    /// The predicted clean motion: that of a network that predicts clean motion; with the known
    /// values in it if the network predicts noise.
    pub pred_original_sample: Tensor<3>,
    /// Set if the step was guided.
    pub scaled_gradient: Option<Tensor<3>>,
}

/// A toy denoiser on both devices and its inputs.
pub struct Bench<'a> {
    pub golden: &'a Golden,
    pub device: Device,
    pub diffusion: GaussianDiffusion,
    tracked: Toy,
    plain: Toy,
    clip: ClipRange,
}

impl<'a> Bench<'a> {
    /// The denoiser under `prefix`; the predicted motion of an epsilon denoiser is clamped.
    pub fn new(golden: &'a Golden, prefix: &str, prediction_type: PredictionType) -> Self {
        let device = Device::flex();
        Self {
            tracked: Toy::read(golden, prefix, &device.clone().autodiff()),
            plain: Toy::read(golden, prefix, &device),
            diffusion: process(prediction_type),
            clip: match prediction_type {
                PredictionType::Sample => ClipRange::None,
                _ => ClipRange::Symmetric(6.0),
            },
            golden,
            device,
        }
    }

    /// A tensor of the file.
    pub fn input(&self, name: &str) -> Tensor<3> {
        self.golden.get(name).flat().tensor(&self.device)
    }

    /// The timesteps of the leading axis of the outputs.
    pub fn timesteps(&self) -> Vec<usize> {
        self.golden.get("in.timesteps").indices()
    }

    /// Part `index` of the leading axis.
    pub fn part(&self, name: &str, index: usize) -> Reference {
        self.golden.get(name).part(index).flat()
    }

    /// One step down.
    pub fn step(
        &self,
        x_t: Tensor<3>,
        timestep: usize,
        noise: Option<Tensor<3>>,
        imputation_noise: Option<Tensor<3>>,
        steering: &Steering<'_>,
    ) -> Step {
        let batch = x_t.dims()[0];
        let (now, next) = (vec![timestep; batch], vec![timestep.checked_sub(1); batch]);
        let networks = Networks {
            tracked: &self.tracked,
            plain: &self.plain,
        };
        let prediction = steered_prediction(
            &self.diffusion,
            &networks,
            x_t.clone(),
            &Time::of(&now),
            &x_t,
            1.0.into(),
            &self.clip,
            steering.clone(),
        )
        .expect("sizes fit");
        // No noise is added at timestep 0.
        let noise = noise.filter(|_| timestep > 0);
        let diffusion = &self.diffusion;
        let (noises, ddpm) = ([noise, imputation_noise], Ddpm::default());
        let prev_sample = ddpm_step(diffusion, &prediction, &now, &next, noises, &ddpm);
        let steered = prediction.steered.expect("a steered prediction");
        let of_motion = diffusion.config.prediction_type == PredictionType::Sample;
        Step {
            prev_sample,
            pred_original_sample: match &steered.imputation {
                Some(known) if !of_motion => known.put_into(prediction.x_start),
                _ => prediction.x_start,
            },
            scaled_gradient: steered.scaled_gradient,
        }
    }
}

/// The first `channels` statistics of a file, and its projection if the network has one.
pub fn space(golden: &Golden, channels: usize, projected: bool, device: &Device) -> FeatureSpace {
    let numbers = |name: &str| golden.get(name).values[..channels].to_vec();
    let projection = projected.then(|| {
        let matrix = golden.get("in.P").f32s();
        let projection = EmphasisProjection::from_matrix(&matrix, channels, 10.0, &[0, 1, 2])
            .expect("a projection");
        golden.compare_relative("in.P_inv", &wide(projection.inverse()), 1e-3);
        projection
    });
    let (mean, std) = (numbers("in.mean"), numbers("in.std"));
    FeatureSpace::new(&mean, &std, projection.as_ref(), device)
}

/// The complete model with the weights under `prefix`, over clips padded to `padded_frames`.
pub fn whole_model(
    golden: &Golden,
    prefix: &str,
    padded_frames: usize,
    device: &Device,
) -> TextDenoiser {
    let (unet, channels, _) = gmd::unet(golden, &format!("{prefix}unet."));
    let backbone = Backbone::GmdUnet(GmdUnetConfig {
        padded_frames,
        ..unet
    });
    let init = Initializer::new(0, device);
    let network = TextDenoiser::new(&backbone, channels, &init).expect("a network");
    parameters::load(network, weights(golden, prefix)).expect("the weights fit")
}

/// The timesteps of a file's samples, noisiest first.
pub fn kept_timesteps(golden: &Golden) -> Vec<usize> {
    let mut kept = golden.get("in.timesteps").indices();
    kept.reverse();
    kept
}

/// Noise `[steps, batch, channels, 1, frames]` of a file, a tensor for each step.
pub fn noise_of_steps(golden: &Golden, name: &str, device: &Device) -> Vec<Tensor<3>> {
    let noise = golden.get(name);
    let steps = 0..noise.shape[0];
    steps
        .map(|step| noise.part(step).flat().tensor(device))
        .collect()
}
