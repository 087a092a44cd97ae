//! Arguments of `kinegrad sample`, and of the sampler.

use std::path::PathBuf;

use clap::Args;
use kinegrad_motion::PostProcessProfile;

use super::data::BeatArguments;
use super::values::named;

/// Arguments of `kinegrad sample`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad sample runs/quickstart --out dance
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
    /// Dataset that contains the item [default: the run's dataset]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Item of the dataset that gives the condition; `*` matches any text, and each match is written
    /// to PATH-ID.npy
    #[arg(long, value_name = "ID", conflicts_with = "audio_features")]
    pub item: Option<String>,
    /// Audio features as the condition
    #[arg(long, value_name = "FILE.npz", conflicts_with = "source")]
    pub audio_features: Option<PathBuf>,
    /// Song (mp3, wav, flac, ogg) as the condition
    #[arg(long, value_name = "SONG", conflicts_with_all = ["source", "item", "audio_features"])]
    pub audio: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts
    #[arg(long, value_name = "S", default_value_t = 0.0, requires = "audio")]
    pub start: f64,
    #[command(flatten)]
    pub beats: BeatArguments,
    /// Goal of the root: key frames or a trajectory, and obstacles; several goals are sampled as one
    /// batch
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that generates the ground path first
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Text as the condition, embedded with `--text-encoder`; for runs with
    /// `data.humanml3d.text = "labels"`, one of the training captions
    #[arg(long, value_name = "SENTENCE", conflicts_with = "text_embedding")]
    pub text: Option<String>,
    /// Folder of CLIP ViT-B/32, which embeds the text
    #[arg(long, value_name = "DIR", requires = "text")]
    pub text_encoder: Option<PathBuf>,
    /// Text embedding as the condition: 512 values in tensor KEY of a safetensors file, or row N of
    /// it with KEY:N
    #[arg(long, value_name = "FILE#KEY")]
    pub text_embedding: Option<String>,
    /// Joint positions `[T, J, 3]` in metres that the motion continues, for runs of recipe `flow`
    #[arg(long, value_name = "MOTION.npy")]
    pub history: Option<PathBuf>,
    /// Texts one after another, each with its length, for runs of recipe `flow` or `bpe_motion`
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["text", "text_embedding"])]
    pub prompts: Option<PathBuf>,
    /// Path over the ground that the motion follows (.toml, .csv or .svg)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Method of following the path [default: from the run's config]. Recipe `bpe_motion`: `none`,
    /// `warp`, `override`, `guidance`, `override_guidance`, `tokens`, `tokens_guidance` or
    /// `tokens_warp`; phrases: `override` or `guidance`
    #[arg(long, value_name = "METHOD", requires = "path")]
    pub method: Option<String>,
    /// Metres in a unit of a path that is a drawing
    #[arg(long, value_name = "METRES", requires = "path")]
    pub metres_per_unit: Option<f64>,
    /// Style, for runs with `model.style`: a label, such as `waltz`, or eight numbers separated by
    /// commas [default: none]
    #[arg(long, value_name = "STYLE", allow_hyphen_values = true)]
    pub style: Option<String>,
    /// Phrase to continue: the sample begins with its last frames, a quarter of the training length
    #[arg(long, value_name = "MOTION.npy", conflicts_with = "keep")]
    pub continue_from: Option<PathBuf>,
    /// Frames taken unchanged from `--keep-from`, for example 0..30,90..120 (without 30 and 120)
    #[arg(long, value_name = "FRAMES", requires = "keep_from")]
    pub keep: Option<String>,
    /// Phrase that contains the frames of `--keep`
    #[arg(long, value_name = "MOTION.npy", requires = "keep")]
    pub keep_from: Option<PathBuf>,
    /// Post-processing of phrases: `default`, `ccmotion` (exactly CC-MotionGen's) or `none`
    /// [default: default]
    #[arg(long, value_name = "PROFILE", value_parser = named::<PostProcessProfile>)]
    pub postprocess: Option<PostProcessProfile>,
    /// Lock feet in the BVH file while they stand; the arrays do not change
    #[arg(long)]
    pub lock_feet: bool,
    /// Condition of a system outside of kinegrad
    #[arg(long = "condition", value_name = "NAME=VALUE", hide = true)]
    pub conditions: Vec<String>,
    /// Samples per condition
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub count: usize,
    /// Frames to generate, at most the length of the condition [default: the length of the
    /// condition; for clips without a goal, the training length, or the item's if that is shorter]
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
    /// several, separated by commas [default: from the run's config]
    #[arg(long, value_name = "SCALE", value_delimiter = ',')]
    pub guidance_scale: Vec<f64>,
    /// Guidance scale of the style [default: from the run's config, else `--guidance-scale`]
    #[arg(long, value_name = "SCALE")]
    pub style_guidance_scale: Option<f64>,
    /// Use the trained weights instead of their exponential moving average
    #[arg(long)]
    pub no_ema: bool,
    /// Device to run on [default: from the run's config]
    #[arg(long)]
    pub device: Option<String>,
}
