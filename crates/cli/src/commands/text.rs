//! `kinegrad text`

use std::ops::ControlFlow;
use std::process::ExitCode;

use kinegrad_data::FileError;
use kinegrad_data::file::read_text;
use kinegrad_data::humanml::{read_captions, write_embeddings};
use kinegrad_report::grouped;
use kinegrad_settings::plural;
use kinegrad_train::config::environment;
use kinegrad_train::text_encoder::TextEncoder;
use kinegrad_train::{Error, device};

use crate::args::EmbedArguments;
use crate::interrupt;
use crate::io::must_be_new;
use crate::progress::Count;

/// Name of the tensor of sentences.
const TENSOR: &str = "text";

/// Embeds texts and writes the embeddings.
pub fn embed(arguments: EmbedArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let out = &arguments.out;
    must_be_new([out], &[], arguments.overwrite, "--out")?;
    let named = texts(&arguments)?;
    let texts = named.iter().flat_map(|(_, texts)| texts);
    let device = match &arguments.device {
        Some(device) => Some(device.clone()),
        None => environment::device()?,
    };
    let (device, _) = device::open(device.as_deref().unwrap_or("auto"))?;
    let encoder = TextEncoder::read(&arguments.text_encoder, &device)?;
    // Captions repeat.
    let mut distinct: Vec<&str> = texts.clone().map(String::as_str).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let count = Count::new("texts embedded");
    let embedded = encoder.embed(&distinct, &mut |done| {
        count.show(done, distinct.len());
        ControlFlow::Continue(())
    })?;
    let row = |text: &String| {
        let place = distinct.binary_search(&text.as_str());
        embedded[place.expect("one of them")].as_slice()
    };
    let tensors = named.iter();
    let tensors = tensors.map(|(name, texts)| (name.as_str(), texts.iter().map(row).collect()));
    // The file of a dataset records its captions.
    let captions = named.iter().filter(|_| arguments.dataset.is_some());
    let captions = captions.map(|(name, texts)| (name.as_str(), texts.iter().map(String::as_str)));
    let captions: Vec<_> = captions
        .map(|(name, texts)| (name, texts.collect()))
        .collect();
    interrupt::not_during(|| write_embeddings(out, tensors.collect(), &captions))?;
    let texts = texts.count();
    say!(
        "{}: {} {} in {} {}",
        out.display(),
        grouped(texts),
        plural(texts, "embedding"),
        grouped(named.len()),
        plural(named.len(), "tensor")
    );
    Ok(ExitCode::SUCCESS)
}

/// The texts to embed, by tensor; fails without a text.
fn texts(arguments: &EmbedArguments) -> Result<Vec<(String, Vec<String>)>, Error> {
    if let Some(dataset) = &arguments.dataset {
        let clips = read_captions(dataset)?.into_iter();
        let named = clips.map(|(id, captions)| {
            let texts = captions.into_iter().map(|caption| caption.text);
            (id, texts.collect())
        });
        return Ok(named.collect());
    }
    let texts = match &arguments.file {
        None => arguments.sentences.clone(),
        Some(path) => {
            let text = read_text(path).map_err(FileError::read(path))?;
            let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
            let lines = lines.filter(|line| !line.is_empty());
            let lines: Vec<String> = lines.map(String::from).collect();
            if lines.is_empty() {
                let message = format!("{} has no sentence", path.display());
                return Err(Error::usage(message, "write a sentence per line"));
            }
            lines
        }
    };
    Ok(vec![(TENSOR.to_owned(), texts)])
}
