//! Jobs, which make a new motion from BVH motions.

use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_settings::{Refused, in_range};

use crate::foot_locking::lock_feet;
use crate::limit_jerk::{self, jerks, percentile_95};
use crate::synthesis::{start_noise, synthesize_from, synthesize_like};
use crate::{
    Channels, Constraint, Error, Example, Frames, Keyframe, Length, Looping, Made, MatrixOptions,
    MotionMatrix, Part, Request, Seam, Settings, Synthesis, feet,
};

mod conflicts;

/// Most attempts at a loop with a smooth seam.
const MAX_LOOPS: u64 = 8;
/// A seam is smooth if its jumps are at most this part of the 95th percentile.
const SMOOTH_SEAM: f64 = 0.95;

/// Division of the body into parts.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum PartChoice {
    /// One part.
    #[default]
    Whole,
    /// By the branches of the skeleton.
    Automatic,
    /// From a TOML file.
    File {
        /// The file, for messages.
        file: String,
        /// Its text.
        text: String,
    },
}

/// A body part fixed to a given motion.
#[derive(Clone, Debug)]
pub struct Fixed {
    /// The part, named as in [`Part::named`].
    pub part: String,
    /// The motion, as long as the new motion.
    pub motion: Example,
}

/// A job. The default is twice the length of the examples and the settings of the published
/// program.
#[derive(Clone, Debug, Default)]
pub struct Job {
    /// The settings of the synthesis.
    pub settings: Settings,
    /// Length of the motion; by default the length of the fixed motions or the content, else twice
    /// the examples.
    pub length: Option<Length>,
    /// Seed of the noise.
    pub seed: u64,
    /// A motion whose coarse level replaces the noise: the new motion has this content in the style
    /// of the examples, at the same length.
    pub content: Option<Example>,
    /// The axis that points up in the files.
    pub up: UpAxis,
    /// Matches foot contacts as well.
    pub contacts: bool,
    /// Makes the root relative to its heading.
    pub heading: bool,
    /// Division of the body.
    pub parts: PartChoice,
    /// Key frames with their source motions; the default source is the first example.
    pub keyframes: Vec<(Keyframe, Option<Example>)>,
    /// Fixed parts.
    pub fixed: Vec<Fixed>,
    /// Locks feet where the examples' feet rest. Locking also moves legs of key frames and of fixed
    /// parts, and the seam of a loop.
    pub lock_feet: bool,
}

impl Job {
    /// Synthesises a motion.
    ///
    /// # Errors
    /// Fails for settings out of range, motions that do not match, examples shorter than a patch,
    /// and unknown parts or times.
    pub fn make(&self, examples: &[Example]) -> Result<Made, Error> {
        self.settings.validate()?;
        let contacts = match examples.first() {
            Some(first) if self.contacts => feet(first.bvh.joints()),
            _ => Vec::new(),
        };
        let options = MatrixOptions {
            up: self.up,
            contacts,
            heading: self.heading,
        };
        let sources = self.keyframes.iter();
        let sources = sources.filter_map(|(_, source)| source.as_ref());
        // The fixed motions and the content set the length.
        let conditions: Vec<&Example> = self.fixed.iter().map(|fixed| &fixed.motion).collect();
        let conditions = [conditions, self.content.iter().collect()].concat();
        let others: Vec<&Example> = conditions.iter().copied().chain(sources).collect();
        let layout = MotionMatrix::with(examples, &others, options)?;
        if self.keyframes.iter().any(|(key, _)| key.place.is_some()) {
            let motions = examples.iter().chain(others);
            layout.must_have_upright_root(motions, "`place` of a key frame")?;
        }
        let to_frames = |example: &Example| layout.to_frames(example);
        let matrices: Vec<Frames> = examples.iter().map(to_frames).collect::<Result<_, _>>()?;
        let condition_matrices = conditions.iter().map(|example| layout.to_frames(example));
        let condition_matrices: Vec<Frames> = condition_matrices.collect::<Result<_, _>>()?;
        let motions = examples.iter().chain(conditions.iter().copied());
        for (example, frames) in motions.zip(matrices.iter().chain(&condition_matrices)) {
            let (found, p) = (frames.frames(), self.settings.patch_size);
            if found < p {
                let rate = 1.0 / layout.frame_time();
                let problem = format!(
                    "frames: {found} at {rate:.0} a second, allowed: at least `patch_size`, which is {p}"
                );
                let hint = "use a longer motion, or a smaller option `patch_size`";
                return Err(Error::file(&example.file, problem, hint));
            }
        }
        let (fixed, content) = condition_matrices.split_at(self.fixed.len());
        let content = content.first();
        let parts = match &self.parts {
            PartChoice::Whole => vec![Part::body(&layout)],
            PartChoice::Automatic => Part::automatic(&layout),
            PartChoice::File { file, text } => Part::read(text, file, &layout)?,
        };
        let named = match &self.parts {
            PartChoice::Whole => &Part::automatic(&layout),
            _ => &parts,
        };
        let lengths = condition_matrices.iter().map(Frames::frames);
        let lengths: Vec<(&Example, usize)> = conditions.into_iter().zip(lengths).collect();
        let frames = self.frames(&layout, &matrices, &lengths)?;
        let mut constraints = Vec::new();
        for (keyframe, source) in &self.keyframes {
            let (source, poses) = match source {
                Some(source) => (source, &layout.to_frames(source)?),
                None => (&examples[0], &matrices[0]),
            };
            constraints.push(keyframe.constraint(&layout, named, source, poses, frames)?);
        }
        for (own, motion) in self.fixed.iter().zip(fixed) {
            let part = Part::named(&own.part, named, &layout, "fixed part")?;
            constraints.push(Constraint::Channels {
                channels: part.channels(&layout).channels,
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
        let mut usual = None;
        if !fixed.is_empty() {
            for motion in matrices.iter().chain(fixed) {
                let jerk = percentile_95(&jerks(&layout.to_bvh(motion)?));
                usual = Some(f64::max(usual.unwrap_or(0.0), jerk));
            }
        }
        let is_loop = self.settings.looping != Looping::Off;
        // A loop with key frames cannot be rotated: the first attempt with a smooth seam is taken.
        let attempts = match is_loop && !constraints.is_empty() && content.is_none() {
            true => MAX_LOOPS,
            false => 1,
        };
        let first = request.levels()?.synthesis[0];
        let mut best: Option<(f64, MotionMatrix, Synthesis, Bvh)> = None;
        for attempt in 0..attempts {
            let mut synthesis = match content {
                Some(content) => synthesize_like(&request, content)?,
                None => {
                    let noise = start_noise(self.seed, attempt, first, layout.channels());
                    synthesize_from(&request, &noise)?
                }
            };
            if is_loop && constraints.is_empty() && content.is_none() {
                synthesis.rotate_to_smoothest_seam();
            }
            let mut layout = layout.clone();
            let bvh = self.finished(&mut layout, &mut synthesis.frames, &constraints, usual)?;
            let seam = (attempts > 1).then(|| Seam::of(&layout, &bvh)).flatten();
            let jump = seam.map_or(0.0, |seam| seam.jump());
            if best.as_ref().is_none_or(|(least, ..)| jump < *least) {
                best = Some((jump, layout, synthesis, bvh));
            }
            if jump <= SMOOTH_SEAM {
                break;
            }
        }
        let (_, layout, synthesis, mut bvh) = best.expect("one motion or more");
        let jerk = usual.map(|usual| percentile_95(&jerks(&bvh)) / usual.max(f64::MIN_POSITIVE));
        let mut sliding = None;
        if self.lock_feet {
            let (locked, slid) = lock_feet(&layout, &bvh, examples, &parts, &synthesis.origins)?;
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

    /// Warps the trajectory through the places of key frames, limits jerk, and converts to BVH.
    /// `usual`: with fixed parts, the largest 95th percentile of jerk of the source motions.
    fn finished(
        &self,
        layout: &mut MotionMatrix,
        frames: &mut Frames,
        constraints: &[Constraint],
        usual: Option<f64>,
    ) -> Result<Bvh, Error> {
        let is_loop = self.settings.looping != Looping::Off;
        if is_loop {
            layout.close_heading(frames);
        }
        let points = self.keyframes.iter().filter_map(|(keyframe, _)| {
            let frame = (keyframe.time / layout.frame_time()).round() as usize;
            Some((frame, keyframe.place?))
        });
        let points: Vec<(usize, [f64; 2])> = points.collect();
        match points.iter().min_by_key(|(frame, _)| *frame) {
            Some((0, place)) => layout.start_at(*place),
            // The start of a loop is free: the first place determines the loop's position.
            Some(point) if is_loop => layout.start_through(frames, *point),
            _ => {}
        }
        layout.warp_root(frames, &points, is_loop);
        limit_jerk::around_keyframes(layout, frames, constraints, is_loop)?;
        if let Some(usual) = usual {
            limit_jerk::over_fixed_parts(layout, frames, constraints, usual)?;
        }
        // Smoothing moves the trajectory slightly.
        layout.warp_root(frames, &points, is_loop);
        layout.to_bvh(frames)
    }

    /// Length of the new motion; `conditions`: the motions that set the length, with their numbers
    /// of frames.
    fn frames(
        &self,
        layout: &MotionMatrix,
        examples: &[Frames],
        conditions: &[(&Example, usize)],
    ) -> Result<usize, Error> {
        let all = examples.iter().map(Frames::frames).sum();
        let requested = self.length;
        let requested = requested.map(|length| length.frames(all, layout.frame_time()));
        let frames = conditions.first().map(|(_, frames)| *frames);
        let frames = frames.or(requested).unwrap_or(2 * all);
        let others = conditions.iter();
        let others = others.map(|(other, found)| (other.file.as_str(), *found));
        let mut others = others.chain(requested.map(|frames| ("option `length`", frames)));
        if let Some((other, found)) = others.find(|(_, found)| *found != frames) {
            let problem = format!("has {frames} frames, and {other} {found}");
            let hint = "fixed parts and the content set the length: leave option `length` out, and \
                        name motions of one length";
            return Err(Error::file(&conditions[0].0.file, problem, hint));
        }
        in_range("length", frames, self.settings.patch_size..=MAX_FRAMES)
            .hint("a motion has at least one patch, `patch_size`, and at most two hours")?;
        Ok(frames)
    }
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod keyframe_tests;
