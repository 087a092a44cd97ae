//! Compact text for motion and curves: quantized, predicted, compressed, base64.
//!
//! A pack contains channels over the same frames. A channel is quantized to 16 bits and stored as
//! zigzag second differences, which are small for smooth motion. In a zlib stream, all low bytes
//! precede all high bytes. Browsers unpack the stream with `DecompressionStream`.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use libdeflater::{CompressionLvl, Compressor};
use serde_json::{Value, json};

/// Largest quantization error of a position along an axis, meters. Positions with a larger spread
/// are stored in single precision.
pub const POSITION_ERROR: f64 = 0.0002;

/// A step that is fine enough for positions of people, meters.
const FINE: f64 = 0.0001;

/// Fine steps divide the spread into at least this many levels.
const LEAST_LEVELS: f64 = 8192.0;

/// The level of a value that is not finite: a gap.
const GAP: u16 = u16::MAX;

/// Positions `[frames, joints, 3]` as a pack of `3 * joints` channels.
///
/// Steps are 0.1 mm up to a spread of 6.5 m and grow with the spread. If half a step would
/// exceed [`POSITION_ERROR`] (26 m), values are stored in single precision.
pub fn positions(values: &[f32], joints: usize) -> Value {
    let width = 3 * joints;
    let axis = |axis: usize| values.iter().skip(axis).step_by(3).map(|v| f64::from(*v));
    let least: [f64; 3] = [0, 1, 2].map(|a| axis(a).fold(f64::INFINITY, f64::min));
    let spreads = (0..3).map(|a| axis(a).fold(f64::NEG_INFINITY, f64::max) - least[a]);
    let spread = spreads.fold(0.0, f64::max);
    let needed = spread / f64::from(u16::MAX);
    if values.is_empty() || needed / 2.0 > POSITION_ERROR {
        let data = deflated(&planes(&by_channel(values, width)));
        return json!({ "kind": "f32", "channels": width, "data": data });
    }
    let step = needed.max(FINE.min(spread / LEAST_LEVELS)).max(1e-12);
    let level = |(index, value): (usize, &f32)| {
        ((f64::from(*value) - least[index % 3]) / step).round() as u16
    };
    let levels: Vec<u16> = values.iter().enumerate().map(level).collect();
    let data = deflated(&predicted(&by_channel(&levels, width), width));
    json!({ "kind": "u16", "channels": width, "least": least, "step": step, "data": data })
}

/// Unit quaternions, one per frame, to 1/32767.
pub fn orientations(values: &[[f32; 4]]) -> Value {
    let level = |value: &f32| ((value.clamp(-1.0, 1.0) + 1.0) * 32767.0).round() as u16;
    let levels: Vec<u16> = values.iter().flatten().map(level).collect();
    let data = deflated(&predicted(&by_channel(&levels, 4), 4));
    json!({ "kind": "u16", "channels": 4, "least": [-1.0], "step": 1.0 / 32767.0, "data": data })
}

/// Curves of `frames` values, quantized to 65534 steps between each curve's minimum and maximum.
/// Shorter curves end early; values that are not finite are gaps.
pub fn curves(series: &[&[f32]], frames: usize) -> Value {
    let mut levels = Vec::with_capacity(series.len() * frames);
    let mut ranges = Vec::with_capacity(series.len());
    for values in series {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let least = finite().fold(f32::INFINITY, f32::min);
        let most = finite().fold(f32::NEG_INFINITY, f32::max);
        let (least, most) = match least <= most {
            true => (f64::from(least), f64::from(most)),
            false => (0.0, 0.0),
        };
        let step = ((most - least) / f64::from(GAP - 1)).max(1e-30);
        ranges.push([least, step]);
        levels.extend((0..frames).map(|t| match values.get(t) {
            Some(value) if value.is_finite() => ((f64::from(*value) - least) / step).round() as u16,
            _ => GAP,
        }));
    }
    let data = deflated(&predicted(&levels, series.len()));
    json!({ "channels": series.len(), "ranges": ranges, "data": data })
}

/// Rows of `width` values in channel-major order.
fn by_channel<T: Copy>(rows: &[T], width: usize) -> Vec<T> {
    let channels = (0..width).flat_map(|channel| rows.iter().skip(channel).step_by(width));
    channels.copied().collect()
}

/// Zigzag second differences of each channel, low bytes before high bytes.
fn predicted(levels: &[u16], channels: usize) -> Vec<u8> {
    let frames = levels.len() / channels.max(1);
    let mut low = Vec::with_capacity(2 * levels.len());
    let mut high = Vec::with_capacity(levels.len());
    for channel in levels.chunks(frames.max(1)) {
        let (mut before, mut slope) = (0u16, 0u16);
        for &level in channel {
            let difference = level.wrapping_sub(before);
            let change = difference.wrapping_sub(slope) as i16;
            (before, slope) = (level, difference);
            let zigzag = ((change << 1) ^ (change >> 15)) as u16;
            low.push(zigzag as u8);
            high.push((zigzag >> 8) as u8);
        }
    }
    low.append(&mut high);
    low
}

/// First bytes of all values, then second bytes, and so on, little-endian.
fn planes(values: &[f32]) -> Vec<u8> {
    let byte = |plane: usize| values.iter().map(move |value| value.to_le_bytes()[plane]);
    (0..4).flat_map(byte).collect()
}

fn deflated(bytes: &[u8]) -> String {
    let mut compressor = Compressor::new(CompressionLvl::default());
    let mut packed = vec![0; compressor.zlib_compress_bound(bytes.len())];
    let length = compressor.zlib_compress(bytes, &mut packed);
    packed.truncate(length.expect("it fits into the bound"));
    BASE64_STANDARD.encode(packed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The levels of a pack as the page decodes them.
    fn unpacked(pack: &Value, frames: usize) -> Vec<u16> {
        let channels = pack["channels"].as_u64().unwrap() as usize;
        let packed = BASE64_STANDARD
            .decode(pack["data"].as_str().unwrap())
            .unwrap();
        let mut bytes = vec![0; 2 * channels * frames];
        libdeflater::Decompressor::new()
            .zlib_decompress(&packed, &mut bytes)
            .unwrap();
        let (low, high) = bytes.split_at(channels * frames);
        let mut levels = Vec::new();
        for channel in 0..channels {
            let (mut level, mut slope) = (0u16, 0u16);
            for at in channel * frames..(channel + 1) * frames {
                let zigzag = u16::from(low[at]) | u16::from(high[at]) << 8;
                let change = (zigzag >> 1) ^ 0u16.wrapping_sub(zigzag & 1);
                slope = slope.wrapping_add(change);
                level = level.wrapping_add(slope);
                levels.push(level);
            }
        }
        levels
    }

    #[test]
    fn positions_come_back_within_a_fifth_of_a_millimetre() {
        for spread in [0.0f32, 0.001, 1.0, 6.0, 25.0] {
            let values: Vec<f32> = (0..40 * 6)
                .map(|i| 3.0 + spread * (0.5 + 0.5 * (i as f32 * 0.7).sin()))
                .collect();
            let pack = positions(&values, 2);
            assert_eq!(pack["kind"], "u16", "{spread} m");
            let levels = unpacked(&pack, 40);
            for (index, value) in values.iter().enumerate() {
                let level = levels[(index % 6) * 40 + index / 6];
                let least = pack["least"][index % 3].as_f64().unwrap();
                let read = least + f64::from(level) * pack["step"].as_f64().unwrap();
                let off = (read - f64::from(*value)).abs();
                assert!(off <= POSITION_ERROR, "{off} m off in {spread} m");
            }
        }
        assert_eq!(
            positions(&[0.0, 0.0, 0.0, 30.0, 0.0, 0.0], 1)["kind"],
            "f32"
        );
    }

    #[test]
    fn gaps_and_short_curves_stay_gaps() {
        let pack = curves(&[&[1.0, f32::NAN, 3.0], &[f32::INFINITY]], 4);
        let levels = unpacked(&pack, 4);
        assert_eq!(levels[..4], [0, GAP, GAP - 1, GAP]);
        assert_eq!(levels[4..], [GAP; 4]);
    }
}
