//! Errors about an audio file or its samples.

use std::io;

use miette::Diagnostic;
use thiserror::Error;

/// Errors of decoding and analysis.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum Error {
    /// A file cannot be decoded.
    #[error("{file}: {error}")]
    #[diagnostic(forward(error))]
    Decode {
        /// The path, or the name of a reader.
        file: String,
        /// The reason.
        error: DecodeError,
    },

    /// Out of memory for the features.
    #[error(
        "the features of {minutes:.0} minutes need {mebibytes} MiB of memory, and there is less"
    )]
    #[diagnostic(help("cut the song into pieces, or free memory"))]
    AnalysisMemory {
        /// Length of the signal.
        minutes: f64,
        /// Memory needed in addition to the samples.
        mebibytes: u64,
    },

    /// A sample for analysis is not finite or far beyond full scale.
    #[error("sample {index} is {found}, -1 to 1 is full scale")]
    #[diagnostic(help("scale the samples to full scale 1 and repair those that are not finite"))]
    Sample {
        /// Position, counted from 0.
        index: usize,
        /// The value.
        found: f32,
    },
}

/// Reasons why a file cannot be decoded.
#[derive(Clone, Debug, Diagnostic, Error, PartialEq)]
pub enum DecodeError {
    /// The file could not be opened or read.
    #[error("cannot be read: {reason}")]
    #[diagnostic(help("check that the file exists and that you may read it"))]
    Read {
        /// Reason from the operating system.
        reason: String,
    },

    /// The file has no bytes.
    #[error("the file is empty")]
    #[diagnostic(help("copy or download it again"))]
    Empty,

    /// The format of the file is unknown.
    #[error("no known audio format: {reason}")]
    #[diagnostic(help(
        "MP3, WAV (PCM), FLAC and Ogg Vorbis can be read: convert the file to one, or copy it again if \
         it is one and was cut off"
    ))]
    UnknownFormat {
        /// Reason from the reader.
        reason: String,
    },

    /// A WAV file stores numbers in big-endian order.
    #[error("a WAV file in big-endian order (RIFX), which is not read")]
    #[diagnostic(help("convert it: `ffmpeg -i OLD.wav NEW.wav` writes little-endian order"))]
    BigEndian,

    /// The number of channels of a WAV file is out of range.
    #[error("{found} channels found, 1 to {most} allowed")]
    #[diagnostic(help("mix them down to two, or export the file again with fewer"))]
    Channels {
        /// The number found.
        found: u16,
        /// Largest allowed.
        most: u16,
    },

    /// The file contains no audio track.
    #[error("no audio track found")]
    #[diagnostic(help("name a file with music in it"))]
    NoAudioTrack,

    /// The codec of the audio track is not supported.
    #[error("the audio track cannot be decoded: {reason}")]
    #[diagnostic(help(
        "PCM, FLAC, MP3 and Vorbis can be decoded: convert the file to WAV, FLAC, MP3 or Ogg"
    ))]
    UnsupportedCodec {
        /// Reason from the decoder.
        reason: String,
    },

    /// The file is damaged.
    #[error("damaged at second {second:.2}: {reason}")]
    #[diagnostic(help("the file is damaged or was cut off: copy or export it again"))]
    Corrupt {
        /// Seconds decoded so far.
        second: f64,
        /// Reason from the reader or decoder.
        reason: String,
    },

    /// The file contains no decodable packet.
    #[error("nothing could be decoded; {skipped_packets} damaged packets found")]
    #[diagnostic(help("the file is damaged or was cut off: copy or export it again"))]
    NothingDecoded {
        /// Packets that could not be decoded.
        skipped_packets: usize,
    },

    /// The sample rate is out of range.
    #[error("a sample rate of {found} Hz found, {lowest} to {highest} Hz allowed")]
    #[diagnostic(help("convert the file to 44100 Hz"))]
    SampleRate {
        /// The sample rate found.
        found: u32,
        /// Smallest allowed.
        lowest: u32,
        /// Largest allowed.
        highest: u32,
    },

    /// The sample rate changes inside the file.
    #[error("the sample rate changes from {before} to {after} Hz at second {second:.2}")]
    #[diagnostic(help("the file seems to be several files in a row: split or convert it"))]
    RateChanges {
        /// Seconds decoded so far.
        second: f64,
        /// Rate at the beginning, in Hz.
        before: u32,
        /// Rate from here on, in Hz.
        after: u32,
    },

    /// The file is too long.
    #[error("longer than {hours} hours or {samples} samples")]
    #[diagnostic(help("cut it into pieces: features are normalised over one whole file"))]
    TooLong {
        /// Largest length allowed, in hours.
        hours: u64,
        /// Most samples of one channel allowed.
        samples: u64,
    },

    /// Out of memory for the samples.
    #[error("memory is full after second {second:.0}")]
    #[diagnostic(help(
        "a minute takes 10 MiB, and its features 8: cut the file into pieces, or free memory"
    ))]
    Memory {
        /// Seconds decoded so far.
        second: f64,
    },

    /// A decoded sample is not finite or far beyond full scale.
    #[error("the sample {found} found at second {second:.2}, -1 to 1 is full scale")]
    #[diagnostic(help("export the file again as 16-bit PCM or as float between -1 and 1"))]
    DecodedSample {
        /// Time in seconds.
        second: f64,
        /// The value.
        found: f32,
    },
}

impl From<io::Error> for DecodeError {
    fn from(error: io::Error) -> Self {
        Self::Read {
            reason: error.to_string(),
        }
    }
}
