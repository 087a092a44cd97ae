//! Songs and their features.

use std::path::Path;

use kinegrad_audio::{Analysis, Features, SAMPLE_RATE, Waveform, decode, extract};
use miette::Diagnostic;

use crate::error::Error;
use crate::memory::must_fit;

/// Decodes the song at `path` and computes the features of all of it.
///
/// # Errors
/// If it cannot be decoded, has unusable samples, or is too long for the memory that is free.
pub fn song_features(path: &Path) -> Result<(Waveform, Features), Error> {
    let waveform = decode(path)?;
    let samples = waveform.samples.len();
    let minutes = samples as f64 / f64::from(SAMPLE_RATE) / 60.0;
    must_fit(
        &format!("{}: the analysis of {minutes:.0} minutes", path.display()),
        Analysis::memory(samples),
        "cut the song into pieces, or free memory",
    )?;
    let features = extract(&waveform.samples).map_err(|error| {
        let hint = error.help().map(|hint| hint.to_string());
        let message = format!("{}: {error}", path.display());
        Error::usage(message, hint.unwrap_or_default())
    })?;
    Ok((waveform, features))
}
