//! `features.npz`: reading and writing the audio features of a phrase.

use std::io::{Cursor, Write};
use std::path::Path;

use kinegrad_audio::Features;
use kinegrad_motion::MAX_FRAMES;
use libdeflater::{Crc, Decompressor};
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter, write::SimpleFileOptions};

use crate::audio_layout::{AUDIO_CHANNELS, AudioLayout};
use crate::features::{AudioFeatures, BEATS};
use crate::npy::{self, Array};
use crate::{Error, FileError, atomic};

/// Largest archive of features.
pub(crate) const MAX_FEATURES_BYTES: u64 = npy::max_bytes(AUDIO_CHANNELS + BEATS.1) + (1 << 20);

/// Members are stored: deflating saves 13 % and halves the reading speed.
const METHOD: CompressionMethod = CompressionMethod::Stored;

/// Largest compression ratio of deflate.
const MOST_UNPACKED: usize = 1032;

/// Parses the bytes of a `features.npz` and stacks the arrays to `[channels, frames]` of `layout`
/// (CC-MotionGen, section 4.3), or reads a `.npy` array that is stacked already. Other members are
/// ignored; `file` names the file in errors. Fails with [`FileError`] for an unreadable or truncated
/// archive, a missing member, another dtype or shape, and members of unequal length. Accepts values
/// that are not finite (see [`crate::load_audio`]).
pub fn parse_features(
    bytes: &[u8],
    file: &str,
    layout: AudioLayout,
) -> Result<AudioFeatures, FileError> {
    if npy::is_array(bytes) {
        return stacked(bytes, file, layout);
    }
    let mut archive = Archive::new(bytes, file)?;
    let mut frames = None;
    let mut values = Vec::new();
    for (name, rows) in layout.arrays() {
        let shape = archive.read(name, rows, &mut values)?;
        let length = check_shape(&shape, file, name, rows)?;
        let expected = *frames.get_or_insert_with(|| {
            values.reserve_exact(layout.channels() * length - values.len());
            length
        });
        if length != expected {
            let problem = format!("`{name}` has {length} frames, `mel` has {expected}");
            let hint = "all features of a phrase cover the same frames";
            return Err(FileError::unusable(file, problem, hint));
        }
    }
    let frames = frames.unwrap_or_default();
    debug_assert_eq!(values.len(), layout.channels() * frames);
    let features = AudioFeatures::new(frames, values);
    Ok(features.unwrap_or_else(|| AudioFeatures::silence(layout, frames)))
}

/// Parses an array `[channels, frames]` or `[1, channels, frames]`.
fn stacked(bytes: &[u8], file: &str, layout: AudioLayout) -> Result<AudioFeatures, FileError> {
    let array = npy::parse(bytes, file)?;
    let channels = layout.channels();
    match array.shape[..] {
        [rows, frames] | [1, rows, frames]
            if rows == channels && (1..=MAX_FRAMES).contains(&frames) =>
        {
            let features = AudioFeatures::new(frames, array.values);
            Ok(features.unwrap_or_else(|| AudioFeatures::silence(layout, frames)))
        }
        _ => {
            let allowed = format!("[{channels}, frames], up to {MAX_FRAMES} frames");
            Err(FileError::shape(file, &array.shape, allowed))
        }
    }
}

/// Parses the named arrays of an archive, each `[frames, width]` with the same length. Fails with
/// [`FileError`], as [`parse_features`].
pub fn parse_arrays(
    bytes: &[u8],
    file: &str,
    wanted: &[(&'static str, usize)],
) -> Result<Vec<Array>, FileError> {
    let mut archive = Archive::new(bytes, file)?;
    let mut arrays: Vec<Array> = Vec::new();
    for &(name, width) in wanted {
        let mut values = Vec::new();
        let shape = archive.read(name, width, &mut values)?;
        let array = Array { shape, values };
        let frames = arrays.first().map(|first| first.shape[0]);
        match array.shape[..] {
            [found, columns]
                if columns == width
                    && (1..=MAX_FRAMES).contains(&found)
                    && frames.is_none_or(|frames| frames == found) => {}
            _ => {
                let allowed = format!("[frames, {width}], as many frames in every array");
                let member = format!("{file}:{name}");
                return Err(FileError::shape(&member, &array.shape, allowed));
            }
        }
        arrays.push(array);
    }
    Ok(arrays)
}

/// Writes `features` as float32 members for NumPy, atomically. Fails with [`Error::Io`].
pub fn write_features(path: &Path, features: &AudioFeatures) -> Result<(), Error> {
    atomic::write(path, &features_bytes(features))
}

/// Writes a song's `stacked` features, `tempo` (beats per minute) and `beat_times` `[beats]`
/// (seconds) atomically.
pub fn write_song_features(
    path: &Path,
    features: &Features,
    stacked: &AudioFeatures,
) -> Result<(), Error> {
    let beats = features.beats();
    let times: Vec<f32> = beats.times().into_iter().map(|time| time as f32).collect();
    let tempo = [beats.tempo as f32];
    let beside = [
        ("tempo", vec![], &tempo[..]),
        ("beat_times", vec![times.len()], &times),
    ];
    atomic::write(path, &archive(stacked, &beside, METHOD))
}

/// The bytes of the `features.npz` of `features`; equal features give equal bytes.
pub fn features_bytes(features: &AudioFeatures) -> Vec<u8> {
    archive(features, &[], METHOD)
}

fn archive(
    features: &AudioFeatures,
    beside: &[(&str, Vec<usize>, &[f32])],
    method: CompressionMethod,
) -> Vec<u8> {
    let frames = features.frames();
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // Entries without a date would contain the current time.
    let options = SimpleFileOptions::default()
        .compression_method(method)
        .last_modified_time(DateTime::default());
    let members = features.arrays().map(|(name, rows, values)| match rows {
        1 => (name, vec![frames], values),
        _ => (name, vec![rows, frames], values),
    });
    let mut members = members.chain(beside.iter().cloned());
    let written = members.try_for_each(|(name, shape, values)| {
        archive.start_file(format!("{name}.npy"), options)?;
        archive.write_all(&npy::array_bytes(&shape, values))
    });
    let finished = written.and_then(|()| Ok(archive.finish()?));
    finished.expect("memory takes every byte").into_inner()
}

/// The error about an unreadable archive or member.
fn not_npz(file: &str, reason: &str) -> FileError {
    let problem = format!("not a readable .npz archive: {reason}");
    FileError::unusable(file, problem, npy::CUT_OFF)
}

/// The members of an archive in memory.
struct Archive<'a> {
    file: &'a str,
    bytes: &'a [u8],
    directory: ZipArchive<Cursor<&'a [u8]>>,
    inflater: Decompressor,
    /// The last unpacked member.
    unpacked: Vec<u8>,
}

impl<'a> Archive<'a> {
    fn new(bytes: &'a [u8], file: &'a str) -> Result<Self, FileError> {
        let directory = ZipArchive::new(Cursor::new(bytes));
        let directory = directory.map_err(|error| not_npz(file, &error.to_string()))?;
        Ok(Self {
            file,
            bytes,
            directory,
            inflater: Decompressor::new(),
            unpacked: Vec::new(),
        })
    }

    /// Appends the values of member `name`, with `rows` values per frame, and returns the shape.
    fn read(
        &mut self,
        name: &'static str,
        rows: usize,
        values: &mut Vec<f32>,
    ) -> Result<Vec<usize>, FileError> {
        let label = format!("{}:{name}", self.file);
        let Some(index) = self.directory.index_for_name(&format!("{name}.npy")) else {
            return Err(self.missing(name));
        };
        let unpacked = self.unpack(index, npy::max_bytes(rows));
        npy::parse_onto(values, unpacked.map_err(|e| not_npz(&label, &e))?, &label)
    }

    /// The bytes of member `index`, at most `limit`.
    fn unpack(&mut self, index: usize, limit: u64) -> Result<&[u8], String> {
        let entry = self.directory.by_index_raw(index);
        let entry = entry.map_err(|error| error.to_string())?;
        if entry.encrypted() {
            return Err("it is encrypted".to_owned());
        }
        let packed = entry
            .data_start()
            .and_then(|start| usize::try_from(start).ok())
            .zip(usize::try_from(entry.compressed_size()).ok())
            .and_then(|(start, length)| self.bytes.get(start..)?.get(..length))
            .ok_or("it reaches beyond the end of the file")?;
        let declared = entry.size();
        if declared > limit {
            return Err(format!(
                "{declared} bytes unpacked, {limit} allowed: {MAX_FRAMES} frames"
            ));
        }
        let size = declared as usize;
        let unpacked = match entry.compression() {
            CompressionMethod::Stored => packed,
            CompressionMethod::Deflated => {
                // The packed bytes limit the size of the allocation.
                let length = packed.len();
                if size > MOST_UNPACKED.saturating_mul(length) {
                    return Err(format!(
                        "{size} bytes declared, {length} packed bytes cannot hold so many"
                    ));
                }
                if self.unpacked.len() < size {
                    // Free the old buffer before the new allocation.
                    self.unpacked = Vec::new();
                    self.unpacked = vec![0; size];
                }
                let room = &mut self.unpacked[..size];
                let filled = self.inflater.deflate_decompress(packed, room);
                let filled = filled.map_err(|error| format!("it cannot be unpacked: {error}"))?;
                &self.unpacked[..filled]
            }
            other => {
                return Err(format!(
                    "compression {other} found, stored or deflated allowed"
                ));
            }
        };
        let length = unpacked.len();
        if length != size {
            return Err(format!("{length} bytes unpacked, {size} declared"));
        }
        let mut checksum = Crc::new();
        checksum.update(unpacked);
        if checksum.sum() != entry.crc32() {
            return Err("its checksum does not match its bytes".to_owned());
        }
        Ok(unpacked)
    }

    /// The error about a missing member.
    fn missing(&self, member: &'static str) -> FileError {
        let names = self.directory.file_names().flatten();
        let mut found: Vec<String> = names
            .map(|name| name.strip_suffix(".npy").unwrap_or(&name).to_owned())
            .collect();
        found.sort_unstable();
        let more = found.len().saturating_sub(12);
        found.truncate(12);
        let found = match (found.is_empty(), more) {
            (true, _) => "nothing".to_owned(),
            (false, 0) => found.join(", "),
            (false, more) => format!("{} and {more} more", found.join(", ")),
        };
        let problem = format!("array `{member}` is missing; found: {found}");
        let hint = match member == BEATS.0 {
            true => {
                "beat features are requested (data.audio_features = [\"ccmotion\", \"beats\"]): \
                 prepare the songs with them, or use the 163 features alone with \
                 data.audio_features = [\"ccmotion\"]"
            }
            false => {
                "features.npz contains mel, chroma, mfcc, rms, spectral_centroid and onset_strength"
            }
        };
        FileError::unusable(self.file, problem, hint)
    }
}

/// The frames of a member with `rows` rows. A single row has shape `[frames]` or `[1, frames]`.
fn check_shape(shape: &[usize], file: &str, name: &str, rows: usize) -> Result<usize, FileError> {
    let frames = match *shape {
        [frames] if rows == 1 => Some(frames),
        [found_rows, frames] if found_rows == rows => Some(frames),
        _ => None,
    };
    frames
        .filter(|frames| (1..=MAX_FRAMES).contains(frames))
        .ok_or_else(|| {
            let axes = if rows == 1 { "" } else { &format!("{rows}, ") };
            let allowed = format!("[{axes}frames] with 1 to {MAX_FRAMES} frames");
            FileError::shape(&format!("{file}:{name}"), shape, allowed)
        })
}

#[cfg(test)]
mod tests;
