//! Copied parts of a motion.

use serde::Serialize;

/// Shortest run that counts as copied, in frames: about a second.
const COPIED: usize = 30;

/// Consecutive frames that are consecutive in an example.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Run {
    /// First frame in the motion.
    pub start: usize,
    /// The example.
    pub example: usize,
    /// First frame in the example.
    pub first: usize,
    /// Number of frames, at least 1.
    pub frames: usize,
}

impl Run {
    /// The runs of a motion whose frame t continues frame `origins[t].1` of example `origins[t].0`.
    pub fn all(origins: &[(usize, usize)]) -> Vec<Self> {
        let mut runs: Vec<Self> = Vec::new();
        for (start, &(example, first)) in origins.iter().enumerate() {
            match runs.last_mut() {
                Some(run) if (run.example, run.first + run.frames) == (example, first) => {
                    run.frames += 1;
                }
                _ => runs.push(Self {
                    start,
                    example,
                    first,
                    frames: 1,
                }),
            }
        }
        runs
    }
}

/// Copied parts of a motion, from its origins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Novelty {
    /// Fraction of the frames in runs of at least 30 frames.
    pub copied: f64,
    /// Longest run, in seconds.
    pub longest_copied_seconds: f64,
    /// Transitions between runs a second.
    pub splices_per_second: f64,
}

impl Novelty {
    /// Novelty of a motion whose frame t continues frame `origins[t].1` of example `origins[t].0`,
    /// with `frame_time` seconds a frame.
    ///
    /// # Panics
    /// Panics if there are no frames.
    pub fn of(origins: &[(usize, usize)], frame_time: f64) -> Self {
        let runs: Vec<usize> = Run::all(origins).iter().map(|run| run.frames).collect();
        let frames = origins.len();
        assert!(frames > 0);
        let copied: usize = runs.iter().filter(|&&run| run >= COPIED).sum();
        let longest = runs.iter().copied().max().unwrap_or(0);
        Self {
            copied: copied as f64 / frames as f64,
            longest_copied_seconds: longest as f64 * frame_time,
            splices_per_second: (runs.len() - 1) as f64 / (frames as f64 * frame_time),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_where_the_example_or_the_place_changes() {
        let run = |example: usize, first: usize, frames: usize| {
            (first..first + frames).map(move |frame| (example, frame))
        };
        let origins: Vec<_> = run(0, 5, 40)
            .chain(run(1, 45, 10))
            .chain(run(1, 3, 30))
            .collect();
        let starts: Vec<_> = Run::all(&origins)
            .iter()
            .map(|run| (run.start, run.example, run.first, run.frames))
            .collect();
        assert_eq!(starts, [(0, 0, 5, 40), (40, 1, 45, 10), (50, 1, 3, 30)]);
        let novelty = Novelty::of(&origins, 0.05);
        assert_eq!(novelty.copied, 70.0 / 80.0);
        assert_eq!(novelty.longest_copied_seconds, 2.0);
        assert_eq!(novelty.splices_per_second, 2.0 / 4.0);
        let still = Novelty::of(&[(0, 3); 8], 0.05);
        assert_eq!((still.copied, still.longest_copied_seconds), (0.0, 0.05));
    }
}
