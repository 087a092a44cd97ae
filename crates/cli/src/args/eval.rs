//! Arguments of `kinegrad eval` and `kinegrad check`.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::Profile;

use super::reading::BvhArguments;
use super::sample::SamplerArguments;
use super::values::named;

/// Arguments of `kinegrad check`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad check dance.npy
  kinegrad check runs/quickstart/samples --profile strict --run runs/quickstart
  kinegrad check capture.bvh --units cm
  kinegrad check dance.npy --json")]
pub struct CheckArguments {
    /// Motion files (.npy, .bvh), or folders of them
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Checks: `strict`, on every frame, with bounds from training motion, or from captured people
    /// without --run and --source; or `ccmotion`, CC-MotionGen's five on means over all frames
    #[arg(long, value_parser = named::<Profile>, default_value = "strict")]
    pub profile: Profile,
    /// TOML file with bounds for `ccmotion`: the keys of `evaluation.thresholds`
    #[arg(long, value_name = "FILE")]
    pub thresholds: Option<PathBuf>,
    /// Run or checkpoint with the training statistics for `strict`
    #[arg(long, value_name = "RUN", conflicts_with = "source")]
    pub run: Option<PathBuf>,
    /// Dataset that gives the statistics for `strict`
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Also check NAME.raw.npy, the model output, beside each NAME.npy
    #[arg(long)]
    pub raw: bool,
    #[command(flatten)]
    pub bvh: BvhArguments,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `kinegrad eval`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad eval runs/phrases
  kinegrad eval runs/one runs/two --set evaluation.seeds=4 --out comparison
  kinegrad eval runs/phrases --quick
  kinegrad eval runs/phrases --num-samples 100 --num-frames 120 --steps 20
  kinegrad eval runs/phrases --songs music
  kinegrad eval runs/phrases --set evaluation.cond=noise --json
  kinegrad eval runs/phrases --audio-ablation --guidance-scale 1,1.5,2,3,4
  kinegrad eval runs/gmd_motion --trajectory-run runs/gmd_trajectory --set evaluation.obstacles=2")]
pub struct EvalArguments {
    /// Runs (the best checkpoint of each is used) or checkpoints
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that generates the ground paths first
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Sample few phrases in few steps: 20 samples of 10 steps, unless `--num-samples` or `--steps`
    /// is given
    #[arg(long, conflicts_with = "audio_ablation")]
    pub quick: bool,
    /// Most samples in total [default: `evaluation.seeds` of each phrase]
    #[arg(long, value_name = "N")]
    pub num_samples: Option<usize>,
    /// Most frames of a sample [default: the phrase; with `--songs`, the training length]
    #[arg(long, value_name = "T")]
    pub num_frames: Option<usize>,
    /// Folder of songs without motion (.flac, .mp3, .ogg, .wav), or one song, instead of held-out
    /// phrases: checks, beat measures and diversity, but no distances to real motion
    #[arg(long, value_name = "PATH")]
    pub songs: Option<PathBuf>,
    /// Measure the dependence on the audio condition
    #[arg(long)]
    pub audio_ablation: bool,
    #[command(flatten)]
    pub sampler: SamplerArguments,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Dataset with the held-out motion, split as in the run's config [default: the run's dataset]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Print all measures
    #[arg(long)]
    pub all: bool,
    /// Print JSON
    #[arg(long, conflicts_with = "all")]
    pub json: bool,
    /// Output folder [default: RUN/reports of each run, in files named by the settings]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace a report of other settings in DIR
    #[arg(long)]
    pub overwrite: bool,
}

/// Samples of `--quick`.
const QUICK_SAMPLES: usize = 20;

/// Steps of `--quick`.
const QUICK_STEPS: usize = 10;

impl EvalArguments {
    /// With the numbers of `--quick`.
    #[must_use]
    pub fn with_quick(mut self) -> Self {
        if self.quick {
            self.num_samples.get_or_insert(QUICK_SAMPLES);
            self.sampler.steps.get_or_insert(QUICK_STEPS);
        }
        self
    }
}
