//! The bytes that a format reader gets: a file, or the samples of a WAV file behind a plain header.

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;

use symphonia::core::io::MediaSource;

use crate::DecodeError;
use crate::riff::Wav;

/// A reader whose length is known.
pub(crate) struct Source<R> {
    reader: R,
    /// Bytes before those of the reader.
    header: Vec<u8>,
    /// The part of the reader.
    part: Range<u64>,
    position: u64,
    is_seekable: bool,
    /// True if the file does not state its length.
    pub is_length_unknown: bool,
}

impl<R: Read + Seek> Source<R> {
    /// # Errors
    /// As of the reader; for WAV files that cannot be read.
    pub fn new(mut reader: R) -> Result<Self, DecodeError> {
        let bytes = reader.seek(SeekFrom::End(0))?;
        let wav = Wav::find(&mut reader, bytes)?.unwrap_or(Wav {
            header: Vec::new(),
            samples: 0..bytes,
            is_length_unknown: false,
        });
        let mut source = Self {
            reader,
            header: wav.header,
            part: wav.samples,
            position: 0,
            is_seekable: true,
            is_length_unknown: wav.is_length_unknown,
        };
        source.rewind()?;
        Ok(source)
    }

    /// Starts again, as a stream that cannot be sought in.
    ///
    /// # Errors
    /// As of the reader.
    pub fn restart_as_stream(&mut self) -> io::Result<()> {
        self.is_seekable = false;
        self.rewind()
    }
}

impl<R> Source<R> {
    /// Number of bytes.
    pub fn length(&self) -> u64 {
        self.header.len() as u64 + (self.part.end - self.part.start)
    }
}

impl<R: Read> Read for Source<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let header = usize::try_from(self.position).ok();
        let read = match header.and_then(|start| self.header.get(start..)) {
            Some(mut header) if !header.is_empty() => header.read(buffer)?,
            _ => {
                let left = self.length().saturating_sub(self.position);
                self.reader.by_ref().take(left).read(buffer)?
            }
        };
        self.position += read as u64;
        Ok(read)
    }
}

impl<R: Seek> Seek for Source<R> {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        let position = match position {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.length().checked_add_signed(by),
        };
        let position = position.ok_or(ErrorKind::InvalidInput)?;
        let inside = position.saturating_sub(self.header.len() as u64);
        let place = self.part.start.saturating_add(inside);
        self.reader.seek(SeekFrom::Start(place))?;
        self.position = position;
        Ok(position)
    }
}

impl<R: Read + Seek + Send + Sync> MediaSource for &mut Source<R> {
    fn is_seekable(&self) -> bool {
        self.is_seekable
    }

    fn byte_len(&self) -> Option<u64> {
        Some(self.length())
    }
}
