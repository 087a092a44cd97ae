//! The record of a matched motion, and its summary.

use std::path::PathBuf;

use kinegrad_matching::{
    Adaptation, CommonJoints, Made, Measures, Novelty, Preset, Quality, Run, Seam, Settings,
    Sliding,
};
use kinegrad_output::path_text;
use kinegrad_settings::counted;
use serde::Serialize;

use crate::args::MatchArguments;

/// Least ratio of jerk to the sources' jerk for a message, with fixed parts.
const SHAKING: f64 = 1.3;

/// Settings and measures of a matched motion.
#[derive(Serialize)]
pub struct Record {
    kinegrad: &'static str,
    #[serde(serialize_with = "path_text")]
    examples: Vec<PathBuf>,
    /// Frames of each example, at the rate of the motion.
    example_frames: Vec<usize>,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "path_text")]
    content: Option<PathBuf>,
    seed: u64,
    preset: Preset,
    settings: Settings,
    #[serde(skip_serializing_if = "Option::is_none")]
    coherence: Option<f64>,
    /// None if the first attempt was taken, or an option decides how much is mixed.
    #[serde(skip_serializing_if = "Option::is_none")]
    adaptation: Option<Adaptation>,
    frames: usize,
    fps: f64,
    heading: bool,
    parts: Vec<PartRecord>,
    /// `None` for examples of one skeleton.
    #[serde(skip_serializing_if = "Option::is_none")]
    common_joints: Option<CommonJoints>,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "path_text")]
    keyframes: Option<PathBuf>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fixed: Vec<String>,
    /// `None` without `--lock-feet`.
    #[serde(skip_serializing_if = "Option::is_none")]
    sliding: Option<Sliding>,
    /// `None` without fixed parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    jerk: Option<f64>,
    /// `None` without `--loop`.
    #[serde(skip_serializing_if = "Option::is_none")]
    seam: Option<Seam>,
    quality: Quality,
    /// True if the motion is not usable.
    far: bool,
    /// `None` if the motions are too short or too long to compare.
    measures: Option<Measures>,
}

/// A part of the body, and its runs copied from the examples.
#[derive(Serialize)]
struct PartRecord {
    name: String,
    joints: Vec<String>,
    #[serde(flatten)]
    novelty: Novelty,
    /// Runs copied from an example: first frame, example, first frame in the example, number of
    /// frames.
    runs: Vec<[usize; 4]>,
}

impl Record {
    /// The record of `made`, of examples in units of so many metres.
    pub fn new(
        arguments: &MatchArguments,
        made: &Made,
        common_joints: Option<CommonJoints>,
        metres_per_unit: f64,
    ) -> Self {
        let joints = made.layout.joints();
        let as_array = |run: &Run| [run.start, run.example, run.first, run.frames];
        let example_frames = made.examples.iter().map(|example| example.frames());
        let known = made.novelty().into_iter().zip(made.runs());
        let parts = made.parts.iter().zip(known);
        let parts = parts.map(|(part, (novelty, runs))| PartRecord {
            name: part.name.clone(),
            joints: Vec::from_iter(part.joints.iter().map(|&joint| joints[joint].name.clone())),
            novelty,
            runs: Vec::from_iter(runs.iter().map(as_array)),
        });
        let fixed = arguments.fix.iter();
        let fixed = fixed.map(|(part, path)| format!("{part}={}", path.display()));
        Self {
            kinegrad: env!("CARGO_PKG_VERSION"),
            examples: arguments.examples.clone(),
            example_frames: example_frames.collect(),
            content: arguments.content.clone(),
            seed: arguments.seed,
            preset: arguments.preset.unwrap_or_default(),
            settings: made.settings.clone(),
            coherence: arguments.coherence,
            adaptation: made.adaptation,
            frames: made.bvh.frames(),
            fps: 1.0 / made.layout.frame_time(),
            heading: made.layout.is_relative(),
            parts: parts.collect(),
            common_joints,
            keyframes: arguments.keyframes.clone(),
            fixed: fixed.collect(),
            sliding: made
                .sliding
                .map(|sliding| sliding.in_metres(metres_per_unit)),
            jerk: made.jerk,
            seam: made.seam(made.settings.looping),
            far: made.quality.is_far(),
            quality: made.quality.clone().in_metres(metres_per_unit),
            measures: made.measures(&[]),
        }
    }

    /// True if the motion is not usable.
    pub fn is_far(&self) -> bool {
        self.far
    }

    /// Prints the measures.
    pub fn summarize(&self) {
        tell!(
            "{} at {:.2} a second",
            counted(self.frames, "frame"),
            self.fps
        );
        if let Some(common) = &self.common_joints {
            let left_out = common.left_out.iter();
            let left_out = left_out.map(|(file, joints)| format!("{} of {file}", joints.len()));
            let left_out: Vec<String> = left_out.collect();
            tell!(
                "the skeletons differ: matched on {}, without {}; the record names them",
                counted(common.joints.len(), "joint"),
                left_out.join(", ")
            );
        }
        if let Some(measures) = &self.measures {
            let global = measures.global_diversity;
            let global = global.map_or_else(String::new, |global| format!(", {global:.3} global"));
            let novelty = measures.novelty;
            let novelty = novelty.map_or_else(String::new, |novelty| {
                format!(", novelty {novelty:.3} (0: a copy, beyond 1: unlike the examples)")
            });
            tell!(
                "coverage {:.3} (window cost {:.3}), diversity {:.3} local{global}{novelty}",
                measures.coverage,
                measures.window_cost,
                measures.local_diversity
            );
        }
        self.summarize_quality();
        if let Some(jerk) = self.jerk.filter(|jerk| *jerk > SHAKING) {
            tell!(
                "it shakes: its jerk is {jerk:.1} times that of the source motions; fix more of the body, \
                 including the hips"
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
                "locked feet in contact: {:.3} m/s before, {:.3} after",
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

    /// Prints the physical measures beside those of the examples.
    fn summarize_quality(&self) {
        if let Some(adaptation) = &self.adaptation {
            let number = adaptation.attempt + 1;
            let settings = match adaptation.coherence {
                Some(coherence) => format!("coherence {coherence}"),
                None => "the usual settings".to_string(),
            };
            tell!(
                "{settings}, attempt {number}: earlier attempts slid, shook or froze more; `--coherence` \
                 sets it"
            );
        }
        let (motion, examples) = (&self.quality.motion, &self.quality.examples);
        let toe = |speed: Option<f64>| speed.map_or("-".to_string(), |toe| format!("{toe:.3}"));
        tell!(
            "motion (examples): toe speed while low {} ({}) m/s, jerk {:.0} ({:.0}) m/s^3, fastest joint \
             {:.2} ({:.2}) m/s, still {:.0} % ({:.0} %), largest turn in a frame {:.0} degrees ({:.0})",
            toe(motion.toe_speed_while_low),
            toe(examples.toe_speed_while_low),
            motion.jerk,
            examples.jerk,
            motion.fastest_joint,
            examples.fastest_joint,
            100.0 * motion.still_share,
            100.0 * examples.still_share,
            motion.largest_turn,
            examples.largest_turn,
        );
    }

    /// Warns of measures beyond their bounds.
    pub fn warn(&self) {
        for beyond in self.quality.beyond() {
            tell!("warning: {beyond}");
        }
        if let Some(measures) = self.measures.filter(|measures| !measures.plausible) {
            tell!(
                "warning: novelty {:.2}: the motion is further from the examples than their parts are \
                 from each other",
                measures.novelty.unwrap_or_default()
            );
        }
    }
}
