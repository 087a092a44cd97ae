//! Decodes an audio file to mono samples at [`SAMPLE_RATE`](crate::SAMPLE_RATE).

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::Path;

use symphonia::core::audio::GenericAudioBufferRef;
use symphonia::core::codecs::audio::{AudioCodecParameters, AudioDecoder, AudioDecoderOptions};
use symphonia::core::errors::Error as StreamError;
use symphonia::core::formats::probe::Hint;
use symphonia::core::formats::well_known::FORMAT_ID_MP3;
use symphonia::core::formats::{FormatOptions, FormatReader, Track, TrackType};
use symphonia::core::io::{MediaSource, MediaSourceStream};
use symphonia::core::meta::MetadataOptions;
use symphonia::core::packet::Packet;

use crate::analysis::unusable_sample;
use crate::guard::guarded;
use crate::mpeg::{Frame, Frames};
use crate::resample::Resampling;
use crate::source::Source;
use crate::{DecodeError, Error};

/// Longest recording.
pub const MAX_HOURS: u64 = 2;

/// Most samples of one channel.
pub const MAX_SAMPLES: u64 = 1 << 30;

/// Lowest sample rate, in Hz.
pub const LOWEST_RATE: u32 = 4000;

/// Highest sample rate, in Hz.
pub const HIGHEST_RATE: u32 = 768_000;

/// Fewest missing seconds that [`Waveform::damage`] reports. The headers of some encoders count a
/// frame too many.
const NOTICED_SECONDS: f64 = 0.1;

/// A decoded recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Waveform {
    /// Mono samples at [`SAMPLE_RATE`](crate::SAMPLE_RATE), full scale 1.
    pub samples: Vec<f32>,
    /// Samples per second in the file.
    pub source_rate: u32,
    /// Channels in the file, averaged.
    pub source_channels: usize,
    /// Damaged packets, replaced by silence of the same length. A damaged part without packets, as
    /// in MP3, is lost, and the music after the damaged part is early.
    pub skipped_packets: usize,
    /// Seconds missing relative to the file's headers; 0 if the headers state no length.
    pub missing_seconds: f64,
    /// True if the writer of a WAV file never stated its length, as in a recording that was broken
    /// off or a file written into a pipe. All of the file is decoded.
    pub is_length_unknown: bool,
}

impl Waveform {
    /// A remark about how the recording was read.
    pub fn note(&self) -> Option<&'static str> {
        let note = "its header states no length, as of a recording that was broken off or written into \
                    a pipe: it was read to the end of the file";
        self.is_length_unknown.then_some(note)
    }

    /// A description of lost parts of the recording.
    pub fn damage(&self) -> Option<String> {
        let packets = (self.skipped_packets > 0)
            .then(|| format!("{} damaged packets were skipped", self.skipped_packets));
        let missing = (self.missing_seconds > NOTICED_SECONDS).then(|| {
            format!(
                "it is {:.2} s shorter than its headers state: it was cut off, or parts of it are \
                 lost and the music after them is early",
                self.missing_seconds
            )
        });
        let parts: Vec<String> = packets.into_iter().chain(missing).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

/// Decodes an MP3, WAV, FLAC or Ogg Vorbis file: channels averaged, encoder delay and padding
/// removed, resampled to [`SAMPLE_RATE`](crate::SAMPLE_RATE).
///
/// # Errors
/// [`Error::Decode`].
pub fn decode(path: &Path) -> Result<Waveform, Error> {
    let extension = path.extension().and_then(OsStr::to_str);
    let decoded = open(path).and_then(|file| decode_source(file, extension));
    decoded.map_err(|error| Error::Decode {
        file: path.display().to_string(),
        error,
    })
}

/// [`decode()`] from any reader. `extension` is a hint for the format; errors name the file `name`.
///
/// # Errors
/// As [`decode()`].
pub fn decode_reader(
    reader: impl Read + Seek + Send + Sync,
    extension: Option<&str>,
    name: &str,
) -> Result<Waveform, Error> {
    decode_source(reader, extension).map_err(|error| Error::Decode {
        file: name.to_owned(),
        error,
    })
}

fn open(path: &Path) -> Result<File, DecodeError> {
    // Opening a pipe would wait for a writer, and a device may never end.
    if path.metadata().is_ok_and(|found| !found.is_file()) {
        return Err(DecodeError::Read {
            reason: "it is not a file".to_owned(),
        });
    }
    Ok(File::open(path)?)
}

fn decode_source(
    reader: impl Read + Seek + Send + Sync,
    extension: Option<&str>,
) -> Result<Waveform, DecodeError> {
    let mut source = Source::new(reader)?;
    if source.length() == 0 {
        return Err(DecodeError::Empty);
    }
    let mut mono = Mono::default();
    // The format readers can panic on forged headers.
    let read = guarded(|| mono.read(&mut source, extension));
    read.unwrap_or_else(|| Err(mono.corrupt("its sizes contradict each other")))?;
    Ok(Waveform {
        source_rate: mono.rate,
        source_channels: mono.channels,
        skipped_packets: mono.skipped_packets,
        missing_seconds: mono.missing_seconds(),
        is_length_unknown: source.is_length_unknown,
        samples: mono.signal.map_or_else(Vec::new, Resampling::finish),
    })
}

/// Detects the format.
fn open_format<'s>(
    source: impl MediaSource + 's,
    extension: Option<&str>,
) -> Result<Box<dyn FormatReader + 's>, DecodeError> {
    let mut hint = Hint::new();
    if let Some(extension) = extension {
        hint.with_extension(extension);
    }
    symphonia::default::get_probe()
        .probe(
            &hint,
            MediaSourceStream::new(Box::new(source), Default::default()),
            FormatOptions::default(),
            MetadataOptions::default(),
        )
        .map_err(|e| match e {
            // The readers load tags of any length into memory.
            StreamError::IoError(e) if e.kind() == io::ErrorKind::OutOfMemory => {
                DecodeError::Memory { second: 0.0 }
            }
            e => DecodeError::UnknownFormat {
                reason: e.to_string(),
            },
        })
}

/// The first audio track with a known codec, and its parameters.
fn open_track(format: &dyn FormatReader) -> Result<(&Track, AudioCodecParameters), DecodeError> {
    let track = format
        .default_track(TrackType::Audio)
        .ok_or(DecodeError::NoAudioTrack)?;
    let parameters = track
        .codec_params
        .as_ref()
        .and_then(|parameters| parameters.audio())
        .ok_or(DecodeError::NoAudioTrack)?;
    if let Some(rate) = parameters.sample_rate {
        check_rate(rate)?;
    }
    Ok((track, parameters.clone()))
}

fn decoder(parameters: &AudioCodecParameters) -> Result<Box<dyn AudioDecoder>, DecodeError> {
    symphonia::default::get_codecs()
        .make_audio_decoder(parameters, &AudioDecoderOptions::default())
        .map_err(|e| DecodeError::UnsupportedCodec {
            reason: e.to_string(),
        })
}

fn check_rate(rate: u32) -> Result<(), DecodeError> {
    if (LOWEST_RATE..=HIGHEST_RATE).contains(&rate) {
        return Ok(());
    }
    Err(DecodeError::SampleRate {
        found: rate,
        lowest: LOWEST_RATE,
        highest: HIGHEST_RATE,
    })
}

/// Averages the channels of packets.
#[derive(Default)]
struct Mono {
    /// Samples per second, 0 before the first packet.
    rate: u32,
    channels: usize,
    skipped_packets: usize,
    /// Length in samples stated by the headers.
    promised: Option<u64>,
    /// The signal so far, from the first packet on.
    signal: Option<Resampling>,
    /// Samples of the current packet.
    mono: Vec<f32>,
    interleaved: Vec<f32>,
}

impl Mono {
    /// Reads the audio track to its end.
    fn read(
        &mut self,
        source: &mut Source<impl Read + Seek + Send + Sync>,
        extension: Option<&str>,
    ) -> Result<(), DecodeError> {
        let mut format = open_format(&mut *source, extension)?;
        let is_mp3 = format.format_info().format == FORMAT_ID_MP3;
        if is_mp3 {
            // Where it can seek, the reader estimates a length and cuts the music there.
            drop(format);
            source.restart_as_stream()?;
            format = open_format(source, extension)?;
        }
        let (track, parameters) = open_track(format.as_ref())?;
        let mut decoder = self::decoder(&parameters)?;
        self.promised = track.num_frames;
        let mut frames = is_mp3.then(|| Frames::new(track.num_frames, track.padding));
        let track = track.id;
        loop {
            let mut packet = match format.next_packet() {
                Ok(Some(packet)) => packet,
                Ok(None) => break,
                Err(StreamError::IoError(e)) if e.kind() == io::ErrorKind::UnexpectedEof => {
                    self.skipped_packets += usize::from(!self.is_endless());
                    break;
                }
                Err(e) => return Err(self.corrupt(e)),
            };
            if packet.track_id != track {
                continue;
            }
            let frame = frames.as_mut().map(|frames| frames.next(&mut packet));
            match frame.unwrap_or(Frame::Decode) {
                Frame::Decode => {}
                Frame::Restart => decoder = self::decoder(&parameters)?,
                Frame::Drop => continue,
                Frame::OtherRate(after) => return Err(self.other_rate(after)),
            }
            match decoder.decode(&packet) {
                Ok(decoded) => self.append(&decoded)?,
                Err(StreamError::DecodeError(_) | StreamError::IoError(_)) => self.skip(&packet)?,
                Err(e) => return Err(self.corrupt(e)),
            }
        }
        if self.rate == 0 {
            return Err(DecodeError::NothingDecoded {
                skipped_packets: self.skipped_packets,
            });
        }
        Ok(())
    }

    fn append(&mut self, decoded: &GenericAudioBufferRef<'_>) -> Result<(), DecodeError> {
        let (rate, channels) = (decoded.spec().rate(), decoded.num_planes());
        if channels == 0 {
            return Ok(());
        }
        if self.rate == 0 {
            check_rate(rate)?;
            (self.rate, self.channels) = (rate, channels);
        } else if self.rate != rate {
            return Err(self.other_rate(rate));
        }
        let start = self.received();
        self.check_length(decoded.frames())?;
        decoded.copy_to_vec_interleaved(&mut self.interleaved);
        let share = 1.0 / channels as f32;
        let frames = self.interleaved.chunks_exact(channels);
        self.mono.clear();
        self.mono
            .extend(frames.map(|frame| frame.iter().sum::<f32>() * share));
        if let Some(offset) = unusable_sample(&self.mono) {
            return Err(DecodeError::DecodedSample {
                second: (start + offset as u64) as f64 / f64::from(rate),
                found: self.mono[offset],
            });
        }
        let signal = self.signal.get_or_insert_with(|| Resampling::new(rate));
        if signal.reserve(self.mono.len()).is_err() {
            return Err(self.out_of_memory());
        }
        signal.push(&self.mono);
        Ok(())
    }

    /// Checks the limit of samples.
    fn check_length(&self, more: usize) -> Result<(), DecodeError> {
        let most = MAX_SAMPLES.min(MAX_HOURS * 3600 * u64::from(self.rate));
        match self.received() + more as u64 > most {
            true => Err(DecodeError::TooLong {
                hours: MAX_HOURS,
                samples: MAX_SAMPLES,
            }),
            false => Ok(()),
        }
    }

    /// Replaces a damaged packet by silence, so that later packets keep their time. Damaged packets
    /// before the first good packet are dropped.
    fn skip(&mut self, packet: &Packet) -> Result<(), DecodeError> {
        self.skipped_packets += 1;
        // All supported formats count packets in samples. A forged duration adds at most a second.
        let silence = packet.dur.get().min(u64::from(self.rate)) as usize;
        self.check_length(silence)?;
        if let Some(signal) = &mut self.signal {
            if signal.reserve(silence).is_err() {
                return Err(self.out_of_memory());
            }
            signal.push(&vec![0.0; silence]);
        }
        Ok(())
    }

    fn other_rate(&self, after: u32) -> DecodeError {
        DecodeError::RateChanges {
            second: self.seconds(),
            before: self.rate,
            after,
        }
    }

    fn out_of_memory(&self) -> DecodeError {
        DecodeError::Memory {
            second: self.seconds(),
        }
    }

    fn corrupt(&self, reason: impl ToString) -> DecodeError {
        DecodeError::Corrupt {
            second: self.seconds(),
            reason: reason.to_string(),
        }
    }

    /// True if the headers state no length or an impossible length, as in a file written into a
    /// pipe.
    fn is_endless(&self) -> bool {
        let most = MAX_HOURS * 3600 * u64::from(self.rate.max(1));
        self.promised.is_none_or(|promised| promised > most)
    }

    /// See [`Waveform::missing_seconds`].
    fn missing_seconds(&self) -> f64 {
        let promised = self.promised.filter(|_| !self.is_endless());
        let missing = promised.map_or(0, |p| p.saturating_sub(self.received()));
        missing as f64 / f64::from(self.rate.max(1))
    }

    /// Samples decoded so far.
    fn received(&self) -> u64 {
        self.signal.as_ref().map_or(0, Resampling::received)
    }

    fn seconds(&self) -> f64 {
        self.received() as f64 / f64::from(self.rate.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_high_rate_makes_no_room_for_more_samples() {
        // Two hours would be 4.7e9 samples.
        let mut song = Mono {
            rate: 655_350,
            ..Mono::default()
        };
        song.check_length(MAX_SAMPLES as usize)
            .expect("as many as are read");
        let error = song
            .check_length(MAX_SAMPLES as usize + 1)
            .expect_err("one more");
        assert!(error.to_string().contains("1073741824 samples"), "{error}");
        song.rate = 44_100;
        song.check_length(2 * 3600 * 44_100).expect("two hours");
        song.check_length(2 * 3600 * 44_100 + 1)
            .expect_err("longer");
    }
}
