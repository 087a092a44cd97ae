//! Animated pictures.

use std::path::Path;

use gif::{DisposalMethod, Encoder, Frame, Repeat};

use crate::export::{self, ExportError, Stop};
use crate::raster::{Image, Painter};
use crate::scene::Scene;

/// Maximum frames per second; faster motion is resampled.
const MOST_FPS: f64 = 20.0;
/// Index of unchanged pixels, after the colors.
const UNCHANGED: u8 = u8::MAX;
/// Number of pictures that the colors are chosen from.
const MEASURED: usize = 24;
/// Size in pixels of a single object, and of each of several objects.
const ALONE: (u32, u32) = (400, 360);
const BESIDE: (u32, u32) = (320, 340);

/// Writes a scene as an endlessly repeated GIF. Each picture contains only the changes. Delays are
/// whole hundredths of a second; their rounding errors cancel, so the total length is exact. `stop`
/// is called before each picture.
///
/// # Errors
/// The errors of [`must_be_exportable`](crate::must_be_exportable); [`ExportError::TooLong`];
/// [`ExportError::Write`];
/// [`ExportError::Interrupted`] once `stop` returns true.
pub fn write(scene: &Scene, out: &Path, stop: Stop<'_>) -> Result<(), ExportError> {
    export::check(scene, out)?;
    export::check_pictures(scene, pictures(scene), out)?;
    let encoded = encode(scene, size(scene), stop).map_err(ExportError::write(out))?;
    let bytes = encoded.ok_or_else(|| ExportError::Interrupted {
        out: out.to_path_buf(),
    })?;
    export::write(out, &bytes)
}

/// Size of a scene in pixels.
pub(crate) fn size(scene: &Scene) -> (u32, u32) {
    match scene.objects.len() as u32 {
        0 | 1 => ALONE,
        count @ 2..=3 => (count * BESIDE.0, BESIDE.1),
        count => {
            let side = (1..).find(|side| side * side >= count).unwrap_or(count);
            let rows = count.div_ceil(side).min(4);
            (side.min(4) * BESIDE.0, rows * BESIDE.1)
        }
    }
}

fn fps(scene: &Scene) -> f64 {
    (1.0 / scene.frame_seconds()).min(MOST_FPS)
}

/// Number of pictures of a scene.
fn pictures(scene: &Scene) -> usize {
    ((scene.seconds() * fps(scene) - 1e-6).ceil() as usize).max(1)
}

/// Time of each picture, and its delay in hundredths of a second.
fn timing(scene: &Scene) -> Vec<(f64, u16)> {
    let (fps, count) = (fps(scene), pictures(scene));
    let hundredths = |moment: f64| (100.0 * moment).round() as u64;
    let ends = (1..=count).map(|k| hundredths((k as f64 / fps).min(scene.seconds())));
    let starts = (0..count).map(|k| k as f64 / fps);
    let delays = starts.zip(ends).map(|(start, end)| {
        // Most programs replace delays below two hundredths of a second by a tenth.
        let delay = end.saturating_sub(hundredths(start)).max(2);
        (start, delay.min(u64::from(u16::MAX)) as u16)
    });
    delays.collect()
}

/// The file; `None` if stopped.
fn encode(
    scene: &Scene,
    size: (u32, u32),
    stop: Stop<'_>,
) -> Result<Option<Vec<u8>>, gif::EncodingError> {
    let painter = Painter::new(scene, size, 1.0);
    let timing = timing(scene);
    let (width, height) = (size.0 as u16, size.1 as u16);
    let palette = palette(&painter, &timing);
    let mut known = vec![None; 1 << 15];
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height, palette.as_flattened())?;
    encoder.set_repeat(Repeat::Infinite)?;
    let mut before: Option<Vec<u8>> = None;
    let mut waiting: Option<Frame<'static>> = None;
    for (index, &(moment, delay)) in timing.iter().enumerate() {
        if stop(index, timing.len()) {
            return Ok(None);
        }
        let now = indices(&painter.at(moment), &palette, &mut known);
        let changed = match &before {
            None => Some(picture(now.clone(), width, height)),
            Some(before) => difference(before, &now, width.into()),
        };
        match (changed, &mut waiting) {
            // An unchanged picture extends the previous picture's delay.
            (None, Some(frame)) if frame.delay.checked_add(delay).is_some() => frame.delay += delay,
            (changed, _) => {
                let mut frame = changed.unwrap_or_else(|| Frame {
                    transparent: Some(UNCHANGED),
                    ..picture(vec![UNCHANGED], 1, 1)
                });
                frame.delay = delay;
                if let Some(done) = waiting.replace(frame) {
                    encoder.write_frame(&done)?;
                }
            }
        }
        before = Some(now);
    }
    if let Some(last) = waiting {
        encoder.write_frame(&last)?;
    }
    drop(encoder);
    stop(timing.len(), timing.len());
    Ok(Some(bytes))
}

/// A picture that remains below the next picture.
fn picture(indices: Vec<u8>, width: u16, height: u16) -> Frame<'static> {
    Frame {
        width,
        height,
        buffer: indices.into(),
        dispose: DisposalMethod::Keep,
        ..Frame::default()
    }
}

/// The bounding box of all changes, if any.
fn difference(before: &[u8], now: &[u8], width: usize) -> Option<Frame<'static>> {
    let rows = || before.chunks_exact(width).zip(now.chunks_exact(width));
    let top = rows().position(|(a, b)| a != b)?;
    let bottom = rows().rposition(|(a, b)| a != b)?;
    let apart = |column: &usize| rows().any(|(a, b)| a[*column] != b[*column]);
    let left = (0..width).find(apart)?;
    let right = (0..width).rev().find(apart)?;
    let places = (top..=bottom).flat_map(|row| row * width + left..=row * width + right);
    let part = places.map(|at| match now[at] {
        value if value == before[at] => UNCHANGED,
        value => value,
    });
    let [width, height] = [right - left + 1, bottom - top + 1].map(|side| side as u16);
    Some(Frame {
        left: left as u16,
        top: top as u16,
        transparent: Some(UNCHANGED),
        ..picture(part.collect(), width, height)
    })
}

/// The most frequent colors of some pictures, at most [`UNCHANGED`].
fn palette(painter: &Painter<'_>, timing: &[(f64, u16)]) -> Vec<[u8; 3]> {
    // Number of pixels and sum of the colors of each bin.
    let mut bins = vec![(0u64, [0u64; 3]); 1 << 15];
    for (moment, _) in timing.iter().step_by(timing.len().div_ceil(MEASURED)) {
        for pixel in painter.at(*moment).rgb.chunks_exact(3) {
            let (count, sum) = &mut bins[bin(pixel)];
            *count += 1;
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += u64::from(*value);
            }
        }
    }
    bins.retain(|(count, _)| *count > 0);
    bins.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    let colors = bins.iter().take(UNCHANGED.into());
    let mut palette: Vec<[u8; 3]> = colors
        .map(|(count, sum)| sum.map(|sum| (sum / count) as u8))
        .collect();
    // All indices exist.
    palette.resize(usize::from(UNCHANGED) + 1, palette[0]);
    palette
}

/// Index of a color with five bits per channel.
fn bin(pixel: &[u8]) -> usize {
    let bits = pixel.iter().map(|value| usize::from(value >> 3));
    bits.fold(0, |at, value| at << 5 | value)
}

/// The palette index of each pixel. `known` caches the index of each [`bin`].
fn indices(image: &Image, palette: &[[u8; 3]], known: &mut [Option<u8>]) -> Vec<u8> {
    let pixels = image.rgb.chunks_exact(3);
    let indices =
        pixels.map(|pixel| *known[bin(pixel)].get_or_insert_with(|| nearest(pixel, palette)));
    indices.collect()
}

fn nearest(pixel: &[u8], palette: &[[u8; 3]]) -> u8 {
    let distance = |color: &[u8; 3]| {
        let apart = color.iter().zip(pixel).map(|(a, b)| a.abs_diff(*b));
        apart.map(|value| i32::from(value).pow(2)).sum::<i32>()
    };
    let indices = 0..UNCHANGED;
    let found = indices.min_by_key(|index| distance(&palette[usize::from(*index)]));
    found.expect("there are colors")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneObject;
    use crate::scene::tests::{body, dancer};

    fn scene(objects: Vec<SceneObject>) -> Scene {
        Scene {
            objects,
            ..Scene::default()
        }
    }

    /// The pictures of a file as a reader composes them, and their delays.
    fn decode(bytes: &[u8]) -> (Vec<Vec<[u8; 3]>>, Vec<u16>) {
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::Indexed);
        let mut decoder = options.read_info(bytes).unwrap();
        assert_eq!(decoder.repeat(), Repeat::Infinite);
        let width = usize::from(decoder.width());
        let palette = decoder.global_palette().unwrap().to_vec();
        let mut screen = vec![[0; 3]; width * usize::from(decoder.height())];
        let (mut pictures, mut delays) = (Vec::new(), Vec::new());
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            for (at, index) in frame.buffer.iter().enumerate() {
                if frame.transparent != Some(*index) {
                    let columns = usize::from(frame.width);
                    let x = usize::from(frame.left) + at % columns;
                    let y = usize::from(frame.top) + at / columns;
                    let colour = &palette[3 * usize::from(*index)..][..3];
                    screen[y * width + x] = [colour[0], colour[1], colour[2]];
                }
            }
            pictures.push(screen.clone());
            delays.push(frame.delay);
        }
        (pictures, delays)
    }

    fn encoded(scene: &Scene, size: (u32, u32)) -> Vec<u8> {
        encode(scene, size, &|_, _| false)
            .unwrap()
            .expect("not stopped")
    }

    #[test]
    fn a_slow_object_beside_a_fast_one_has_no_pictures_without_end() {
        let mut slow = body(12);
        slow.fps = 1e-7;
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.gif");
        let error = write(&scene(vec![body(12), slow]), &out, &|_, _| false).unwrap_err();
        assert!(error.to_string().contains("at most 2592000"), "{error}");
    }

    #[test]
    fn a_file_shows_each_picture_of_the_motion() {
        let scene = scene(vec![body(12)]);
        let (pictures, delays) = decode(&encoded(&scene, (120, 100)));
        assert_eq!((pictures.len(), delays), (12, vec![5; 12]));
        let painter = Painter::new(&scene, (120, 100), 1.0);
        for (frame, picture) in pictures.iter().enumerate() {
            let drawn = painter.at(frame as f64 / 20.0);
            let pixels = picture.iter().zip(drawn.rgb.chunks_exact(3));
            let far = pixels.filter(|(shown, pixel)| {
                shown.iter().zip(*pixel).any(|(a, b)| a.abs_diff(*b) > 40)
            });
            // Anti-aliased edges between two colors are far from the palette.
            let far = far.count();
            assert!(far < 120 * 100 / 50, "{far} pixels of frame {frame}");
        }
    }

    #[test]
    fn delays_add_up_to_the_length() {
        for fps in [12.0, 20.0, 24.0, 30.0, 60.0, 120.0, 29.97] {
            let mut object = dancer(137, 0.0);
            object.fps = fps;
            let scene = scene(vec![object]);
            let timing = timing(&scene);
            let total: u32 = timing.iter().map(|(_, delay)| u32::from(*delay)).sum();
            let seconds = 137.0 / fps;
            assert!((f64::from(total) / 100.0 - seconds).abs() < 0.021, "{fps}");
            let rate = timing.len() as f64 / seconds;
            assert!(
                rate <= 20.2 && rate >= fps.min(20.0) - 0.01,
                "{fps}: {rate}"
            );
        }
    }

    #[test]
    fn a_still_motion_is_one_picture() {
        let mut object = body(1);
        object.positions = object.positions.repeat(60);
        object.contacts.clear();
        let (pictures, delays) = decode(&encoded(&scene(vec![object]), (80, 80)));
        assert_eq!((pictures.len(), delays), (1, vec![300]));
    }

    #[test]
    fn thirteen_seconds_take_little_space() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.gif");
        let mut near = dancer(390, 0.0);
        for value in near.positions.iter_mut().step_by(3) {
            *value *= 0.5;
        }
        // The camera follows the second one.
        for (object, most) in [(near, 700_000), (dancer(390, 0.0), 1_500_000)] {
            write(&scene(vec![object]), &out, &|_, _| false).unwrap();
            let size = std::fs::metadata(&out).unwrap().len();
            assert!(size < most, "{size} bytes");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn nothing_is_written_without_motion() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.gif");
        let mut broken = body(2);
        broken.positions[0] = f32::NAN;
        for (objects, reason) in [
            (vec![], "there is no motion"),
            (vec![body(0)], "`body` has no frames"),
            (vec![broken], "`body` is not finite"),
        ] {
            let error = write(&scene(objects), &out, &|_, _| false)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(reason) && error.contains("dance.gif"),
                "{error}"
            );
        }
        let error = write(&scene(vec![body(2)]), &out, &|_, _| true).unwrap_err();
        assert!(matches!(error, ExportError::Interrupted { .. }), "{error}");
        let missing = folder.path().join("no/dance.gif");
        let error = write(&scene(vec![body(2)]), &missing, &|_, _| false).unwrap_err();
        assert!(error.to_string().starts_with("cannot write"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
