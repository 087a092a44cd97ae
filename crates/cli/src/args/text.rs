//! Arguments of the commands on texts.

use std::path::PathBuf;

use clap::{Args, Subcommand};

#[derive(Debug, Subcommand)]
pub enum TextCommand {
    /// Compute the embeddings of sentences, or of the captions of a dataset
    Embed(EmbedArguments),
}

/// Arguments of `kinegrad text embed`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  kinegrad text embed --text-encoder clip-vit-base-patch32 --dataset HumanML3D \\
    --out HumanML3D/text_embeddings.safetensors
  kinegrad text embed --text-encoder clip-vit-base-patch32 \"a person walks in a circle\" --out text.safetensors")]
pub struct EmbedArguments {
    /// Sentences
    #[arg(value_name = "SENTENCE", required_unless_present_any = ["dataset", "file"])]
    pub sentences: Vec<String>,
    /// Dataset folder whose captions, `texts/ID.txt`, are embedded
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["sentences", "file"])]
    pub dataset: Option<PathBuf>,
    /// File with one sentence per line
    #[arg(long, value_name = "FILE.txt", conflicts_with = "sentences")]
    pub file: Option<PathBuf>,
    /// Folder of CLIP ViT-B/32
    #[arg(long, value_name = "DIR")]
    pub text_encoder: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE.safetensors")]
    pub out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    pub overwrite: bool,
    /// Device to run on [default: KINEGRAD_DEVICE, else auto]
    #[arg(long)]
    pub device: Option<String>,
}
