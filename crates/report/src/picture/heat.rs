//! Heat maps.

use plotters::prelude::*;

use super::axes::{can_be_drawn, extremes};

/// Maximum number of cells of a heat map along each axis.
const CELLS: (usize, usize) = (480, 64);

/// The rectangles of a heat map; cells are averaged if there are too many.
pub(super) fn cells(
    rows: &[Vec<f64>],
    width: f64,
) -> impl Iterator<Item = Rectangle<(f64, f64)>> + '_ {
    let columns = rows.first().map_or(0, Vec::len);
    let values = || rows.iter().flatten().copied().filter(|&v| can_be_drawn(v));
    let (low, high) = extremes(values());
    let scale = 1.0 / (high - low).max(1e-9);
    let (across, up) = (columns.min(CELLS.0), rows.len().min(CELLS.1));
    let span = move |index: usize, parts: usize, whole: usize| {
        let from = index * whole / parts;
        from..((index + 1) * whole / parts).max(from + 1)
    };
    let cell = move |(j, i): (usize, usize)| {
        let (row_span, column_span) = (span(j, up, rows.len()), span(i, across, columns));
        let mean = rows[row_span.clone()]
            .iter()
            .flat_map(|row| &row[column_span.clone()])
            .sum::<f64>()
            / (row_span.len() * column_span.len()) as f64;
        let shade = 255.0 * (1.0 - ((mean - low) * scale).clamp(0.0, 1.0));
        let seconds = |column: usize| column as f64 / columns as f64 * width;
        let corners = [
            (seconds(column_span.start), row_span.start as f64),
            (seconds(column_span.end), row_span.end as f64),
        ];
        let gray = shade as u8;
        Rectangle::new(corners, RGBColor(gray, gray, gray).filled())
    };
    (0..up)
        .flat_map(move |j| (0..across).map(move |i| (j, i)))
        .map(cell)
}
