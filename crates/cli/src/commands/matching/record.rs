//! The record of a motion made of examples, and its summary in words.

use std::path::PathBuf;

use kinegrad_matching::{Job, Made, Measures, Novelty, Preset, Seam, Settings, Sliding, Stillness};
use serde::Serialize;

use crate::args::MatchArguments;

/// By how much more of its frames than of the examples' a motion stands still before that is said.
const MORE_STILL: f64 = 0.03;

/// Jerk over fixed parts above which that is said, as a part of that of the motions it is made of.
const SHAKING: f64 = 1.3;

/// How a motion was made, and what it has of its examples.
#[derive(Serialize)]
pub struct Record {
    kinegrad: &'static str,
    examples: Vec<PathBuf>,
    /// Frames of each example, at the rate of the motion.
    example_frames: Vec<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    content: Option<PathBuf>,
    seed: u64,
    preset: Preset,
    settings: Settings,
    #[serde(skip_serializing_if = "Option::is_none")]
    coherence: Option<f64>,
    frames: usize,
    fps: f64,
    heading: bool,
    parts: Vec<PartRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    keyframes: Option<PathBuf>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fixed: Vec<String>,
    /// None where feet are not held.
    #[serde(skip_serializing_if = "Option::is_none")]
    sliding: Option<Sliding>,
    /// None where nothing is fixed.
    #[serde(skip_serializing_if = "Option::is_none")]
    jerk: Option<f64>,
    /// None of motions that are no loops.
    #[serde(skip_serializing_if = "Option::is_none")]
    seam: Option<Seam>,
    /// None of motions of one frame.
    still: Option<Stillness>,
    /// None where the motions are too short, or too long to be compared.
    measures: Option<Measures>,
}

/// A part of the body, and what its motion copies.
#[derive(Serialize)]
struct PartRecord {
    name: String,
    joints: Vec<String>,
    #[serde(flatten)]
    novelty: Novelty,
    /// Frames that follow each other as in an example: the first in the motion, the example, the
    /// first in it, and how many.
    runs: Vec<[usize; 4]>,
}

impl Record {
    /// The record of a motion that was made.
    pub fn new(arguments: &MatchArguments, job: &Job, made: &Made) -> Self {
        let joints = made.layout.joints();
        let known = made.novelty().into_iter().zip(made.runs());
        let parts = made.parts.iter().zip(known);
        let parts = parts.map(|(part, (novelty, runs))| PartRecord {
            name: part.name.clone(),
            joints: part
                .joints
                .iter()
                .map(|&joint| joints[joint].name.clone())
                .collect(),
            novelty,
            runs: runs
                .iter()
                .map(|run| [run.start, run.example, run.first, run.frames])
                .collect(),
        });
        let fixed = arguments.fix.iter();
        Self {
            kinegrad: env!("CARGO_PKG_VERSION"),
            examples: arguments.examples.clone(),
            example_frames: made
                .examples
                .iter()
                .map(|example| example.frames())
                .collect(),
            content: arguments.content.clone(),
            seed: arguments.seed,
            preset: arguments.preset,
            settings: job.settings.clone(),
            coherence: arguments.coherence,
            frames: made.bvh.frames(),
            fps: 1.0 / made.layout.frame_time(),
            heading: arguments.heading,
            parts: parts.collect(),
            keyframes: arguments.keyframes.clone(),
            fixed: fixed
                .map(|(part, path)| format!("{part}={}", path.display()))
                .collect(),
            sliding: made.sliding,
            jerk: made.jerk,
            seam: made.seam(job.settings.looping),
            still: made.stillness(),
            measures: made.measures(&[]),
        }
    }

    /// Says in words what was made.
    pub fn summarize(&self) {
        tell!("{} frames at {:.2} a second", self.frames, self.fps);
        if let Some(measures) = &self.measures {
            let global = match measures.global_diversity {
                Some(global) => format!(", {global:.3} global"),
                None => String::new(),
            };
            tell!(
                "coverage {:.3} (window cost {:.3}), diversity {:.3} local{global}",
                measures.coverage,
                measures.window_cost,
                measures.local_diversity
            );
        }
        if let Some(still) = self
            .still
            .filter(|still| still.motion > still.examples + MORE_STILL)
        {
            tell!(
                "it stands still in {:.0} % of its frames, the examples in {:.0} %: another `--seed`, or \
                 `--coherence 1`, can be better",
                100.0 * still.motion,
                100.0 * still.examples
            );
        }
        if let Some(jerk) = self.jerk.filter(|jerk| *jerk > SHAKING) {
            tell!(
                "it shakes: its jerk is {jerk:.1} times that of the motions that it is put together of; fix \
                 more of the body, with the hips that it hangs on"
            );
        }
        if let Some(seam) = self.seam.filter(|seam| seam.jump() > 1.0) {
            tell!(
                "the loop's seam: a step of {:.2} and a change of velocity of {:.2} times the 95th percentile",
                seam.step,
                seam.velocity
            );
        }
        if let Some(sliding) = &self.sliding {
            tell!(
                "feet in contact: {:.2} units a second before, {:.2} after",
                sliding.before,
                sliding.after
            );
        }
        for part in &self.parts {
            tell!(
                "{}: {:.0} % in runs of a second or more, the longest {:.1} s; {:.2} splices a second",
                part.name,
                100.0 * part.novelty.copied,
                part.novelty.longest_copied_seconds,
                part.novelty.splices_per_second
            );
        }
    }
}
