//! MP3 streams: several files in a row, and tags between their frames.

use symphonia::core::packet::Packet;
use symphonia::core::units::{Duration, Timestamp};

/// Frames in a row of another format that are music; fewer are taken as bytes of a tag.
const ENOUGH: usize = 8;

/// The bits of a frame's header that stay the same in a file: version, layer and sample rate.
const CONSTANT: u32 = 0x001e_0c00;

/// The state between the frames of an MP3 stream.
pub(crate) struct Frames {
    /// End of the part whose length the first header states, in samples; later frames are of
    /// another file.
    end: Option<Timestamp>,
    /// The constant part of the first frame's header.
    constant: Option<u32>,
    is_mono: bool,
    /// Frames of another format in a row.
    foreign: usize,
}

/// The use of a frame.
#[derive(Debug, Eq, PartialEq)]
pub(crate) enum Frame {
    /// It is decoded.
    Decode,
    /// It is decoded by a new decoder, because the number of channels changes.
    Restart,
    /// It is part of a tag.
    Drop,
    /// It and the frames before it are of this sample rate, in Hz.
    OtherRate(u32),
}

impl Frames {
    /// The header of the stream states `samples` samples and `padding` samples behind them.
    pub fn new(samples: Option<u64>, padding: Option<u32>) -> Self {
        let end = samples.map(|samples| samples.saturating_add(padding.unwrap_or(0).into()));
        Self {
            end: end.map(|end| Timestamp::from(i64::try_from(end).unwrap_or(i64::MAX))),
            constant: None,
            is_mono: false,
            foreign: 0,
        }
    }

    /// Decides what happens to the next frame. Frames of a following file are not trimmed.
    pub fn next(&mut self, packet: &mut Packet) -> Frame {
        let Some(header) = packet.data.first_chunk().copied().map(u32::from_be_bytes) else {
            return Frame::Drop;
        };
        let (constant, is_mono) = (header & CONSTANT, header >> 6 & 3 == 3);
        let first = *self.constant.get_or_insert_with(|| {
            self.is_mono = is_mono;
            constant
        });
        if constant != first {
            self.foreign += 1;
            let after = rate(header);
            return match self.foreign >= ENOUGH && after != rate(first) {
                true => Frame::OtherRate(after),
                false => Frame::Drop,
            };
        }
        self.foreign = 0;
        if self.end.is_some_and(|end| packet.pts >= end) {
            packet.trim_end = Duration::ZERO;
        }
        match std::mem::replace(&mut self.is_mono, is_mono) == is_mono {
            true => Frame::Decode,
            false => Frame::Restart,
        }
    }
}

/// The sample rate that a frame's header states, in Hz.
fn rate(header: u32) -> u32 {
    let full = [44_100, 48_000, 32_000, 0][(header >> 10 & 3) as usize];
    match header >> 19 & 3 {
        3 => full,
        2 => full / 2,
        _ => full / 4,
    }
}
