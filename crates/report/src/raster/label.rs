//! Labels.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::Image;
use super::palette::TEXT;
use crate::font;

/// Writes a name at the top of a cell with the corner `(left, top)` and `width` pixels.
pub(super) fn write(image: &mut Image, text: &str, (left, top): (u32, u32), width: u32) {
    let height = (width / 20).clamp(9, 16);
    font::register();
    // Approximate number of letters that fit.
    let most = (2 * width / height) as usize;
    let mut shown: String = text.chars().take(most).collect();
    if shown.len() < text.len() {
        shown.pop();
        shown.push('…');
    }
    let size = (image.width, image.height);
    let bitmap = BitMapBackend::with_buffer(&mut image.rgb, size);
    let area = font::Bitmap(bitmap).into_drawing_area();
    let [r, g, b] = TEXT;
    let colour = RGBColor(r, g, b);
    let style = TextStyle::from(("sans-serif", height).into_font())
        .color(&colour)
        .pos(Pos::new(HPos::Center, VPos::Top));
    let at = ((left + width / 2) as i32, (top + height / 3) as i32);
    // A picture without a label is still useful.
    let _ = area.draw(&Text::new(shown, at, style));
    let _ = area.present();
}
