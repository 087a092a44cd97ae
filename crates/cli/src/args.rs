//! The command line: what can be asked, nothing of how it is done.

use std::path::PathBuf;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Args, Parser, Subcommand};
use kinegrad_data::humanml::SkeletonName;
use kinegrad_motion::sanity::Profile;
use kinegrad_train::Error;
use serde::de::value::Error as ValueError;
use serde::de::{DeserializeOwned, IntoDeserializer};

/// Train and fine-tune motion-generation models.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, max_term_width = 100)]
#[command(after_help = "\
Exit codes:
  0    done
  1    a check or the run failed
  2    bad input: arguments, config, data, checkpoint, a run in use
  130  stopped by Ctrl-C, after writing a checkpoint")]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Train a model from a config file, or continue a run
    Train(TrainArguments),
    /// Draw motion from a trained model
    Sample(SampleArguments),
    /// Make a run of published PyTorch weights
    Import(ImportArguments),
    /// Add the low-rank adapters of a fine-tuned model to its weights
    Merge(MergeArguments),
    /// Check motion files for physical sanity
    Check(CheckArguments),
    /// Measure trained models on held-out phrases, side by side
    Eval(EvalArguments),
    /// Draw a motion file, or the loss curves of a run
    Plot(PlotArguments),
    /// Make and look at datasets
    #[command(subcommand)]
    Data(DataCommand),
    /// Hear what is in songs
    #[command(subcommand)]
    Audio(AudioCommand),
    /// Look at configs
    #[command(subcommand)]
    Config(ConfigCommand),
    /// List the devices this build can run on
    Devices,
}

/// The run goes to RUNS_DIR/NAME: the resolved config, metrics.jsonl, TensorBoard events and
/// checkpoints. Ctrl-C writes a checkpoint before it stops; `--resume` continues bit for bit.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad train configs/quickstart.toml
  kinegrad train configs/phrases.toml --set data.source=phrases --set train.max_steps=100
  kinegrad train configs/phrases.toml --set data.source=phrases --resume")]
pub struct TrainArguments {
    /// The config file
    pub config: PathBuf,
    /// Override a key of the config, for example optim.learning_rate=2e-4
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Name of the run [default: `run.name`, else the config file's name]
    #[arg(long)]
    pub name: Option<String>,
    /// Folder that holds the runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs_dir: PathBuf,
    /// Device to train on, see `kinegrad devices` [default: `run.device`]
    #[arg(long)]
    pub device: Option<String>,
    /// Continue the run from its newest good checkpoint
    #[arg(long)]
    pub resume: bool,
}

/// Writes PATH.npy (post-processed) and PATH.raw.npy (as the model drew it), both `[T, 25]`
/// float32 in the dataset's layout and units; with several samples PATH-000.npy and so on. The
/// condition is a phrase of a dataset, a features.npz, a song, or by default the first held-out
/// phrase of the run's own dataset. Sampler settings default to those of the run's config.
///
/// A run of recipe `gmd_motion` gives joints `[T, J, 3]` in metres as PATH.npy, the features as
/// PATH.features.npy, PATH.bvh in centimetres, and the path of a trajectory run as PATH.path.npy;
/// one of recipe `gmd_trajectory` the ground path
/// `[T, 2]`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad sample runs/quickstart --out dance
  kinegrad sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --goal goal.toml --out walk
  kinegrad sample runs/phrases --phrase C_5_00158 --count 4 --steps 50 --out dance
  kinegrad sample runs/phrases --set sampling.sampler.kind=dpmpp_2m --steps 10 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --start 30 --out dance
  kinegrad sample runs/phrases/checkpoints/step-00000750 --cond features.npz --out dance")]
pub struct SampleArguments {
    /// Folder of a run (its best checkpoint is taken) or of a checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Where to write; `.npy` is added
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Dataset that holds the phrase [default: the run's own]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Phrase whose audio features are the condition; `*` matches any text, and several phrases
    /// give a file each, PATH-ID.npy
    #[arg(long, value_name = "ID", conflicts_with = "cond")]
    pub phrase: Option<String>,
    /// Audio features that are the condition
    #[arg(long, value_name = "FEATURES.npz", conflicts_with = "source")]
    pub cond: Option<PathBuf>,
    /// Song (mp3, wav, flac, ogg) that is the condition; its features are those of the whole song
    #[arg(long, value_name = "SONG", conflicts_with_all = ["source", "phrase", "cond"])]
    pub audio: Option<PathBuf>,
    /// Seconds into the song at which the motion begins
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 0.0,
        requires = "audio"
    )]
    pub start: f64,
    /// Where the root shall be when, and what it shall keep out of; several goals are drawn as one
    /// batch
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that draws the ground path to the goal first
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Text that is the condition: 512 numbers in a file of safetensors, tensor KEY, or row N of it
    /// with KEY:N
    #[arg(long, value_name = "FILE#KEY")]
    pub text_embedding: Option<String>,
    /// Samples per condition
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub count: usize,
    /// Frames to draw, at most those of the condition [default: all of them; of a song, and of a
    /// clip without a goal, as many as the run trained on]
    #[arg(long, value_name = "T")]
    pub frames: Option<usize>,
    #[command(flatten)]
    pub draw: DrawArguments,
    /// Seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// How motion is drawn from a trained model.
#[derive(Debug, Args)]
pub struct DrawArguments {
    /// Override a key of the run's tables `sampling` and `evaluation`, for example
    /// sampling.sampler.kind=dpmpp_2m
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Denoising steps [default: the run's]
    #[arg(long, value_name = "N")]
    pub steps: Option<usize>,
    /// Classifier-free guidance, 1 is none [default: the run's]
    #[arg(long, value_name = "SCALE")]
    pub guidance_scale: Option<f64>,
    /// Draw from the trained weights instead of their moving average
    #[arg(long)]
    pub no_ema: bool,
    /// Device to run on [default: the run's]
    #[arg(long)]
    pub device: Option<String>,
}

/// Reads a file that `torch.save` wrote: one with `model` and `model_avg`, of which the average is
/// taken, or a bare state dict. Sizes are read off the shapes. The result is a run with one
/// checkpoint: to sample, to evaluate, to start a training from (`init.diffusion`).
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad import model000500000.pt --arch gmd_motion --mean Mean_abs_3d.npy --std Std_abs_3d.npy \
--projection rand_proj.npy --out runs/gmd")]
pub struct ImportArguments {
    /// The weights
    #[arg(value_name = "WEIGHTS.pt")]
    pub weights: PathBuf,
    /// What they are of: gmd_motion or gmd_trajectory
    #[arg(long)]
    pub arch: String,
    /// Mean of the training data, one number a feature: all of them, of a trajectory model too
    #[arg(long, value_name = "M.npy")]
    pub mean: Option<PathBuf>,
    /// Standard deviation of the training data
    #[arg(long, value_name = "S.npy")]
    pub std: Option<PathBuf>,
    /// Matrix of the emphasis projection that the model works in
    #[arg(long, value_name = "P.npy")]
    pub projection: Option<PathBuf>,
    /// Frames that the network pads every clip to
    #[arg(long, default_value_t = 224, value_name = "T")]
    pub padded_frames: usize,
    /// Take `model`, the weights of the last step, instead of `model_avg`
    #[arg(long)]
    pub last: bool,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// The result is a run with one checkpoint of plain weights: to sample, to evaluate, to start
/// another training from.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad merge runs/e2e-lora --out runs/e2e-merged")]
pub struct MergeArguments {
    /// Folder of a run (its best checkpoint is taken) or of a checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// PATH is a motion file, or a folder whose motion files are all checked. The `strict` profile
/// needs the training phrases' statistics: give the run (`--run`) or the dataset (`--source`).
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad check dance.npy
  kinegrad check runs/quickstart/samples --profile strict --run runs/quickstart
  kinegrad check dance.npy --json")]
pub struct CheckArguments {
    /// Motion files (.npy, [T, 25]) or folders of them
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Which checks: `document`, CC-MotionGen's five on means over all frames, or `strict`, on every
    /// frame with bounds from the training phrases
    #[arg(long, value_parser = named::<Profile>, default_value = "document")]
    pub profile: Profile,
    /// Run or checkpoint whose training statistics `strict` uses
    #[arg(long, value_name = "RUN", conflicts_with = "source")]
    pub run: Option<PathBuf>,
    /// Dataset whose phrases' statistics `strict` uses, all of them
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Draws samples for the held-out phrases of each run's dataset and prints their metrics beside
/// those of the real phrases; docs/evaluation.md defines them. What is drawn, and how, say the tables
/// `evaluation` and `sampling` of each run's config, or `--set`. Writes eval.json and eval.csv, with
/// evaluation.cond=noise eval-noise.json and eval-noise.csv.
///
/// A run of recipe `gmd_motion` or `gmd_trajectory` is led to goals on the way of held-out clips,
/// and measured by how near it comes; the reports are eval-goals.json and eval-goals.csv.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad eval runs/phrases
  kinegrad eval runs/one runs/two --set evaluation.seeds=4 --out comparison
  kinegrad eval runs/phrases --set evaluation.cond=noise --json
  kinegrad eval runs/gmd_motion --trajectory-run runs/gmd_trajectory --set evaluation.obstacles=2")]
pub struct EvalArguments {
    /// Folders of runs (the best checkpoint of each is taken) or of checkpoints
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that draws the ground paths to the goals first
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    #[command(flatten)]
    pub draw: DrawArguments,
    /// Seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Dataset with the held-out motion, split as the run's config says [default: the run's own]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Folder to write to [default: RUN/reports, for each run its own]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// A motion file is drawn as its path from above, all channels over time, quaternion norm and
/// jerk; a run as its loss curves.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad plot dance.npy --out dance.svg
  kinegrad plot runs/quickstart --out losses.svg")]
pub struct PlotArguments {
    /// A motion file (.npy, [T, 25]) or the folder of a run
    #[arg(value_name = "MOTION.npy|RUN")]
    pub input: PathBuf,
    /// The picture to write
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    pub out: PathBuf,
}

#[derive(Debug, Subcommand)]
pub enum DataCommand {
    /// Make a dataset of synthetic phrases: smooth motion driven by a beat that its audio
    /// features carry; or of synthetic walks in the layout of HumanML3D
    Synth(SynthArguments),
    /// Make a dataset from motion captures and songs, as a plan says
    Prepare(PrepareArguments),
    /// Count and measure a dataset, and list the problems found
    Inspect(InspectArguments),
}

/// Reads BVH, C3D, npy and npz captures and mp3, wav, flac and ogg songs, cuts phrases and writes
/// them with a manifest into a folder or bucket; docs/dataset.md describes plans. Stopped, it goes
/// on with what is left when it is run again. Exit code 1 if nothing could be made of a take.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad data prepare configs/prepare.toml --out gs://bucket/dances")]
pub struct PrepareArguments {
    /// The plan
    #[arg(value_name = "PLAN.toml")]
    pub plan: PathBuf,
    /// Where to write: a folder, gs:// or s3:// [default: the plan's `output`]
    #[arg(long, value_name = "URI")]
    pub out: Option<String>,
    /// Make every take again, whatever has been made before
    #[arg(long)]
    pub again: bool,
    /// Remove phrases of takes that the plan no longer has
    #[arg(long)]
    pub prune: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Subcommand)]
pub enum AudioCommand {
    /// Write the audio features of songs, as the dataset stores them
    Features(FeaturesArguments),
}

/// Writes DIR/NAME/features.npz for each song: mel, chroma, mfcc, rms, spectral_centroid and
/// onset_strength at 30 frames per second, and beside them tempo and beat_times.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad audio features songs/*.mp3 --out features --plot")]
pub struct FeaturesArguments {
    /// Songs (mp3, wav, flac, ogg)
    #[arg(required = true, value_name = "SONG")]
    pub songs: Vec<PathBuf>,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Draw them as well, with the beats, into DIR/NAME/features.png
    #[arg(long)]
    pub plot: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad data synth --out phrases --phrases 64 --frames 120 --seed 0")]
pub struct SynthArguments {
    /// Folder to write; it must not exist or be empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write walks in the layout of HumanML3D instead of phrases
    #[arg(long)]
    pub walks: bool,
    /// Number of phrases or walks
    #[arg(long, default_value_t = 64, value_name = "N")]
    pub phrases: usize,
    /// Frames of each: 30 a second of a phrase, 20 of a walk
    #[arg(long, default_value_t = 120, value_name = "T")]
    pub frames: usize,
    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad data inspect phrases
  kinegrad data inspect gs://bucket/dances --where 'tempo > 100 and split = train' --plot tempo.png")]
pub struct InspectArguments {
    /// The dataset: a folder, file://, gs://, s3://, http:// or https:// URI; endpoint and
    /// credentials come from the environment
    #[arg(value_name = "URI")]
    pub source: String,
    /// List the phrases of the manifest that meet a condition on its columns, as `tempo > 100` or
    /// `split = train and not flags like *no_audio*`, without reading them
    #[arg(long = "where", value_name = "CONDITION")]
    pub condition: Option<String>,
    /// Draw tempo, length and beats of the manifest's phrases, of those that meet the condition
    #[arg(long, value_name = "FILE.png|FILE.svg")]
    pub plot: Option<PathBuf>,
    /// The dataset is one in the layout of HumanML3D
    #[arg(long, conflicts_with_all = ["condition", "plot"])]
    pub humanml3d: bool,
    /// Whose joints it has: humanml3d or kit
    #[arg(long, value_parser = named::<SkeletonName>, default_value = "humanml3d", requires = "humanml3d")]
    pub skeleton: SkeletonName,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Print a config with every default filled in, and the model's number of parameters
    Show(ShowArguments),
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad config show configs/phrases.toml --set model.size=base")]
pub struct ShowArguments {
    /// The config file
    pub config: PathBuf,
    /// Override a key of the config
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

/// Options that `kinegrad eval` had, and the keys that say the same.
const REPLACED: [(&str, &str); 10] = [
    ("--seeds", "seeds=N"),
    ("--phrases", "phrases=N"),
    ("--cond", "cond=noise"),
    ("--goals", "goals=N"),
    ("--keyframes", "keyframes=N"),
    ("--obstacles", "obstacles=N"),
    ("--evaluator", "evaluator.weights=FILE"),
    ("--evaluator-mean", "evaluator.mean=FILE"),
    ("--evaluator-std", "evaluator.std=FILE"),
    ("--word-vectors", "evaluator.word_vectors=FILE"),
];

/// What to say of an option that has become a key of the config.
pub fn replaced(command: &str, error: &clap::Error) -> Option<Error> {
    let found = error.get(ContextKind::InvalidArg);
    let (ErrorKind::UnknownArgument, "eval", Some(ContextValue::String(found))) =
        (error.kind(), command, found)
    else {
        return None;
    };
    let (option, key) = REPLACED.iter().find(|(option, _)| option == found)?;
    let message = format!("`{option}` is no option any more: it is a key of the config");
    Some(Error::usage(
        message,
        format!("use `--set evaluation.{key}`"),
    ))
}

/// A choice of the config by its name there.
fn named<T: DeserializeOwned>(name: &str) -> Result<T, ValueError> {
    T::deserialize(name.into_deserializer())
}
