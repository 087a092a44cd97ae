//! Arguments of `kinegrad match`.

use std::path::PathBuf;

use clap::Args;
use kinegrad_capture::UpAxis;
use kinegrad_matching::{CoarseRatio, Length, Preset};

use super::values::named;

/// New motion from examples, without training (GenMM): patches of the examples are matched with a
/// start of noise and averaged, from coarse to fine. The result is made of the examples' own
/// movements in another order; several examples are mixed. They may be motions of any skeleton,
/// not only people; all of them have the same joints.
///
/// The new file has the hierarchy, channels and units of the first example, at about 30 frames a
/// second: faster captures are thinned. Examples may be clips of joint features as well (.npy, such as
/// HumanML3D's), and the new file a clip of them. Beside it, NEW.json records how it was made, with measures of
/// coverage, diversity and what is copied. docs/matching.md describes them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad match dance.bvh --out new.bvh
  kinegrad match dance.bvh --out new.bvh --length 20s --seed 7 --svg new.svg
  kinegrad match walk-1.bvh walk-2.bvh walk-3.bvh --out walks.bvh
  kinegrad match idle.bvh --out loop.bvh --length 5s --loop
  kinegrad match dance.bvh --out new.bvh --preset paper --parts parts.toml
  kinegrad match dance.bvh --out new.bvh --fix legs=walk.bvh
  kinegrad match dance.bvh --out new.bvh --keyframes poses.toml
  kinegrad match proud-walk.bvh --content walk.bvh --out new.bvh
  kinegrad match clip.npy --out new.npy")]
pub struct MatchArguments {
    /// Motions to learn from (.bvh, or .npy of joint features)
    #[arg(required = true, value_name = "EXAMPLE.bvh")]
    pub examples: Vec<PathBuf>,
    /// File to write: .bvh, or .npy where the examples are clips
    #[arg(long, value_name = "NEW.bvh")]
    pub out: PathBuf,
    /// Replace files that exist
    #[arg(long)]
    pub overwrite: bool,
    /// Length: times all examples together (2x), frames at the rate of the new file (300), or
    /// seconds (12.5s) [default: 2x; with `--fix` or `--content` the length of that motion]
    #[arg(long)]
    pub length: Option<Length>,
    /// Random seed of the noise
    #[arg(long, default_value_t = 0, conflicts_with = "content")]
    pub seed: u64,
    /// Settings to start from: `published` (the published program's) or `paper` (the paper's: by
    /// body parts, with contacts of the feet)
    #[arg(long, value_parser = named::<Preset>, default_value = "published")]
    pub preset: Preset,
    /// From mixing (0) to copying long stretches (1), in place of `--coarse-ratio` and `--alpha`
    #[arg(long, value_name = "0..1", conflicts_with_all = ["coarse_ratio", "alpha"])]
    pub coherence: Option<f64>,
    /// Frames of a patch, odd [default: from the preset, 11]
    #[arg(long, value_name = "FRAMES")]
    pub patch_size: Option<usize>,
    /// Length of the coarsest level: patch sizes of the longest example (5x), or a part of each
    /// length (0.15) [default: from the preset]
    #[arg(long, value_name = "RATIO")]
    pub coarse_ratio: Option<CoarseRatio>,
    /// Length of a level divided by that of the next finer one [default: from the preset, 0.75]
    #[arg(long, value_name = "FACTOR")]
    pub pyr_factor: Option<f64>,
    /// Completeness: the smaller, the more of the examples appears; `none` turns it off [default:
    /// from the preset, 0.01]
    #[arg(long, value_parser = alpha)]
    pub alpha: Option<Completeness>,
    /// Standard deviation of the noise to start with [default: from the preset]
    #[arg(long, conflicts_with = "content")]
    pub sigma: Option<f64>,
    /// Steps of matching at each level [default: from the preset]
    #[arg(long, value_name = "N")]
    pub num_steps: Option<usize>,
    /// Lead the end of the motion into its beginning
    #[arg(long = "loop")]
    pub looping: bool,
    /// See the body from its heading: walks in all directions are alike, and the motion turns as they
    /// do. For examples that turn around
    #[arg(long)]
    pub heading: bool,
    /// Match body parts each by itself: `whole`, `auto` (trunk and limbs), or a TOML file of parts
    /// [default: from the preset]
    #[arg(long, value_name = "PARTS")]
    pub parts: Option<PathBuf>,
    /// Poses that the motion takes at given times
    #[arg(long, value_name = "KEYFRAMES.toml")]
    pub keyframes: Option<PathBuf>,
    /// Part that follows a motion, as legs=walk.bvh: a part of `--parts`, a joint with all that
    /// hangs on it, or `legs`, `arms` or `head`
    #[arg(long, value_name = "PART=MOTION.bvh", value_parser = fixed)]
    pub fix: Vec<(String, PathBuf)>,
    /// Motion whose coarse course the new one follows, in the manner of the examples; it starts from
    /// there in place of noise
    #[arg(long, value_name = "MOTION.bvh")]
    pub content: Option<PathBuf>,
    /// Hold feet still where those of the examples rest
    #[arg(long, conflicts_with = "looping")]
    pub lock_feet: bool,
    /// Axis of the files that points up: y or z [default: the one along which feet are below the
    /// root]
    #[arg(long, value_parser = named::<UpAxis>, value_name = "AXIS")]
    pub up: Option<UpAxis>,
    /// Draw where each frame comes from, which frames of the examples appear, and the way from
    /// above
    #[arg(long, value_name = "FILE.svg")]
    pub svg: Option<PathBuf>,
    /// Print the record as JSON
    #[arg(long)]
    pub json: bool,
}

/// Completeness from the command line; none where it is turned off.
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
