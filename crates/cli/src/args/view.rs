//! Arguments of `kinegrad view`.

use std::path::PathBuf;

use clap::Args;

use super::reading::BvhArguments;

/// Arguments of `kinegrad view`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad view dance.npy --audio song.mp3 --start 30
  kinegrad view walk.npy --goal goal.toml
  kinegrad view dance.npy --raw
  kinegrad view sample.npy real.npy --title 'Sample and real motion' --out both.html
  kinegrad view capture.bvh --units cmu
  kinegrad view dance.npy --audio song.mp3 --mp4 dance.mp4 --glb dance.glb --bvh dance.bvh")]
pub struct ViewArguments {
    /// Motion files (.npy or .bvh), or folders of them
    #[arg(required = true, value_name = "MOTION")]
    pub motions: Vec<PathBuf>,
    /// Song (mp3, wav, flac, ogg) to play with the motion
    #[arg(long, value_name = "SONG")]
    pub audio: Option<PathBuf>,
    /// Position in the song, in seconds, at which the motion starts
    #[arg(long, value_name = "S", default_value_t = 0.0, requires = "audio")]
    pub start: f64,
    /// Goal to show on the floor: key frames, trajectory and obstacles
    #[arg(long, value_name = "GOAL.toml")]
    pub goal: Option<PathBuf>,
    /// Also show NAME.raw.npy, the model output, beside each NAME.npy
    #[arg(long)]
    pub raw: bool,
    #[command(flatten)]
    pub reading: BvhArguments,
    /// Title of the page [default: the names of the motions]
    #[arg(long)]
    pub title: Option<String>,
    /// Page to write [default: the first motion's path ending in .html, unless another output is
    /// given]
    #[arg(long, value_name = "PAGE.html")]
    pub out: Option<PathBuf>,
    /// Write an animated picture
    #[arg(long, value_name = "FILE.gif")]
    pub gif: Option<PathBuf>,
    /// Write a video with the song; needs ffmpeg
    #[arg(long, value_name = "FILE.mp4")]
    pub mp4: Option<PathBuf>,
    /// Write an animated skeleton as binary glTF, for Blender, game engines and web viewers
    #[arg(long, value_name = "FILE.glb")]
    pub glb: Option<PathBuf>,
    /// Write one motion as BVH in centimeters with +y up
    #[arg(long, value_name = "FILE.bvh")]
    pub bvh: Option<PathBuf>,
    /// Lock standing feet in the BVH file
    #[arg(long, requires = "bvh")]
    pub lock_feet: bool,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
}
