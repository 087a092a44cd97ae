//! Arguments of the commands on datasets and songs.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use kinegrad_data::humanml::SkeletonName;
use kinegrad_train::song::KnownBeats;

use super::values::named;

#[derive(Debug, Subcommand)]
pub enum DataCommand {
    /// Create a synthetic dataset: phrases that follow the beat of their audio features, or walks
    /// in the HumanML3D layout
    Synth(SynthArguments),
    /// Create a dataset from motion captures: phrases with their songs, or clips with captions
    Prepare(PrepareArguments),
    /// Summarize a dataset and list its problems
    Inspect(InspectArguments),
}

/// Arguments of `kinegrad data prepare`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad init prepare
  kinegrad data prepare prepare.toml --out gs://bucket/dances
  kinegrad init bodies
  kinegrad data prepare bodies.toml")]
pub struct PrepareArguments {
    /// Plan of the dataset
    #[arg(value_name = "PLAN.toml")]
    pub plan: PathBuf,
    /// Output folder, gs:// or s3:// URI [default: the plan's `output`]
    #[arg(long, value_name = "URI")]
    pub out: Option<String>,
    /// Process unchanged takes again
    #[arg(long)]
    pub again: bool,
    /// Remove phrases or clips of takes that are no longer in the plan
    #[arg(long)]
    pub prune: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Subcommand)]
pub enum AudioCommand {
    /// Compute the audio features of songs, in the format of a dataset
    Features(FeaturesArguments),
}

/// Arguments of `kinegrad audio features`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad audio features songs/*.mp3 --out features --plot
  kinegrad audio features song.mp3 --start 30 --duration 10 --out features
  kinegrad audio features waltz.mp3 --beats --tempo 88 --beats-per-bar 3 --downbeat 1.4 --out features")]
pub struct FeaturesArguments {
    /// Songs (mp3, wav, flac, ogg)
    #[arg(required = true, value_name = "SONG")]
    pub songs: Vec<PathBuf>,
    /// Output folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    /// Position in the songs, in seconds, at which the features start
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub start: f64,
    /// Length of the features in seconds [default: to the end of the song]
    #[arg(long, value_name = "SECONDS")]
    pub duration: Option<f64>,
    /// Also write beat features, `beats` [7, T]: sine and cosine of the position in beat and bar, a
    /// flag for a known bar, a mark on each beat, and the tempo in octaves above 120 beats per
    /// minute
    #[arg(long = "beats")]
    pub with_beats: bool,
    #[command(flatten)]
    pub beats: BeatArguments,
    /// Also plot features and beats to DIR/NAME/features.png
    #[arg(long)]
    pub plot: bool,
}

/// The known beats of a song.
#[derive(Clone, Debug, Default, Args)]
pub struct BeatArguments {
    /// Approximate tempo of the song in beats per minute; selects between the tracked tempo, its
    /// double and its half
    #[arg(long, value_name = "BPM")]
    pub tempo: Option<f64>,
    /// Beats in a bar of the song [default: 4]
    #[arg(long, value_name = "N", requires = "downbeat")]
    pub beats_per_bar: Option<u32>,
    /// Start of a bar, in seconds of the song [default: unknown]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub downbeat: Option<f64>,
}

impl BeatArguments {
    /// The known beats for the audio crate.
    pub fn known(&self) -> KnownBeats {
        KnownBeats {
            tempo: self.tempo,
            beats_per_bar: self.beats_per_bar,
            downbeat: self.downbeat,
        }
    }
}

/// Arguments of `kinegrad data synth`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  kinegrad data synth --out phrases --phrases 64 --frames 120 --seed 0")]
pub struct SynthArguments {
    /// Output folder, new or empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Create walks in the HumanML3D layout instead of phrases
    #[arg(long)]
    pub walks: bool,
    /// Number of phrases or walks
    #[arg(long, default_value_t = 64, value_name = "N")]
    pub phrases: usize,
    /// Frames of each phrase (30 per second) or walk (20 per second)
    #[arg(long, default_value_t = 120, value_name = "T")]
    pub frames: usize,
    /// Random seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Also write beat features (`data.audio_features = ["ccmotion", "beats"]`)
    #[arg(long, conflicts_with = "walks")]
    pub beats: bool,
}

/// Arguments of `kinegrad data inspect`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad data inspect phrases
  kinegrad data inspect gs://bucket/dances --where 'tempo > 100 and split = train' --plot tempo.png")]
pub struct InspectArguments {
    /// Dataset: a folder, or a file://, gs://, s3://, http:// or https:// URI; endpoint and
    /// credentials come from the environment
    #[arg(value_name = "URI")]
    pub source: String,
    /// List the manifest's items that match a condition on columns, such as `tempo > 100` or `split
    /// = train and not flags like *no_audio*`; reads only the manifest
    #[arg(long = "where", value_name = "CONDITION")]
    pub condition: Option<String>,
    /// Plot tempo, length and beats of the items that match `--where`
    #[arg(long, value_name = "FILE.png|FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Read the dataset as clips in the HumanML3D layout [default: detected]
    #[arg(long, conflicts_with_all = ["condition", "plot"])]
    pub humanml3d: bool,
    /// Skeleton of the clips: humanml3d or kit [default: detected]
    #[arg(long, value_parser = named::<SkeletonName>, conflicts_with_all = ["condition", "plot"])]
    pub skeleton: Option<SkeletonName>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
