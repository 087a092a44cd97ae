//! Arguments of `kinegrad match`.

use std::path::PathBuf;

use clap::Args;
use kinegrad_capture::UpAxis;
use kinegrad_matching::{CoarseRatio, Heading, Length, Preset};

use super::values::named;

/// Arguments of `kinegrad match`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad match dance.bvh --out new.bvh
  kinegrad match dance.bvh --out new.bvh --length 20s --seed 7 --svg new.svg
  kinegrad match walk-1.bvh walk-2.bvh walk-3.bvh --out walks.bvh
  kinegrad match person.bvh other-skeleton.bvh --out mixed.bvh --joint-map map.toml
  kinegrad match idle.bvh --out loop.bvh --length 5s --loop
  kinegrad match dance.bvh --out new.bvh --preset paper --parts parts.toml
  kinegrad match dance.bvh --out new.bvh --fix legs=walk.bvh
  kinegrad match dance.bvh --out new.bvh --keyframes poses.toml
  kinegrad match proud-walk.bvh --content walk.bvh --out new.bvh
  kinegrad match clip.npy --out new.npy")]
pub struct MatchArguments {
    /// Example motions (.bvh, or .npy of joint features)
    #[arg(required = true, value_name = "EXAMPLE.bvh")]
    pub examples: Vec<PathBuf>,
    /// File to write: .bvh, or .npy if the examples are clips
    #[arg(long, value_name = "NEW.bvh")]
    pub out: PathBuf,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    /// Length: a multiple of the examples' total length (2x), frames (300), or seconds (12.5s)
    /// [default: 2x; with `--fix` or `--content`, the length of the given motion]
    #[arg(long)]
    pub length: Option<Length>,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0, conflicts_with = "content")]
    pub seed: u64,
    /// Default settings: `published` (as in the published program) or `paper` (body parts and foot
    /// contacts) [default: published, with a higher coherence if the motion slides, shakes or freezes]
    #[arg(long, value_parser = named::<Preset>)]
    pub preset: Option<Preset>,
    /// Coherence, from mixing (0) to copying long stretches (1); sets `--coarse-ratio` and `--alpha`
    /// [default: as low as the measures allow]
    #[arg(long, value_name = "0..1", conflicts_with_all = ["coarse_ratio", "alpha"])]
    pub coherence: Option<f64>,
    /// Odd number of frames in a patch [default: from the preset, 11]
    #[arg(long, value_name = "FRAMES")]
    pub patch_size: Option<usize>,
    /// Length of the coarsest level: in patch sizes (5x), or as a fraction of the example (0.15)
    /// [default: from the preset]
    #[arg(long, value_name = "RATIO")]
    pub coarse_ratio: Option<CoarseRatio>,
    /// Ratio of the lengths of a level and the next finer one [default: from the preset, 0.75]
    #[arg(long, value_name = "FACTOR")]
    pub pyr_factor: Option<f64>,
    /// Completeness: smaller values use more of the examples; `none` disables completeness
    /// [default: from the preset, 0.01]
    #[arg(long, value_parser = alpha)]
    pub alpha: Option<Completeness>,
    /// Standard deviation of the initial noise [default: from the preset]
    #[arg(long, conflicts_with = "content")]
    pub sigma: Option<f64>,
    /// Matching steps per level [default: from the preset]
    #[arg(long, value_name = "N")]
    pub num_steps: Option<usize>,
    /// Make a loop
    #[arg(long = "loop")]
    pub looping: bool,
    /// Match motion relative to the heading, so that walks in different directions match: `relative`
    /// (without a value), `world`, or `auto`, which is relative if the examples turn around [default:
    /// auto; with `--preset` world]
    #[arg(long, value_name = "HEADING", value_parser = named::<Heading>, num_args = 0..=1,
          require_equals = true, default_missing_value = "relative")]
    pub heading: Option<Heading>,
    /// Body parts that are matched separately: `whole`, `auto` (trunk and limbs), or a TOML file
    /// [default: from the preset]
    #[arg(long, value_name = "PARTS")]
    pub parts: Option<PathBuf>,
    /// File of the joints' names in examples of other skeletons [default: by name, or by the built-in
    /// maps of known skeletons]
    #[arg(long, value_name = "MAP.toml")]
    pub joint_map: Option<PathBuf>,
    /// File of poses at given times
    #[arg(long, value_name = "KEYFRAMES.toml")]
    pub keyframes: Option<PathBuf>,
    /// Part that follows a motion, for example legs=walk.bvh: a part of `--parts`, a joint and its
    /// descendants, or `legs`, `arms` or `head`
    #[arg(long, value_name = "PART=MOTION.bvh", value_parser = fixed)]
    pub fix: Vec<(String, PathBuf)>,
    /// Motion to restyle, which replaces the initial noise
    #[arg(long, value_name = "MOTION.bvh")]
    pub content: Option<PathBuf>,
    /// Lock feet while the examples' feet stand
    #[arg(long)]
    pub lock_feet: bool,
    /// Write motion that is far livelier than the examples under its usual name, and exit with 0
    #[arg(long)]
    pub allow_unusable: bool,
    /// Axis of the files that points up: y or z [default: guessed from the feet]
    #[arg(long, value_parser = named::<UpAxis>, value_name = "AXIS")]
    pub up: Option<UpAxis>,
    /// Plot each frame's source frame, the used frames of the examples, and the root path
    #[arg(long, value_name = "FILE.svg")]
    pub svg: Option<PathBuf>,
    /// Print the record as JSON
    #[arg(long)]
    pub json: bool,
}

/// Completeness; `None` disables it.
#[derive(Clone, Copy, Debug)]
pub struct Completeness(pub Option<f64>);

fn alpha(text: &str) -> Result<Completeness, String> {
    match (text, text.parse()) {
        ("none", _) => Ok(Completeness(None)),
        (_, Ok(alpha)) => Ok(Completeness(Some(alpha))),
        _ => Err("allowed: a number above 0, or `none`".to_string()),
    }
}

fn fixed(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((part, motion)) if !part.is_empty() && !motion.is_empty() => {
            Ok((part.to_string(), PathBuf::from(motion)))
        }
        _ => Err("allowed: a part and a motion, as legs=walk.bvh".to_string()),
    }
}
