//! Arguments of `kinegrad sample`, and of the sampler.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::PostProcessProfile;
use kinegrad_train::sampling::SelectBy;

use super::values::named;
use crate::conditions::ConditionArguments;

/// Arguments of `kinegrad sample`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad sample runs/quickstart --out dance
  kinegrad sample runs/quickstart --best-of 8 --select-by checks,beat --out best
  kinegrad sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --goal goal.toml --out walk
  kinegrad sample runs/phrases --item C_5_00158 --count 4 --steps 50 --out dance
  kinegrad sample runs/phrases --set sampling.sampler.kind=dpmpp_2m --steps 10 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --start 30 --frames 120 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --start 33 --continue-from dance.npy --out more
  kinegrad sample runs/phrases --keep 0..30,90..120 --keep-from dance.npy --out between
  kinegrad sample runs/phrases/checkpoints/step-00000750 --audio-features features.npz --out dance
  kinegrad sample runs/flow --history walk.npy --text \"a person walks\" --seconds 20 --out on
  kinegrad sample runs/bpe --prompts prompts.toml --path path.toml --method override --out walk")]
pub struct SampleArguments {
    /// Run (its best checkpoint is used) or checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Output path without extension
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub conditions: ConditionArguments,
    /// Post-processing of phrases: `default`, `ccmotion` (exactly CC-MotionGen's) or `none`
    /// [default: the table `evaluation.postprocess`]
    #[arg(long, value_name = "PROFILE", value_parser = named::<PostProcessProfile>)]
    pub postprocess: Option<PostProcessProfile>,
    /// Lock standing feet in the BVH file; the arrays do not change
    #[arg(long)]
    pub lock_feet: bool,
    /// Write motion that is far out of the bounds of training under its usual name, and exit with 0
    #[arg(long)]
    pub allow_unusable: bool,
    /// Generate N samples of each condition and keep the best
    #[arg(long, value_name = "N", conflicts_with = "count")]
    pub best_of: Option<usize>,
    /// What `--best-of` compares, the first measure first: `checks`, `beat` (of phrases), `goal` (or
    /// path), `skating` (of bodies), `text` (of clips, by `evaluation.evaluator`)
    #[arg(
        long,
        value_name = "MEASURES",
        value_parser = named::<SelectBy>,
        value_delimiter = ',',
        default_value = "checks",
        requires = "best_of"
    )]
    pub select_by: Vec<SelectBy>,
    /// Samples per condition
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub count: usize,
    /// Frames to generate, at most the length of the condition [default: the length of the
    /// condition; for clips without a goal, the shorter of training length and item length]
    #[arg(long, value_name = "T")]
    pub frames: Option<usize>,
    /// Seconds to generate, instead of `--frames`
    #[arg(long, value_name = "S", conflicts_with = "frames")]
    pub seconds: Option<f64>,
    #[command(flatten)]
    pub sampler: SamplerArguments,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Print one JSON object with the files and the record of each sample
    #[arg(long)]
    pub json: bool,
}

/// Sampling options shared by `sample` and `eval`.
#[derive(Clone, Debug, Args)]
pub struct SamplerArguments {
    /// Override a key of the run's `sampling` or `evaluation` table, for example
    /// sampling.sampler.kind=dpmpp_2m
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Number of denoising steps [default: from the run's config]
    #[arg(long, value_name = "N")]
    pub steps: Option<usize>,
    /// Classifier-free guidance scale; 1 disables guidance; `eval --audio-ablation` compares
    /// several scales, separated by commas [default: from the run's config]
    #[arg(long, value_name = "SCALE", value_delimiter = ',')]
    pub guidance_scale: Vec<f64>,
    /// Guidance scale of the style [default: from the run's config, else `--guidance-scale`]
    #[arg(long, value_name = "SCALE")]
    pub style_guidance_scale: Option<f64>,
    /// Use the trained weights instead of their exponential moving average
    #[arg(long)]
    pub no_ema: bool,
    /// Device to run on [default: KINEGRAD_DEVICE, else from the run's config]
    #[arg(long)]
    pub device: Option<String>,
}
