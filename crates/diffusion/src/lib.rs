//! The processes from noise to motion: noise schedules, training targets and samplers.
//!
//! ```text
//! DiffusionConfig --> NoiseSchedule (tables, f64) --> GaussianDiffusion (forward process, targets)
//!
//! Denoiser (any network) -- guided (guidance_scale) --> Predict --> ddim, ddpm, dpmpp_2m, heun
//!                           steered (goals, imputation) /
//!                           rollout (gradients)        /
//! ```
//!
//! [`flow`] is a process with a straight path from noise to data. Its solvers follow the path's
//! velocity and use the same [`Denoiser`]s and guidance.
//!
//! A network implements [`Denoiser`]; the crate does not depend on the meaning of channels. Noise
//! is an argument or comes from a [`kinegrad_random::Key`].
//!
//! Timesteps are host integers `0..num_train_timesteps`; 0 is the least noisy. The source's code
//! does the same (CC-MotionGen, section 5.3; docs/sources.md, section 1.2); the source's formulas
//! count from 1.
//!
//! Symbols of the papers:
//!
//! | paper | name |
//! |---|---|
//! | x_0 | `x_start`; predicted: `pred_original_sample` |
//! | x_t, x_{t-1} | `x_t`, `prev_sample` |
//! | epsilon | `noise`; predicted: [`Prediction::epsilon`] |
//! | beta_t, alpha_t = 1 - beta_t | `betas`, `alphas` |
//! | alpha-bar_t = alpha_0 ... alpha_t | `alphas_cumprod` |
//! | T, number of sampling steps N | `num_train_timesteps`, `num_inference_steps` |

pub mod config;
pub mod denoiser;
mod error;
pub mod flow;
pub mod loss;
mod ode;
mod per_sample;
pub mod process;
pub mod rollout;
pub mod sampler;
pub mod schedule;
pub mod steering;
mod time;

pub use config::{BetaSchedule, DiffusionConfig, LossType, PredictionType};
pub use denoiser::{Denoiser, GuidanceScales, guided};
pub use error::Error;
pub use flow::{FlowPrediction, Flowed, sample_flow};
pub use loss::diffusion_loss;
pub use process::GaussianDiffusion;
pub use rollout::{Rollout, RolloutMode, RolloutOutput, Trace, rollout_timesteps};
pub use sampler::{
    ClipRange, Ddim, Ddpm, Dopri5, FinalAlpha, FixedNoise, Imputation, NoiseKeys, OnStep, Predict,
    Prediction, SamplerConfig, SamplerKind, Space, Steered, TimestepPath, TimestepSpacing,
    Timesteps, VarianceType, ddim, ddim_step, ddpm, ddpm_step, dpmpp_2m, heun, must_suit,
    must_suit_flow, noise_of_parts, sample, sample_with, timesteps,
};
pub use schedule::{NoiseSchedule, OutputShares};
pub use steering::{Guidance, Networks, Objective, Steering, steered_prediction, steered_sample};
pub use time::Time;
