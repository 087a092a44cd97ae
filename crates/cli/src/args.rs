//! Command-line arguments, parsed with clap. The commands themselves are in `commands`.

mod config;
mod data;
#[cfg(test)]
mod documented_tests;
mod matching;
mod reading;
mod reports;
mod text;
mod train;
mod values;
mod verbosity;
mod view;
mod warp;

use std::any::TypeId;
use std::path::PathBuf;

use clap::{ArgAction, Args, Command as Line, CommandFactory, FromArgMatches, Parser, Subcommand};
use kinegrad_capture::prepare::Units;
use kinegrad_motion::{PostProcessProfile, Profile};

pub use config::{CompletionsArguments, ExplainArguments, InitArguments, ManArguments};
pub use data::{
    AudioCommand, BeatArguments, DataCommand, FeaturesArguments, InspectArguments,
    PrepareArguments, SynthArguments,
};

pub use matching::MatchArguments;
pub use reading::ReadingArguments;
pub use reports::{PlotArguments, ReportArguments, RunsArguments};
pub use text::{EmbedArguments, TextCommand};
pub use train::{DEFAULT_CONFIG, TrainArguments};
pub use verbosity::VerbosityArgs;
pub use view::ViewArguments;
pub use warp::WarpArguments;

use values::{named, number};

/// Train and fine-tune motion-generation models.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, max_term_width = 100)]
#[command(after_help = "\
Exit codes:
  0    success
  1    a check failed, or the run failed
  2    invalid input: arguments, config, data, checkpoint, or a run that is in use
  130  interrupted by Ctrl-C, after writing a checkpoint")]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub verbosity: VerbosityArgs,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a config to start from
    Init(InitArguments),
    /// Train a model from a config file, or resume a run
    Train(TrainArguments),
    /// Generate motion with a trained model
    Sample(Box<SampleArguments>),
    /// Make new motion from example motions, without training
    Match(Box<MatchArguments>),
    /// Move a motion onto a path, without training
    Warp(WarpArguments),
    /// Convert published PyTorch weights to a run
    Import(ImportArguments),
    /// Merge the LoRA adapters of a fine-tuned model into its weights
    Merge(MergeArguments),
    /// Check motion files for physical sanity
    Check(CheckArguments),
    /// Evaluate trained models on held-out data, side by side
    Eval(EvalArguments),
    /// Plot a motion file, or the loss curves of a run
    Plot(PlotArguments),
    /// Gather everything about a run in one page
    Report(ReportArguments),
    /// List runs
    Runs(RunsArguments),
    /// Write a page on which motion is looked at from all sides, with its music
    View(ViewArguments),
    /// Create and inspect datasets
    #[command(subcommand)]
    Data(DataCommand),
    /// Extract audio features from songs
    #[command(subcommand)]
    Audio(AudioCommand),
    /// Embed texts with CLIP
    #[command(subcommand)]
    Text(TextCommand),
    /// Inspect configs
    #[command(subcommand)]
    Config(ConfigCommand),
    /// List the devices that this build supports
    Devices,
    /// Print a completion script for a shell
    Completions(CompletionsArguments),
    /// Write manual pages
    Man(ManArguments),
}

/// Phrase models write PATH.npy (post-processed) and PATH.raw.npy (the raw model output), both
/// `[T, 25]` float32 in the dataset's layout and units; with several samples PATH-000.npy and so
/// on. The audio condition is a phrase of a dataset, a features.npz, a song, or by default the
/// first held-out phrase of the run's own dataset. Sampler settings default to the run's config.
///
/// A song is danced to from `--start` to its end. Motion longer than the phrases that the run was
/// trained on is drawn in windows of that length, each overlapping the next by a third, that agree
/// after every denoising step; the network sees 8 of them at a time, whatever the song's length.
///
/// Runs of recipe `gmd_motion` write joint positions `[T, J, 3]` in metres to PATH.npy, joint
/// features to PATH.features.npy and a BVH file in centimetres to PATH.bvh; with
/// `--trajectory-run`, also the generated ground path to PATH.path.npy. Runs of recipe
/// `gmd_trajectory` write the ground path `[T, 2]` to PATH.npy.
///
/// Beside each sample, PATH.json records how it was made: version, run, checkpoint, seed, sampler
/// settings and condition.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad sample runs/quickstart --out dance
  kinegrad sample runs/gmd_motion --trajectory-run runs/gmd_trajectory --goal goal.toml --out walk
  kinegrad sample runs/phrases --item C_5_00158 --count 4 --steps 50 --out dance
  kinegrad sample runs/phrases --set sampling.sampler.kind=dpmpp_2m --steps 10 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --start 30 --frames 120 --out dance
  kinegrad sample runs/phrases --audio song.mp3 --start 33 --continue-from dance.npy --out more
  kinegrad sample runs/phrases --keep 0..30,90..120 --keep-from dance.npy --out between
  kinegrad sample runs/phrases/checkpoints/step-00000750 --audio-features features.npz --out dance
  kinegrad sample runs/flow --history walk.npy --text \"a person walks\" --seconds 20 --out on
  kinegrad sample runs/bpe --prompts plan.toml --path path.toml --method override --out walk")]
pub struct SampleArguments {
    /// Folder of a run (its best checkpoint is used) or of a checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Output path without extension; `.npy` is appended
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Replace files that exist
    #[arg(long)]
    pub overwrite: bool,
    /// Dataset that contains the phrase [default: the run's dataset]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Phrase whose audio features are the condition; `*` matches any text, and each matching
    /// phrase is written to PATH-ID.npy
    #[arg(long, value_name = "ID", conflicts_with = "audio_features")]
    pub item: Option<String>,
    /// Audio features to use as the condition
    #[arg(long, value_name = "FILE.npz", conflicts_with = "source")]
    pub audio_features: Option<PathBuf>,
    /// Song (mp3, wav, flac, ogg) to use as the condition; features are computed over the whole
    /// song
    #[arg(long, value_name = "SONG", conflicts_with_all = ["source", "item", "audio_features"])]
    pub audio: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 0.0,
        requires = "audio"
    )]
    pub start: f64,
    #[command(flatten)]
    pub beats: BeatArguments,
    /// Goal for position control: keyframes or a trajectory for the root, and obstacles to avoid;
    /// several goals are sampled as one batch
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that generates the ground path in a first stage
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Text to use as the condition, embedded with `--text-encoder`; for runs with
    /// `data.humanml3d.text = "labels"` one of the captions that they were trained on
    #[arg(long, value_name = "SENTENCE", conflicts_with = "text_embedding")]
    pub text: Option<String>,
    /// Folder with CLIP ViT-B/32, which embeds the text
    #[arg(long, value_name = "DIR", requires = "text")]
    pub text_encoder: Option<PathBuf>,
    /// Text embedding to use as the condition: 512 values in tensor KEY of a safetensors file, or
    /// row N of it with KEY:N
    #[arg(long, value_name = "FILE#KEY")]
    pub text_embedding: Option<String>,
    /// Joints that the motion goes on from, `[T, J, 3]` in metres, for runs of recipe `flow`; the
    /// frames before the last are what led there
    #[arg(long, value_name = "MOTION.npy")]
    pub history: Option<PathBuf>,
    /// Texts one after another, each with its length, for runs of recipe `flow` or `bpe_motion`
    #[arg(
        long,
        value_name = "PROMPTS.toml",
        conflicts_with_all = ["text", "text_embedding"]
    )]
    pub prompts: Option<PathBuf>,
    /// Path over the ground that the motion follows (.toml, .csv or .svg)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// How the motion follows the path: `none`, `warp`, `override`, `guidance`, `override_guidance`,
    /// `tokens`, `tokens_guidance` or `tokens_warp` in runs of recipe `bpe_motion`; `override` or `guidance` in runs on
    /// phrases [default: from the run's config]
    #[arg(long, value_name = "METHOD", requires = "path")]
    pub method: Option<String>,
    /// Metres of a unit of a path that is a drawing
    #[arg(long, value_name = "METRES", requires = "path")]
    pub metres_per_unit: Option<f64>,
    /// Style of the sample, for runs with `model.style`: a label, such as `waltz`, or eight numbers
    /// with commas between them [default: none]
    #[arg(long, value_name = "STYLE", allow_hyphen_values = true)]
    pub style: Option<String>,
    /// Phrase to go on from: the sample begins with its last frames, a quarter of the length that
    /// the run was trained on
    #[arg(long, value_name = "MOTION.npy", conflicts_with = "keep")]
    pub continue_from: Option<PathBuf>,
    /// Frames that the sample takes from another phrase as they are, at the same places, for example
    /// 0..30,90..120 (without 30 and 120); the others are drawn to fit
    #[arg(long, value_name = "FRAMES", requires = "keep_from")]
    pub keep: Option<String>,
    /// Phrase that the frames of `--keep` are taken from
    #[arg(long, value_name = "MOTION.npy", requires = "keep")]
    pub keep_from: Option<PathBuf>,
    /// Repairs of the generated phrase: `default`, `ccmotion` (CC-MotionGen's to the letter) or
    /// `none` [default: default]
    #[arg(long, value_name = "PROFILE", value_parser = named::<PostProcessProfile>)]
    pub postprocess: Option<PostProcessProfile>,
    /// Hold feet where they stand in the BVH file, as drawn ones slide; the arrays stay as drawn
    #[arg(long)]
    pub lock_feet: bool,
    /// Samples per condition
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub count: usize,
    /// Frames to generate, at most the length of the condition [default: its full length, which of a
    /// song is all that is left of it; for a clip without a goal, the length that the run was
    /// trained on, or with `--item` the clip's own if that is shorter]
    #[arg(long, value_name = "T")]
    pub frames: Option<usize>,
    /// Seconds to generate, in the place of `--frames`
    #[arg(long, value_name = "S", conflicts_with = "frames")]
    pub seconds: Option<f64>,
    #[command(flatten)]
    pub draw: DrawArguments,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Print one JSON object: the files and the record of each sample
    #[arg(long)]
    pub json: bool,
}

/// Sampling options shared by `sample` and `eval`.
#[derive(Clone, Debug, Args)]
pub struct DrawArguments {
    /// Override a key of the run's `sampling` or `evaluation` table, for example
    /// sampling.sampler.kind=dpmpp_2m
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Number of denoising steps [default: from the run's config]
    #[arg(long, value_name = "N")]
    pub steps: Option<usize>,
    /// Classifier-free guidance scale; 1 disables guidance; `eval --audio-ablation` compares several,
    /// with commas between them [default: from the run's config]
    #[arg(long, value_name = "SCALE", value_delimiter = ',')]
    pub guidance_scale: Vec<f64>,
    /// Guidance scale of the style [default: from the run's config, else that of all conditions]
    #[arg(long, value_name = "SCALE")]
    pub style_guidance_scale: Option<f64>,
    /// Use the trained weights instead of their exponential moving average
    #[arg(long)]
    pub no_ema: bool,
    /// Device to run on [default: from the run's config]
    #[arg(long)]
    pub device: Option<String>,
}

/// Reads a file written by `torch.save`: either a bare state dict, or a dict with `model` and
/// `model_avg`, of which `model_avg` is used. Network sizes are inferred from the tensor shapes.
/// The result is a run with one checkpoint that can be sampled, evaluated and fine-tuned
/// (`init.diffusion`).
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad import model000500000.pt --arch gmd_motion --mean Mean_abs_3d.npy --std Std_abs_3d.npy \
--projection rand_proj.npy --out runs/gmd")]
pub struct ImportArguments {
    /// The PyTorch file
    #[arg(value_name = "WEIGHTS.pt")]
    pub weights: PathBuf,
    /// Model architecture: gmd_motion, gmd_trajectory, mdm or flowmdm
    #[arg(long)]
    pub arch: String,
    /// Mean of the training data, one value per feature; all features are required, for a
    /// trajectory model too
    #[arg(long, value_name = "M.npy")]
    pub mean: Option<PathBuf>,
    /// Standard deviation of the training data
    #[arg(long, value_name = "S.npy")]
    pub std: Option<PathBuf>,
    /// Emphasis projection matrix that the model was trained with
    #[arg(long, value_name = "P.npy")]
    pub projection: Option<PathBuf>,
    /// Length in frames that the network pads every clip to
    #[arg(long, default_value_t = 224, value_name = "T")]
    pub padded_frames: usize,
    /// Use `model`, the weights of the last step, instead of `model_avg`
    #[arg(long)]
    pub last: bool,
    /// Set a key of the new run's config, for example sampling.steering.guidance.norm=mse
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// The result is a run with one checkpoint of plain weights that can be sampled, evaluated and
/// fine-tuned.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad merge runs/e2e-lora --out runs/e2e-merged")]
pub struct MergeArguments {
    /// Folder of a run (its best checkpoint is used) or of a checkpoint
    #[arg(value_name = "RUN_OR_CHECKPOINT")]
    pub run: PathBuf,
    /// Folder to write; a new or an empty one
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// PATH is a motion file, or a folder that is searched for motion files, each sample once: without
/// its raw model output (PATH.raw.npy, see `--raw`), and without joint features and ground path
/// (PATH.features.npy, PATH.path.npy) beside joint positions. The representation is
/// recognised from the array: phrases `[T, 25]`, joint features `[T, 263]` or `[T, 251]`, joint
/// positions `[T, 22, 3]` or `[T, 21, 3]`, or ground paths `[T, 2]`. BVH files and joints of other
/// skeletons cannot be checked; `kinegrad view` and `kinegrad plot` show them. The `strict` profile compares with statistics of training motion: pass
/// the run (`--run`) or the dataset (`--source`).
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad check dance.npy
  kinegrad check runs/quickstart/samples --profile strict --run runs/quickstart
  kinegrad check dance.npy --json")]
pub struct CheckArguments {
    /// Motion files (.npy), or folders of them: phrases `[T, 25]`, joint features `[T, 263]` or
    /// `[T, 251]`, joint positions `[T, 22, 3]` or `[T, 21, 3]`, or ground paths `[T, 2]`
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Which checks to run: `ccmotion`, for phrases CC-MotionGen's five checks on means over all
    /// frames of the channels, or `strict`, with bounds from training motion, for phrases on every
    /// frame and on how positions and rotations move
    #[arg(long, value_parser = named::<Profile>, default_value = "ccmotion")]
    pub profile: Profile,
    /// Run or checkpoint whose training statistics `strict` uses
    #[arg(long, value_name = "RUN", conflicts_with = "source")]
    pub run: Option<PathBuf>,
    /// Dataset whose statistics `strict` uses
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Also check NAME.raw.npy, the raw model output, beside each NAME.npy
    #[arg(long)]
    pub raw: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Generates samples for the held-out phrases of each run's dataset and prints their metrics next
/// to those of the real phrases; docs/evaluation.md defines the metrics. The `evaluation` and
/// `sampling` tables of each run's config set what is sampled and how; override them with `--set`.
/// Writes eval.json and eval.csv, or eval-noise.json and eval-noise.csv with
/// evaluation.cond=noise.
///
/// With `--audio-ablation`, loss and samples with each phrase's own music are held against silence, its
/// frames shuffled, reversed and half a beat ahead, and another song's, with intervals; the reports
/// are eval-listening.json and eval-listening.csv.
///
/// Runs of recipe `gmd_motion` or `gmd_trajectory` are evaluated on position control: goals are
/// taken from held-out clips, and the distance to them is measured. The reports are
/// eval-goals.json and eval-goals.csv, or eval-goals-two-stage.json and eval-goals-two-stage.csv
/// with a trajectory run.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad eval runs/phrases
  kinegrad eval runs/one runs/two --set evaluation.seeds=4 --out comparison
  kinegrad eval runs/phrases --set evaluation.cond=noise --json
  kinegrad eval runs/phrases --audio-ablation --guidance-scale 1,1.5,2,3,4
  kinegrad eval runs/gmd_motion --trajectory-run runs/gmd_trajectory --set evaluation.obstacles=2")]
pub struct EvalArguments {
    /// Folders of runs (the best checkpoint of each is used) or of checkpoints
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Run of recipe `gmd_trajectory` that generates the ground paths in a first stage
    #[arg(long, value_name = "RUN")]
    pub trajectory_run: Option<PathBuf>,
    /// Measure whether the model hears when the beats of its music fall
    #[arg(long)]
    pub audio_ablation: bool,
    #[command(flatten)]
    pub draw: DrawArguments,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Dataset with the held-out motion, split as in the run's config [default: the run's dataset]
    #[arg(long, value_name = "URI")]
    pub source: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Output folder [default: RUN/reports of each run]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Print a config with all defaults filled in, and the number of model parameters
    Show(ShowArguments),
    /// Say what config keys mean, what they may hold, and their defaults
    Explain(ExplainArguments),
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad config show kinegrad.toml --set model.size=base")]
pub struct ShowArguments {
    /// The config file
    pub config: PathBuf,
    /// Override a key of the config
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

impl Arguments {
    /// Reads a command line.
    ///
    /// # Errors
    /// What clap says of it.
    pub fn read<T>(line: impl IntoIterator<Item = T>) -> Result<Self, clap::Error>
    where
        T: Into<std::ffi::OsString> + Clone,
    {
        let mut command = with_numbers(Self::command());
        let found = command.try_get_matches_from_mut(line)?;
        Self::from_arg_matches(&found).map_err(|error| error.format(&mut command))
    }
}

/// The same command, where `-1` behind an option for a number is its value and no option of its own,
/// and what is no such number is refused in words.
fn with_numbers(command: Line) -> Line {
    let command = command.mut_args(|argument| {
        if !matches!(argument.get_action(), ArgAction::Set | ArgAction::Append) {
            return argument;
        }
        let kind = argument.get_value_parser().type_id();
        let argument = match () {
            () if kind == TypeId::of::<usize>() => argument.value_parser(number::<usize>),
            () if kind == TypeId::of::<u64>() => argument.value_parser(number::<u64>),
            () if kind == TypeId::of::<f64>() => argument.value_parser(number::<f64>),
            () if kind == TypeId::of::<Units>() => argument,
            () => return argument,
        };
        argument.allow_negative_numbers(true)
    });
    command.mut_subcommands(with_numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(line: &str) -> String {
        let line = line.split_whitespace();
        Arguments::read(line).expect_err("refused").to_string()
    }

    #[test]
    fn a_number_below_zero_is_the_value_of_its_option() {
        for line in [
            "kinegrad view a.npy --fps -1",
            "kinegrad view a.npy --audio a.mp3 --start -5",
            "kinegrad plot a.npy --out a.svg --fps -2.5",
            "kinegrad audio features a.mp3 --out a --start -5 --duration -1",
            "kinegrad sample run --out a --audio a.mp3 --start -5 --guidance-scale -1",
        ] {
            Arguments::read(line.split_whitespace()).expect(line);
        }
        for line in [
            "kinegrad sample run --out a --count -1",
            "kinegrad sample run --out a --frames -1",
            "kinegrad sample run --out a --steps 1.5",
            "kinegrad eval run --seed -1",
            "kinegrad data synth --out a --phrases -1",
            "kinegrad import a.pt --arch gmd_motion --out a --padded-frames -1",
        ] {
            let said = refused(line);
            assert!(
                said.contains("allowed: a whole number, 0 or more"),
                "{said}"
            );
        }
        let said = refused("kinegrad view a.npy --units -1");
        assert!(said.contains("a positive number of metres"), "{said}");
        let said = refused("kinegrad eval run --seed 99999999999999999999");
        assert!(said.contains("at most 18446744073709551615"), "{said}");
        let said = refused("kinegrad view a.npy -1");
        assert!(said.contains("unexpected argument"), "{said}");
    }
}
