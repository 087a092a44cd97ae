//! Panels as SVG elements, styled by their page. Noisy curves are smoothed; axes are logarithmic
//! for large ranges.

use std::ops::Range;

use super::Panel;
use super::axes::{can_be_drawn, extremes};
use crate::escape::escape;

/// Size of a chart and its margins, in SVG units.
const SIZE: (f64, f64) = (460.0, 230.0);
const LEFT: f64 = 56.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 30.0;

/// Number of parts of a long curve; each part is drawn by its lowest and highest value.
const PARTS: usize = 300;

/// A curve is noisy, and is smoothed, if the ratio of total variation and range exceeds this value.
const NOISY: f64 = 5.0;

/// Time constant of smoothing, as a part of the longest curve.
const SMOOTHING: f64 = 0.03;

/// Ratio of positive values from which the axis is logarithmic.
const LOGARITHMIC: f64 = 30.0;

/// Number of colors of the page style.
const COLOURS: usize = 8;

/// The ranges of both axes.
struct Frame {
    x: Range<f64>,
    y: Range<f64>,
    is_log: bool,
}

impl Panel {
    /// True if no point of the curves can be drawn.
    pub fn is_empty(&self) -> bool {
        self.curves().next().is_none()
    }

    fn curves(&self) -> impl Iterator<Item = (&str, Vec<(f64, f64)>)> {
        let drawable = |(x, y): &&(f64, f64)| can_be_drawn(*x) && can_be_drawn(*y);
        let curves = self.series().iter().map(move |(name, points)| {
            let points = points.iter().filter(drawable).copied().collect();
            (name.as_str(), points)
        });
        curves.filter(|(_, points): &(_, Vec<_>)| !points.is_empty())
    }

    /// The curves as HTML: title, legend, SVG.
    pub(crate) fn html(&self) -> String {
        let lines: Vec<_> = self.curves().collect();
        let frame = Frame::of(lines.iter().flat_map(|(_, points)| points));
        let mut body = frame.axes(self.x_label);
        let mut legend = String::new();
        // All curves or none, over equally many points, so that they can be compared.
        let noisy = lines.iter().any(|(_, points)| is_noisy(points));
        let longest = lines.iter().map(|(_, points)| points.len()).max();
        let window = SMOOTHING * longest.unwrap_or(0) as f64;
        for (index, (name, points)) in lines.iter().enumerate() {
            let colour = index % COLOURS;
            let class = if noisy { "faint" } else { "" };
            body += &frame.curve(&thinned(points), class, colour);
            if noisy {
                body += &frame.curve(&thinned(&smoothed(points, window)), "", colour);
            }
            if let [(x, y)] = points[..] {
                let (x, y) = frame.place(x, y);
                body += &format!("<circle class=s{colour} cx={x:.1} cy={y:.1} r=3 />");
            }
            let name = escape(name);
            let last = label(points.last().map_or(0.0, |point| point.1), 0.0);
            legend += &format!("<span><i class=s{colour}></i>{name} <b>{last}</b></span>");
        }
        let title = escape(&self.title);
        format!(
            "<figure class=chart><figcaption>{title}<div class=legend>{legend}</div></figcaption>\
             <svg viewBox=\"0 0 {} {}\" role=img aria-label=\"{title}\">{body}</svg></figure>\n",
            SIZE.0, SIZE.1
        )
    }
}

impl Frame {
    fn of<'a>(points: impl Iterator<Item = &'a (f64, f64)> + Clone) -> Self {
        let (x, mut y) = (span(points.clone().map(|p| p.0)), span(points.map(|p| p.1)));
        let is_log = y.start > 0.0 && y.end / y.start > LOGARITHMIC;
        if is_log {
            y = y.start.log10()..y.end.log10();
        }
        let margin = f64::max(0.06 * (y.end - y.start), 1e-3 * y.end.abs()).max(1e-12);
        Self {
            x: x.start..x.end.max(x.start + 1e-9),
            y: y.start - margin..y.end + margin,
            is_log,
        }
    }

    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        let y = if self.is_log { y.log10() } else { y };
        let across = (x - self.x.start) / (self.x.end - self.x.start);
        let up = (y - self.y.start) / (self.y.end - self.y.start);
        (
            LEFT + across * (SIZE.0 - LEFT - RIGHT),
            SIZE.1 - BOTTOM - up * (SIZE.1 - TOP - BOTTOM),
        )
    }

    fn curve(&self, points: &[(f64, f64)], class: &str, colour: usize) -> String {
        let mut path = format!("<polyline class=\"s{colour} {class}\" points=\"");
        for &(x, y) in points {
            let (x, y) = self.place(x, y);
            path += &format!("{x:.1},{y:.1} ");
        }
        path + "\"/>"
    }

    /// Grid lines and tick labels.
    fn axes(&self, x_label: &str) -> String {
        let mut axes = String::new();
        let (right, bottom) = (SIZE.0 - RIGHT, SIZE.1 - BOTTOM);
        let (step, rows) = match self.is_log {
            true => (0.0, powers(&self.y)),
            false => ticks(&self.y, 5.0),
        };
        for tick in rows {
            let value = if self.is_log { 10f64.powf(tick) } else { tick };
            let (_, y) = self.place(self.x.start, value);
            let number = label(value, step);
            let (x, below) = (LEFT - 6.0, y + 3.5);
            axes += &format!(
                "<path class=grid d=\"M{LEFT} {y:.1}H{right}\"/>\
                 <text x={x} y={below:.1} text-anchor=end>{number}</text>"
            );
        }
        let (step, columns) = ticks(&self.x, 6.0);
        for tick in columns {
            let x = LEFT + (tick - self.x.start) / (self.x.end - self.x.start) * (right - LEFT);
            let number = label(tick, step);
            let y = bottom + 15.0;
            axes += &format!(
                "<path class=grid d=\"M{x:.1} {bottom}v4\"/>\
                 <text x={x:.1} y={y} text-anchor=middle>{number}</text>"
            );
        }
        let (y, name) = (SIZE.1 - 3.0, escape(x_label));
        axes + &format!(
            "<path class=axis d=\"M{LEFT} {bottom}H{right}\"/>\
             <text class=name x={right} y={y} text-anchor=end>{name}</text>"
        )
    }
}

fn span(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = extremes(values);
    if low > high { 0.0..1.0 } else { low..high }
}

/// About `about` round numbers in the range, and their step.
fn ticks(range: &Range<f64>, about: f64) -> (f64, Vec<f64>) {
    let rough = (range.end - range.start) / about;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = step.into_iter().find(|step| *step >= rough);
    let step = step.unwrap_or(10.0 * power);
    let (first, last) = ((range.start / step).ceil(), (range.end / step).floor());
    let count = (last - first).clamp(-1.0, 20.0) + 1.0;
    let numbers = (0..count as usize).map(|index| (first + index as f64) * step);
    (step, numbers.collect())
}

/// Powers of ten in a range of exponents; a short range also has 2 and 5 times the powers.
fn powers(range: &Range<f64>) -> Vec<f64> {
    let (first, last) = (range.start.ceil() as i64, range.end.floor() as i64);
    if last - first < 2 {
        // Too few tick labels.
        let numbers = (first - 1..=last)
            .flat_map(|power| [1.0f64, 2.0, 5.0].map(|n| n.log10() + power as f64));
        return numbers.filter(|number| range.contains(number)).collect();
    }
    let apart = ((last - first) / 5 + 1).max(1) as usize;
    let powers = (first..=last).step_by(apart);
    powers.map(|power| power as f64).collect()
}

/// A number; `step` is the distance of tick labels, 0 for a single number.
fn label(value: f64, step: f64) -> String {
    let size = value.abs().max(step);
    if size == 0.0 || value.abs() < 1e-6 * step {
        return "0".into();
    }
    if !(1e-3..1e6).contains(&size) {
        let text = format!("{value:.1e}");
        return text.replace(".0e", "e");
    }
    let digits = match step {
        0.0 => (3.0 - size.log10().floor()).clamp(0.0, 6.0),
        step => (-(step * 1.000001).log10().floor()).clamp(0.0, 6.0),
    };
    let text = format!("{value:.*}", digits as usize);
    match step == 0.0 && text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').into(),
        false => text,
    }
}

/// The lowest and highest point of each part of a long curve, in order.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= 2 * PARTS {
        return points.to_vec();
    }
    let mut thinned = Vec::with_capacity(2 * PARTS + 2);
    thinned.push(points[0]);
    for part in 0..PARTS {
        let [from, to] = [part, part + 1].map(|part| part * points.len() / PARTS);
        let part = points[from..to].iter().enumerate();
        let low = part.clone().min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let high = part.max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let mut ends: Vec<_> = low.into_iter().chain(high).collect();
        ends.sort_by_key(|(index, _)| *index);
        thinned.extend(ends.into_iter().map(|(_, point)| *point));
    }
    thinned.extend(points.last());
    thinned
}

fn is_noisy(points: &[(f64, f64)]) -> bool {
    let path = points.windows(2).map(|pair| (pair[1].1 - pair[0].1).abs());
    let range = span(points.iter().map(|point| point.1));
    path.sum::<f64>() > NOISY * (range.end - range.start)
}

/// An exponential moving average over `window` points, with bias correction.
fn smoothed(points: &[(f64, f64)], window: f64) -> Vec<(f64, f64)> {
    let decay = 1.0 - 1.0 / window.max(2.0);
    let (mut mean, mut weight) = (0.0, 0.0);
    let smooth = points.iter().map(|&(x, y)| {
        mean = decay * mean + (1.0 - decay) * y;
        weight = decay * weight + (1.0 - decay);
        (x, mean / weight)
    });
    smooth.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: impl IntoIterator<Item = (f64, f64)>) -> Panel {
        let series = ("a\"b".to_string(), points.into_iter().collect());
        Panel::lines("loss <&>", "step", vec![series])
    }

    #[test]
    fn a_long_curve_keeps_its_peaks_and_few_points() {
        let points: Vec<_> = (0..100_000)
            .map(|i| (f64::from(i), if i == 54_321 { 9.0 } else { 1.0 }))
            .collect();
        let thin = thinned(&points);
        assert!(thin.len() < 1000, "{}", thin.len());
        assert!(thin.contains(&(54_321.0, 9.0)));
        assert!(thin.is_sorted_by(|a, b| a.0 <= b.0));
        assert!(chart(points).html().len() < 40_000);
    }

    #[test]
    fn names_are_escaped_and_odd_values_leave_no_mark() {
        let html = chart([(0.0, 1.0), (1.0, f64::NAN), (2.0, 1e300), (3.0, 2.0)]).html();
        assert!(html.contains("loss &lt;&amp;&gt;"), "{html}");
        assert!(html.contains("a&quot;b"), "{html}");
        assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        assert!(chart([(0.0, f64::NAN)]).is_empty());
        for points in [vec![(5.0, 0.0)], vec![(1.0, -1e30), (2.0, 1e30)]] {
            let html = chart(points).html();
            assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        }
    }

    #[test]
    fn noise_is_smoothed_and_a_schedule_is_not() {
        let noise = |i: i32| (f64::from(i), f64::from(i * 7919 % 101));
        let noisy = chart((0..100).map(noise)).html();
        assert_eq!(noisy.matches("<polyline").count(), 2);
        assert!(noisy.contains("faint"));
        let schedule = chart((0..100).map(|i| (f64::from(i), f64::from(50 - i).abs()))).html();
        assert_eq!(schedule.matches("<polyline").count(), 1);
    }

    #[test]
    fn a_noisy_curve_has_a_smooth_one_beside_it() {
        let noise = |i: i32| (f64::from(i), f64::from(i * 7919 % 101));
        let even = |i: i32| (f64::from(i), f64::from(i));
        let curves = [
            ("a", (0..100).map(noise).collect()),
            ("b", (0..40).map(even).collect()),
        ];
        let curves = curves.map(|(name, points): (&str, Vec<_>)| (name.to_owned(), points));
        let both = Panel::lines("loss", "step", curves.into()).html();
        assert_eq!(both.matches("<polyline").count(), 4);
        let value = |x: f64, window| smoothed(&[(0.0, 0.0), (1.0, x)], window)[1].1;
        assert!(value(1.0, 20.0) < value(1.0, 2.0));
    }

    #[test]
    fn a_wide_positive_range_is_logarithmic() {
        let html = chart([(0.0, 1e-4), (1.0, 1.0)]).html();
        for number in [">1e-4<", ">1e-3<", ">0.01<", ">0.1<", ">1<"] {
            assert!(
                html.replace("0.001", "1e-3").contains(number),
                "{number}: {html}"
            );
        }
    }

    #[test]
    fn a_logarithmic_axis_has_more_than_one_number() {
        let html = chart([(0.0, 2.4e-5), (1.0, 9e-4)]).html();
        for number in [">5e-5<", ">1e-4<", ">2e-4<", ">5e-4<"] {
            assert!(html.contains(number), "{number}: {html}");
        }
    }

    #[test]
    fn ticks_are_round_numbers() {
        let (step, found) = ticks(&(0.03..0.97), 5.0);
        assert_eq!((step, found.len()), (0.2, 4));
        assert_eq!(label(found[1], step), "0.4");
        assert_eq!(label(600.0, 100.0), "600");
        assert_eq!(label(0.054321, 0.0), "0.05432");
    }
}
