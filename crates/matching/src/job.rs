//! A whole job: from BVH motions to a new one.

use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_settings::{Refused, in_range};

use crate::limit_jerk::{self, jerks, percentile_95};
use crate::metrics::Seam;
use crate::synthesis::{start_noise, synthesize_from, synthesize_like};
use crate::{
    Channels, Constraint, Error, Example, Frames, Keyframe, Length, Looping, MatrixOptions,
    MotionMatrix, Part, Request, Settings, Sliding, Synthesis, feet,
};

mod conflicts;

/// Loops that are made until the seam of one is calm.
const MAX_LOOPS: u64 = 8;
/// A seam is calm if its jumps are at most this part of the 95th percentile of all.
const SMOOTH_SEAM: f64 = 0.95;

/// How the body is divided.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum PartChoice {
    /// Not at all.
    #[default]
    Whole,
    /// By where the skeleton branches.
    Automatic,
    /// As the text of a TOML file says.
    File {
        /// The file, for messages.
        file: String,
        /// Its text.
        text: String,
    },
}

/// A body part that follows a given motion.
#[derive(Clone, Debug)]
pub struct Fixed {
    /// The part, named as in [`Part::named`].
    pub part: String,
    /// The motion, which is as long as the new one.
    pub motion: Example,
}

/// What is to be made. By default twice the examples, with the settings of the published program.
#[derive(Clone, Debug, Default)]
pub struct Job {
    /// The settings of the synthesis.
    pub settings: Settings,
    /// How long the motion is; without one as long as what is fixed or the content, else twice the
    /// examples.
    pub length: Option<Length>,
    /// Seed of the noise.
    pub seed: u64,
    /// A motion whose coarse course the new one starts from in place of noise, so that it does the
    /// same in the manner of the examples; it is as long.
    pub content: Option<Example>,
    /// The axis that points up in the files.
    pub up: UpAxis,
    /// Whether contacts of the feet are matched as well.
    pub contacts: bool,
    /// Whether the body is seen from its heading.
    pub heading: bool,
    /// How the body is divided.
    pub parts: PartChoice,
    /// Poses that the motion takes, each with the motion it is from: none is the first example.
    pub keyframes: Vec<(Keyframe, Option<Example>)>,
    /// Parts that follow given motions.
    pub fixed: Vec<Fixed>,
    /// Whether feet are held still where those of the examples rest. It moves legs of key frames and
    /// of parts that are fixed as well, and the seam of a loop.
    pub lock_feet: bool,
}

/// A new motion and what it was made of.
#[derive(Clone, Debug)]
pub struct Made {
    /// The motion, with the hierarchy of the first example.
    pub bvh: Bvh,
    /// The same as a matrix, and where it comes from.
    pub synthesis: Synthesis,
    /// How the files are matrices.
    pub layout: MotionMatrix,
    /// The examples as matrices.
    pub examples: Vec<Frames>,
    /// The parts that were matched, one for each list of origins.
    pub parts: Vec<Part>,
    /// How far feet slid, if they were held; only `bvh` has them held.
    pub sliding: Option<Sliding>,
    /// Where something is fixed: the 95th percentile of jerk, as a part of that of the motion among
    /// examples and fixed ones that jerks most.
    pub jerk: Option<f64>,
}

impl Job {
    /// Makes a motion of the examples.
    ///
    /// # Errors
    /// For settings out of range, files that do not fit each other, examples shorter than a patch,
    /// and parts or moments that are not there.
    pub fn make(&self, examples: &[Example]) -> Result<Made, Error> {
        self.settings.validate()?;
        let contacts = match (self.contacts, examples.first()) {
            (true, Some(first)) => feet(first.bvh.joints()),
            _ => Vec::new(),
        };
        let options = MatrixOptions {
            up: self.up,
            contacts,
            heading: self.heading,
        };
        let fixed = self.fixed.iter().map(|fixed| &fixed.motion);
        let sources = self
            .keyframes
            .iter()
            .filter_map(|(_, source)| source.as_ref());
        let others: Vec<&Example> = fixed.chain(&self.content).chain(sources).collect();
        let layout = MotionMatrix::with(examples, &others, options)?;
        if self
            .keyframes
            .iter()
            .any(|(keyframe, _)| keyframe.place.is_some())
        {
            let motions = examples.iter().chain(others);
            layout.must_have_upright_root(motions, "`place` of a key frame")?;
        }
        let matrices = examples.iter().map(|example| layout.to_frames(example));
        let matrices: Vec<Frames> = matrices.collect::<Result<_, _>>()?;
        for (example, frames) in examples.iter().zip(&matrices) {
            self.must_have_a_patch(example, frames, &layout)?;
        }
        let parts = match &self.parts {
            PartChoice::Whole => vec![Part::whole(&layout)],
            PartChoice::Automatic => Part::automatic(&layout),
            PartChoice::File { file, text } => Part::read(text, file, &layout)?,
        };
        let known = match &self.parts {
            PartChoice::Whole => Part::automatic(&layout),
            _ => parts.clone(),
        };
        let fixed = self
            .fixed
            .iter()
            .map(|fixed| layout.to_frames(&fixed.motion));
        let fixed: Vec<Frames> = fixed.collect::<Result<_, _>>()?;
        let content = self
            .content
            .as_ref()
            .map(|content| layout.to_frames(content));
        let content = content.transpose()?;
        let given = self
            .fixed
            .iter()
            .map(|fixed| &fixed.motion)
            .chain(&self.content);
        let given = given.zip(fixed.iter().chain(&content));
        for (example, frames) in given.clone() {
            self.must_have_a_patch(example, frames, &layout)?;
        }
        let given: Vec<(&Example, usize)> = given
            .map(|(example, frames)| (example, frames.frames()))
            .collect();
        let frames = self.frames(&layout, &matrices, &given)?;
        let mut constraints = Vec::new();
        for (keyframe, source) in &self.keyframes {
            let (source, poses) = match source {
                Some(source) => (source, &layout.to_frames(source)?),
                None => (&examples[0], &matrices[0]),
            };
            constraints.push(keyframe.constraint(&layout, &known, source, poses, frames)?);
        }
        for (fixed, motion) in self.fixed.iter().zip(&fixed) {
            constraints.push(Constraint::Channels {
                channels: Part::named(&fixed.part, &known, &layout, "--fix")?
                    .channels(&layout)
                    .channels,
                motion: motion.clone(),
            });
        }
        self.must_agree(&layout, &constraints, frames)?;
        let groups: Vec<Channels> = parts.iter().map(|part| part.channels(&layout)).collect();
        let request = Request {
            examples: &matrices,
            frames,
            settings: &self.settings,
            groups: &groups,
            constraints: &constraints,
        };
        let usual = match fixed.is_empty() {
            true => None,
            false => Some(usual_jerk(&layout, matrices.iter().chain(&fixed))?),
        };
        let around = self.settings.looping != Looping::Off;
        // A loop that a key frame holds in its place cannot begin elsewhere: of several the first whose
        // seam is calm, or the calmest.
        let most = match around && !constraints.is_empty() && content.is_none() {
            true => MAX_LOOPS,
            false => 1,
        };
        let first = request.levels()?.synthesis[0];
        let mut calmest: Option<(f64, MotionMatrix, Synthesis, Bvh)> = None;
        for attempt in 0..most {
            let mut synthesis = match &content {
                Some(content) => synthesize_like(&request, content)?,
                None => {
                    let noise = start_noise(self.seed, attempt, first, layout.channels());
                    synthesize_from(&request, &noise)?
                }
            };
            if around && constraints.is_empty() && content.is_none() {
                synthesis.rotate_to_smoothest_seam();
            }
            let mut layout = layout.clone();
            let bvh = self.finished(&mut layout, &mut synthesis.frames, &constraints, usual)?;
            let jump = match most {
                1 => None,
                _ => Seam::of(&layout, &bvh).map(|seam| seam.jump()),
            };
            let jump = jump.unwrap_or(0.0);
            if calmest.as_ref().is_none_or(|(least, ..)| jump < *least) {
                calmest = Some((jump, layout, synthesis, bvh));
            }
            if jump <= SMOOTH_SEAM {
                break;
            }
        }
        let (_, layout, synthesis, mut bvh) = calmest.expect("one motion or more");
        let jerk = usual.map(|usual| percentile_95(&jerks(&bvh)) / usual.max(f64::MIN_POSITIVE));
        let mut sliding = None;
        if self.lock_feet {
            let origins = &synthesis.origins;
            let (locked, slid) = layout.with_locked_feet(&bvh, examples, &parts, origins)?;
            (bvh, sliding) = (locked, Some(slid));
        }
        Ok(Made {
            bvh,
            synthesis,
            layout,
            examples: matrices,
            parts,
            sliding,
            jerk,
        })
    }

    /// Leads a motion where its key frames say, smooths it around them and over what is fixed, and says
    /// it as BVH; `usual` is the jerk of the motions that it is made of, where something is fixed.
    fn finished(
        &self,
        layout: &mut MotionMatrix,
        frames: &mut Frames,
        constraints: &[Constraint],
        usual: Option<f64>,
    ) -> Result<Bvh, Error> {
        let around = self.settings.looping != Looping::Off;
        if around {
            layout.close_heading(frames);
        }
        let points = self.keyframes.iter().filter_map(|(keyframe, _)| {
            let frame = (keyframe.time / layout.frame_time()).round() as usize;
            Some((frame, keyframe.place?))
        });
        let points: Vec<(usize, [f64; 2])> = points.collect();
        let first = points.iter().min_by_key(|(frame, _)| *frame);
        match first {
            Some((0, place)) => layout.start_at(*place),
            // A loop begins anywhere: its first place says where it is.
            Some(point) if around => layout.start_through(frames, *point),
            _ => {}
        }
        layout.warp_root(frames, &points, around);
        limit_jerk::around_keyframes(layout, frames, constraints, around)?;
        if let Some(usual) = usual {
            limit_jerk::over_fixed_parts(layout, frames, constraints, usual)?;
        }
        // What was smoothed has moved the way a little.
        layout.warp_root(frames, &points, around);
        layout.to_bvh(frames)
    }

    fn must_have_a_patch(
        &self,
        example: &Example,
        frames: &Frames,
        layout: &MotionMatrix,
    ) -> Result<(), Error> {
        let (found, p) = (frames.frames(), self.settings.patch_size);
        if found >= p {
            return Ok(());
        }
        let rate = 1.0 / layout.frame_time();
        let problem = format!(
            "frames: {found} at {rate:.0} a second, allowed: at least `patch_size`, which is {p}"
        );
        let hint = "give a longer motion, or a smaller option `patch_size`";
        Err(Error::file(&example.file, problem, hint))
    }

    /// Frames of the new motion; `given` are the motions that set its length, with their frames.
    fn frames(
        &self,
        layout: &MotionMatrix,
        examples: &[Frames],
        given: &[(&Example, usize)],
    ) -> Result<usize, Error> {
        let all = examples.iter().map(Frames::frames).sum();
        let asked = self
            .length
            .map(|length| length.frames(all, layout.frame_time()));
        let frames = match (given.first(), asked) {
            (Some((_, frames)), _) => *frames,
            (None, asked) => asked.unwrap_or(2 * all),
        };
        let others = given
            .iter()
            .map(|(other, frames)| (other.file.as_str(), *frames));
        let mut others = others.chain(asked.map(|frames| ("option `length`", frames)));
        if let Some((other, found)) = others.find(|(_, found)| *found != frames) {
            let file = &given[0].0.file;
            let problem = format!("has {frames} frames, and {other} {found}");
            let hint = "a part that is fixed and a content set the length: leave option `length` out, and \
                        give motions of one length";
            return Err(Error::file(file, problem, hint));
        }
        in_range("length", frames, self.settings.patch_size..=MAX_FRAMES)
            .hint("a motion has at least one patch, `patch_size`, and at most two hours")?;
        Ok(frames)
    }
}

/// The largest of the motions' 95th percentiles of jerk.
fn usual_jerk<'a>(
    layout: &MotionMatrix,
    motions: impl Iterator<Item = &'a Frames>,
) -> Result<f64, Error> {
    let usual = motions.map(|motion| Ok(percentile_95(&jerks(&layout.to_bvh(motion)?))));
    let usual: Vec<f64> = usual.collect::<Result<_, Error>>()?;
    Ok(usual.into_iter().fold(0.0, f64::max))
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod keyframe_tests;
