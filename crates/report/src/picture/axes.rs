//! Ranges of axes.

use std::ops::Range;

/// True if a value can be drawn: for larger values, the loop over ticks would not end.
pub(super) fn can_be_drawn(value: f64) -> bool {
    value.abs() <= 1e30
}

/// Minimum and maximum.
pub(super) fn extremes(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    values.fold(none, |(low, high), value| (low.min(value), high.max(value)))
}

/// The range of the values with a margin; never empty.
pub(super) fn bounds(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = extremes(values);
    if low > high {
        return 0.0..1.0;
    }
    // The margin hides rounding noise of constants.
    let margin = (0.05 * (high - low)).max(1e-3 * high.abs().max(low.abs()).max(1e-6));
    low - margin..high + margin
}

/// Widens one range so that both have the same scale at the aspect `ratio`.
pub(super) fn equal_scale(x: Range<f64>, y: Range<f64>, ratio: f64) -> (Range<f64>, Range<f64>) {
    let (width, height) = (x.end - x.start, y.end - y.start);
    let widen = |range: Range<f64>, to: f64| {
        let middle = (range.start + range.end) / 2.0;
        middle - to / 2.0..middle + to / 2.0
    };
    if width / height < ratio {
        (widen(x, height * ratio), y)
    } else {
        (x, widen(y, width / ratio))
    }
}
