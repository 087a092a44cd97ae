//! The font of pictures, and bitmaps with its letters and smooth lines.

use std::sync::OnceLock;

use ab_glyph::{Font, FontRef, GlyphId, ScaleFont, point};
use plotters::backend::BitMapBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{FontStyle, register_font};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
};
use tiny_skia::{FillRule, LineJoin, Mask, PathBuilder, Stroke, Transform};

/// Registers a built-in font, so that pictures are equal on every machine. Repeated calls are
/// harmless.
pub(crate) fn register() {
    let font = epaint_default_fonts::UBUNTU_LIGHT;
    let registered = register_font("sans-serif", FontStyle::Normal, font);
    debug_assert!(registered.is_ok(), "the built-in font is one");
}

/// The font.
pub(crate) fn font() -> &'static FontRef<'static> {
    static FONT: OnceLock<FontRef<'static>> = OnceLock::new();
    FONT.get_or_init(|| {
        let font = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT);
        font.expect("the built-in font is one")
    })
}

/// Pixels of a unit of the font's outlines.
pub(crate) fn pixels_per_unit(size: f32) -> f32 {
    size / font().height_unscaled()
}

/// The glyphs of a line of text, and where each starts, pixels from the left.
pub(crate) fn line(text: &str, size: f32) -> Vec<(GlyphId, f32)> {
    let scaled = font().as_scaled(size);
    let mut before = None;
    let mut width = 0.0;
    let glyphs = text.chars().map(|letter| {
        let glyph = scaled.glyph_id(letter);
        width += before.map_or(0.0, |before| scaled.kern(before, glyph));
        let start = width;
        width += scaled.h_advance(glyph);
        before = Some(glyph);
        (glyph, start)
    });
    glyphs.collect()
}

/// Width of a line of text in pixels.
pub(crate) fn width(text: &str, size: f32) -> f32 {
    let end = line(text, size).pop();
    end.map_or(0.0, |(glyph, start)| {
        start + font().as_scaled(size).h_advance(glyph)
    })
}

/// The text, shortened with dots if it is wider than `most` pixels.
pub(crate) fn fitting(text: &str, size: f32, most: f32) -> String {
    let mut shown = text.to_owned();
    let mut kept = text.to_owned();
    while width(&shown, size) > most && kept.pop().is_some() {
        shown = format!("{}…", kept.trim_end());
    }
    shown
}

/// A bitmap with smooth lines, whose letters start at fractions of a pixel, after their own space.
/// Lines of plotters have gaps and spikes; it rounds the position of each letter down and omits that
/// space.
pub(crate) struct Bitmap<'a>(pub BitMapBackend<'a>);

type Outcome = Result<(), DrawingErrorKind<<BitMapBackend<'static> as DrawingBackend>::ErrorType>>;

impl DrawingBackend for Bitmap<'_> {
    type ErrorType = <BitMapBackend<'static> as DrawingBackend>::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        self.0.get_size()
    }

    fn ensure_prepared(&mut self) -> Outcome {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Outcome {
        self.0.present()
    }

    fn draw_pixel(&mut self, at: BackendCoord, color: BackendColor) -> Outcome {
        self.0.draw_pixel(at, color)
    }

    fn draw_line<S: BackendStyle>(
        &mut self,
        a: BackendCoord,
        b: BackendCoord,
        style: &S,
    ) -> Outcome {
        self.0.draw_line(a, b, style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        a: BackendCoord,
        b: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Outcome {
        self.0.draw_rect(a, b, style, fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Outcome {
        let mut builder = PathBuilder::new();
        for (x, y) in path {
            // The middle of the pixel.
            let [x, y] = [x, y].map(|value| value as f32 + 0.5);
            match builder.is_empty() {
                true => builder.move_to(x, y),
                false => builder.line_to(x, y),
            }
        }
        let stroke = Stroke {
            width: style.stroke_width() as f32,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        let outline = builder.finish().and_then(|path| path.stroke(&stroke, 1.0));
        let (width, height) = self.get_size();
        let (Some(outline), Some(mut mask)) = (outline, Mask::new(width, height)) else {
            return Ok(());
        };
        mask.fill_path(&outline, FillRule::Winding, true, Transform::identity());
        let color = style.color();
        for (at, coverage) in mask
            .data()
            .iter()
            .enumerate()
            .filter(|(_, covered)| **covered > 0)
        {
            let alpha = color.alpha * f64::from(*coverage) / 255.0;
            let place = ((at % width as usize) as i32, (at / width as usize) as i32);
            self.draw_pixel(place, BackendColor { alpha, ..color })?;
        }
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        at: BackendCoord,
    ) -> Outcome {
        let size = style.size() as f32;
        let width = width(text, size);
        let left = at.0 as f32
            - match style.anchor().h_pos {
                HPos::Left => 0.0,
                HPos::Right => width,
                HPos::Center => width / 2.0,
            };
        // As SVG pictures have it, in parts of the size.
        let below = match style.anchor().v_pos {
            VPos::Top => 0.61,
            VPos::Center => 0.21,
            VPos::Bottom => -0.21,
        };
        let baseline = (at.1 as f32 + below * size).round();
        let color = style.color();
        for (glyph, start) in line(text, size) {
            let glyph = glyph.with_scale_and_position(size, point(left + start, baseline));
            let Some(outline) = font().outline_glyph(glyph) else {
                continue;
            };
            let corner = outline.px_bounds().min;
            let mut pixels = Vec::new();
            outline.draw(|x, y, coverage| pixels.push((x, y, coverage)));
            for (x, y, coverage) in pixels {
                let alpha = color.alpha * f64::from(coverage.min(1.0));
                let place = (corner.x as i32 + x as i32, corner.y as i32 + y as i32);
                self.draw_pixel(place, BackendColor { alpha, ..color })?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use plotters::prelude::*;
    use plotters::style::text_anchor::Pos;

    use super::*;

    /// Centres of the letters of a text whose letters do not touch, pixels.
    fn centres(text: &str, size: i32) -> Vec<f32> {
        register();
        let (width, height) = (200, 40);
        let mut rgb = vec![255; 3 * width * height];
        let bitmap = BitMapBackend::with_buffer(&mut rgb, (width as u32, height as u32));
        let area = Bitmap(bitmap).into_drawing_area();
        let style = TextStyle::from(("sans-serif", size).into_font());
        let style = style.pos(Pos::new(HPos::Left, VPos::Top));
        area.draw(&Text::new(text.to_string(), (10, 10), style))
            .unwrap();
        drop(area);
        let ink = |x: usize| -> f32 {
            let rows = (0..height).map(|y| 255.0 - f32::from(rgb[3 * (y * width + x)]));
            rows.sum()
        };
        let columns: Vec<f32> = (0..width).map(ink).collect();
        let mut found = Vec::new();
        let (mut sum, mut moment) = (0.0, 0.0);
        for (x, ink) in columns.iter().enumerate() {
            sum += ink;
            moment += (x as f32 + 0.5) * ink;
            if *ink == 0.0 && sum > 0.0 {
                found.push(moment / sum);
                (sum, moment) = (0.0, 0.0);
            }
        }
        found
    }

    #[test]
    fn letters_are_as_far_apart_as_the_font_has_them() {
        for size in [11, 13, 14, 16] {
            let scaled = font().as_scaled(size as f32);
            let wide = |letter: char| scaled.h_advance(font().glyph_id(letter));
            let found = centres("o o o o o o", size);
            assert_eq!(found.len(), 6, "{size}");
            for pair in found.windows(2) {
                let step = pair[1] - pair[0];
                assert!(
                    (step - wide('o') - wide(' ')).abs() < 0.1,
                    "{size}: {found:?}"
                );
            }
            // The letter is in the middle of its own space.
            assert!(
                (found[0] - 10.0 - wide('o') / 2.0).abs() < 0.3,
                "{size}: {found:?}"
            );
        }
    }
}
