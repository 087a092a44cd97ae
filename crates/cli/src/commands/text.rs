//! `kinegrad text`

use std::ops::ControlFlow;
use std::process::ExitCode;

use kinegrad_data::FileError;
use kinegrad_data::file::read_text;
use kinegrad_data::humanml::{read_captions, write_embeddings};
use kinegrad_report::grouped;
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
    let (named, texts) = texts(&arguments)?;
    let (device, _) = device::open(&arguments.device)?;
    let encoder = TextEncoder::read(&arguments.text_encoder, &device)?;
    // Captions repeat.
    let mut distinct: Vec<&str> = texts.iter().map(String::as_str).collect();
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
    let mut rest = texts.iter().map(row);
    let tensors = named.iter().map(|(name, texts)| {
        let rows: Vec<&[f32]> = rest.by_ref().take(*texts).collect();
        (name.as_str(), rows)
    });
    let tensors: Vec<_> = tensors.collect();
    // The file of a dataset records its captions.
    let mut rest = texts.iter().map(String::as_str);
    let of = named.iter().map(|(name, texts)| {
        let captions: Vec<&str> = rest.by_ref().take(*texts).collect();
        (name.as_str(), captions)
    });
    let of: Vec<_> = match arguments.dataset {
        Some(_) => of.collect(),
        None => Vec::new(),
    };
    interrupt::not_during(|| write_embeddings(out, tensors, &of))?;
    say!(
        "{}: {} embeddings in {} tensor(s)",
        out.display(),
        grouped(texts.len()),
        grouped(named.len())
    );
    Ok(ExitCode::SUCCESS)
}

/// The tensors by name, each with its number of texts, and all texts in their order.
type NamedTexts = (Vec<(String, usize)>, Vec<String>);

/// The texts to embed, at least one.
fn texts(arguments: &EmbedArguments) -> Result<NamedTexts, Error> {
    if let Some(dataset) = &arguments.dataset {
        let clips = read_captions(dataset)?;
        let named = clips
            .iter()
            .map(|(id, captions)| (id.clone(), captions.len()));
        let texts = clips.iter().flat_map(|(_, captions)| captions);
        return Ok((
            named.collect(),
            texts.map(|caption| caption.text.clone()).collect(),
        ));
    }
    let texts = match &arguments.file {
        None => arguments.sentences.clone(),
        Some(path) => {
            let text = read_text(path).map_err(FileError::read(path))?;
            let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
            let lines: Vec<String> = lines
                .filter(|line| !line.is_empty())
                .map(String::from)
                .collect();
            if lines.is_empty() {
                let message = format!("{} has no sentence", path.display());
                return Err(Error::usage(message, "write a sentence per line"));
            }
            lines
        }
    };
    Ok((vec![(TENSOR.to_owned(), texts.len())], texts))
}
