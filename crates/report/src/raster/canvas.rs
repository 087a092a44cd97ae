//! Pictures, and anti-aliased strokes and shapes on them.

/// A picture in memory.
#[derive(Clone, Debug, Eq, PartialEq)]
pub(crate) struct Image {
    pub width: u32,
    pub height: u32,
    /// Red, green and blue of each pixel, row by row from the top, `[height, width, 3]`.
    pub rgb: Vec<u8>,
}

impl Image {
    /// A picture of one color.
    pub(crate) fn filled(width: u32, height: u32, colour: [u8; 3]) -> Self {
        let rgb = colour.repeat(width as usize * height as usize);
        Self { width, height, rgb }
    }

    /// The picture as a PNG file.
    pub fn png(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let writer = encoder.write_header();
        let written = writer.and_then(|mut writer| writer.write_image_data(&self.rgb));
        written.expect("written to memory");
        bytes
    }

    /// Copies a picture to `(x, y)`; it must lie within.
    pub(crate) fn paste(&mut self, part: &Self, (x, y): (u32, u32)) {
        let row = 3 * part.width as usize;
        for (line, pixels) in part.rgb.chunks_exact(row).enumerate() {
            let to = 3 * ((y as usize + line) * self.width as usize + x as usize);
            self.rgb[to..to + row].copy_from_slice(pixels);
        }
    }

    /// Blends a color into a pixel.
    fn blend(&mut self, x: i32, y: i32, colour: [u8; 3], coverage: f32) {
        let at = 3 * (y as usize * self.width as usize + x as usize);
        for (value, new) in self.rgb[at..at + 3].iter_mut().zip(colour) {
            let mixed = f32::from(*value) + (f32::from(new) - f32::from(*value)) * coverage;
            *value = mixed.round() as u8;
        }
    }

    /// A line with round caps between `ends`, in pixels, with half widths `radii` at its ends.
    pub(super) fn stroke(&mut self, ends: [[f32; 2]; 2], radii: [f32; 2], colour: [u8; 3]) {
        let [a, b] = ends;
        let finite = ends.as_flattened().iter().chain(&radii);
        if !finite.copied().all(f32::is_finite) {
            return;
        }
        // Iterates along the longer axis, so that few pixels beside the line are visited.
        let main = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let cross = 1 - main;
        let sizes = [self.width as f32, self.height as f32];
        let reach = radii[0].max(radii[1]) + 1.0;
        let along = b[main] - a[main];
        let slope = match along.abs() > 1e-6 {
            true => (b[cross] - a[cross]) / along,
            false => 0.0,
        };
        let beside = reach * (1.0 + slope * slope).sqrt() + 1.0;
        let first = (a[main].min(b[main]) - reach).floor().max(0.0);
        let last = (a[main].max(b[main]) + reach).ceil().min(sizes[main] - 1.0);
        let mut step = first;
        while step <= last {
            let centre = a[cross] + slope * (step + 0.5 - a[main]);
            // A thick cap extends beyond the end of the line.
            let from = (centre - beside).floor().max(0.0);
            let to = (centre + beside).ceil().min(sizes[cross] - 1.0);
            let mut other = from;
            while other <= to {
                let mut pixel = [0.0; 2];
                pixel[main] = step + 0.5;
                pixel[cross] = other + 0.5;
                let coverage = cover(pixel, ends, radii);
                if coverage > 0.0 {
                    let [x, y] = pixel.map(|value| value as i32);
                    self.blend(x, y, colour, coverage);
                }
                other += 1.0;
            }
            step += 1.0;
        }
    }

    /// A convex polygon in either orientation, in pixels.
    pub(super) fn convex(&mut self, corners: &[[f32; 2]], colour: [u8; 3]) {
        if !corners.as_flattened().iter().copied().all(f32::is_finite) {
            return;
        }
        let area: f32 = edges(corners).map(|[a, b]| a[0] * b[1] - a[1] * b[0]).sum();
        let turn = area.signum();
        let bound = |axis: usize, size: u32| {
            let values = || corners.iter().map(|corner| corner[axis]);
            let low = values().fold(f32::INFINITY, f32::min);
            let high = values().fold(f32::NEG_INFINITY, f32::max);
            let low = (low - 1.0).floor().max(0.0) as i32;
            (low, (high + 1.0).ceil().min(size as f32 - 1.0) as i32)
        };
        let (left, right) = bound(0, self.width);
        let (top, bottom) = bound(1, self.height);
        for y in top..=bottom {
            for x in left..=right {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let inside = edges(corners).map(|[a, b]| {
                    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                    let length = dx.hypot(dy).max(1e-6);
                    turn * (dx * (py - a[1]) - dy * (px - a[0])) / length
                });
                let coverage = (inside.fold(f32::INFINITY, f32::min) + 0.5).clamp(0.0, 1.0);
                if coverage > 0.0 {
                    self.blend(x, y, colour, coverage);
                }
            }
        }
    }
}

/// The edges of a polygon.
fn edges(corners: &[[f32; 2]]) -> impl Iterator<Item = [[f32; 2]; 2]> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(a, b)| [*a, *b])
}

/// Coverage of a pixel by a stroke, 0 to 1.
fn cover(pixel: [f32; 2], [a, b]: [[f32; 2]; 2], radii: [f32; 2]) -> f32 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let (px, py) = (pixel[0] - a[0], pixel[1] - a[1]);
    let square = dx * dx + dy * dy;
    let part = match square > 1e-12 {
        true => ((px * dx + py * dy) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    let distance = (px - part * dx).hypot(py - part * dy);
    let radius = radii[0] + (radii[1] - radii[0]) * part;
    // A line thinner than a pixel is fainter, not narrower.
    (radius - distance + 0.5).clamp(0.0, (2.0 * radius).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: [u8; 3] = [0; 3];

    /// Total coverage in pixels.
    fn ink(image: &Image) -> f32 {
        let values = image.rgb.iter().step_by(3);
        values.map(|value| 1.0 - f32::from(*value) / 255.0).sum()
    }

    #[test]
    fn strokes_have_the_area_of_a_line_with_round_ends() {
        for angle in 0..24 {
            let (sin, cos) = (angle as f32 * std::f32::consts::TAU / 24.0).sin_cos();
            let mut image = Image::filled(100, 100, [255; 3]);
            let ends = [[50.0, 50.0], [50.0 + 30.0 * cos, 50.0 + 30.0 * sin]];
            image.stroke(ends, [4.0, 4.0], BLACK);
            let expected = 30.0 * 8.0 + std::f32::consts::PI * 16.0;
            let found = ink(&image);
            assert!(
                (found - expected).abs() < 4.0,
                "{angle}: {found} of {expected}"
            );
        }
    }

    #[test]
    fn shapes_have_their_area_in_either_direction() {
        let mut square = vec![[10.5, 10.5], [30.0, 10.5], [30.0, 40.0], [10.5, 40.0]];
        for _ in 0..2 {
            let mut image = Image::filled(64, 64, [255; 3]);
            image.convex(&square, BLACK);
            let found = ink(&image);
            assert!((found - 19.5 * 29.5).abs() < 3.0, "{found}");
            square.reverse();
        }
    }

    #[test]
    fn shapes_outside_are_clipped() {
        let mut image = Image::filled(16, 16, [255; 3]);
        image.stroke([[-50.0, -9.0], [-20.0, 500.0]], [3.0, 9.0], BLACK);
        image.stroke([[f32::NAN, 0.0], [3.0, 3.0]], [3.0, 9.0], BLACK);
        let triangle = [[100.0, 100.0], [120.0, 100.0], [120.0, 130.0]];
        image.convex(&triangle, BLACK);
        assert_eq!(ink(&image), 0.0);
        image.stroke([[-1e9, 8.0], [1e9, 8.0]], [1.0, 1.0], BLACK);
        assert!((ink(&image) - 32.0).abs() < 1.0);
    }
}
