//! The picture of a new motion: source frames, coverage of the examples, root path.

use std::path::Path;

use kinegrad_matching::Made;
use kinegrad_report::{Panel, Series};
use kinegrad_train::Error;

use crate::output;

/// Pixels of a panel.
const SIZE: (u32, u32) = (900, 260);

/// Plots the panels below each other; `examples` are the file names, `metres` the unit's length.
pub fn draw(made: &Made, examples: &[String], metres: f64, out: &Path) -> Result<(), Error> {
    let panels = [origins(made), coverage(made, examples), path(made, metres)];
    output::draw(&panels, 1, SIZE, out)
}

/// First frame of each example in the concatenated examples.
fn starts(made: &Made) -> Vec<usize> {
    let mut next = 0;
    let starts = made.examples.iter().map(|example| {
        let start = next;
        next += example.frames();
        start
    });
    starts.collect()
}

/// Source time of each frame, by part; a line ends at a splice.
fn origins(made: &Made) -> Panel {
    let (frame_time, starts) = (made.layout.frame_time(), starts(made));
    let mut series: Vec<Series> = Vec::new();
    for (part, origins) in made.parts.iter().zip(&made.synthesis.origins) {
        let mut points = Vec::new();
        let mut before = None;
        for (t, &(example, frame)) in origins.iter().enumerate() {
            if before.is_some_and(|before| before != (example, frame)) {
                points.push((f64::NAN, f64::NAN));
            }
            let source = (starts[example] + frame) as f64 * frame_time;
            points.push((t as f64 * frame_time, source));
            before = Some((example, frame + 1));
        }
        series.push((part.name.clone(), points));
    }
    Panel::lines("source time in the examples, s", "s", series)
}

/// The frames of each example that appear in any part.
fn coverage(made: &Made, examples: &[String]) -> Panel {
    let used = made.examples.iter();
    let used = used.map(|example| vec![false; example.frames()]);
    let mut used: Vec<Vec<bool>> = used.collect();
    for &(example, frame) in made.synthesis.origins.iter().flatten() {
        used[example][frame] = true;
    }
    let tracks = examples.iter().zip(&used);
    let tracks = tracks.map(|(name, used)| (name.as_str(), used.as_slice()));
    let fps = 1.0 / made.layout.frame_time();
    Panel::strip("used frames of the examples", fps, tracks)
}

/// The root paths of the motion and of the first example.
fn path(made: &Made, metres: f64) -> Panel {
    let of = |frames| {
        let path = made.layout.path(frames).into_iter();
        path.map(|place| made.layout.top_view(place.map(|value| value * metres)))
            .collect()
    };
    let series = vec![
        ("first example".to_string(), of(&made.examples[0])),
        ("new motion".to_string(), of(&made.synthesis.frames)),
    ];
    Panel::map("root path, top view", series)
}
