//! Jobs, which make a new motion from BVH motions.

use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::{Refused, in_range};
use serde::{Deserialize, Serialize};

use crate::common_joints::unify;
use crate::foot_locking::{known_legs, lock_feet};
use crate::limit_jerk::{self, jerks, percentile_95};
use crate::metrics::Reference;
use crate::synthesis::{start_noise, synthesize_from, synthesize_like};
use crate::{
    Channels, CommonJoints, Constraint, Error, Example, Frames, JointNames, Keyframe, Length,
    Looping, Made, MatrixOptions, MotionMatrix, Part, Request, Seam, Settings, Synthesis, feet,
};

mod adaptation;
mod conflicts;

pub use adaptation::Adaptation;
use adaptation::{REPEATS, attempts};

/// Most attempts at a loop with a smooth seam.
const MAX_LOOPS: usize = 8;
/// A seam is smooth if its jumps are at most this part of the 95th percentile.
const SMOOTH_SEAM: f64 = 0.95;

/// Range of headings in the examples above which motions are relative to the heading, in degrees.
const TURNS: f64 = 120.0;

/// Coordinates of the root.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Heading {
    /// World coordinates, as in the published program.
    #[default]
    World,
    /// Relative to the heading.
    Relative,
    /// Relative to the heading if those of the examples range over more than 120 degrees and a joint
    /// travels over the ground.
    Auto,
}

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
    /// Coordinates of the root.
    pub heading: Heading,
    /// Tries further noise and a higher coherence as long as the motion is beyond the bounds of
    /// [`Quality`](crate::Quality), then locked feet. Jobs with content or fixed parts are not tried
    /// again, and feet of motions with key frames are not locked.
    pub adapts: bool,
    /// Division of the body.
    pub parts: PartChoice,
    /// Key frames with their source motions; the default source is the first example.
    pub keyframes: Vec<(Keyframe, Option<Example>)>,
    /// Fixed parts.
    pub fixed: Vec<Fixed>,
    /// Locks feet where the examples' feet rest. Locking also moves legs of key frames and of fixed
    /// parts.
    pub lock_feet: bool,
}

impl Job {
    /// Brings the examples and the motions of this job onto the joints that all have in common, with
    /// the names and bones of the first example. `None`, without a change, if all have one skeleton.
    ///
    /// Joints correspond by `names`, by the built-in joint maps of captures, or by their names
    /// without prefixes.
    ///
    /// # Errors
    /// Fails if, without `names` and maps, each of two skeletons has a joint that the other lacks, or
    /// if corresponding joints lie in another order along a limb.
    pub fn unify(
        &mut self,
        examples: &mut [Example],
        names: Option<&JointNames>,
    ) -> Result<Option<CommonJoints>, Error> {
        let fixed = self.fixed.iter_mut().map(|fixed| &mut fixed.motion);
        let sources = self.keyframes.iter_mut();
        let sources = sources.filter_map(|(_, source)| source.as_mut());
        let own = fixed.chain(self.content.as_mut()).chain(sources);
        let mut motions: Vec<&mut Example> = examples.iter_mut().chain(own).collect();
        unify(&mut motions, names, self.up)
    }

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
        let mut options = MatrixOptions {
            up: self.up,
            contacts,
            heading: self.heading == Heading::Relative,
        };
        let sources = self.keyframes.iter();
        let sources = sources.filter_map(|(_, source)| source.as_ref());
        // The fixed motions and the content set the length.
        let conditions: Vec<&Example> = self.fixed.iter().map(|fixed| &fixed.motion).collect();
        let conditions = [conditions, self.content.iter().collect()].concat();
        let others: Vec<&Example> = conditions.iter().copied().chain(sources).collect();
        let mut layout = MotionMatrix::with(examples, &others, options.clone())?;
        if self.heading == Heading::Auto && turns_around(&layout, examples)? {
            options.heading = true;
            // Not every skeleton has a heading.
            if let Ok(relative) = MotionMatrix::with(examples, &others, options) {
                layout = relative;
            }
        }
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
            PartChoice::Automatic => Part::supported(&layout),
            PartChoice::File { file, text } => Part::read(text, file, &layout)?,
        };
        let named = match &self.parts {
            PartChoice::File { .. } => &parts,
            _ => &Part::automatic(&layout),
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
            if part.root_trajectory {
                layout.start_like(&own.motion.bvh);
            }
            constraints.push(Constraint::Channels {
                channels: part.channels(&layout).channels,
                motion: motion.clone(),
            });
        }
        self.must_agree(&layout, &constraints, frames)?;
        if self.lock_feet {
            known_legs(&layout)?;
        }
        let groups: Vec<Channels> = parts.iter().map(|part| part.channels(&layout)).collect();
        let mut usual = None;
        if !fixed.is_empty() {
            for motion in matrices.iter().chain(fixed) {
                let jerk = percentile_95(&jerks(&layout.to_bvh(motion)?));
                usual = Some(f64::max(usual.unwrap_or(0.0), jerk));
            }
        }
        let originals = matrices.iter().map(|matrix| layout.to_bvh(matrix));
        let originals: Vec<Bvh> = originals.collect::<Result<_, _>>()?;
        let others = condition_matrices.iter();
        let others = others.map(|matrix| layout.to_bvh(matrix));
        let others: Vec<Bvh> = others.collect::<Result<_, _>>()?;
        let reference = Reference::new(&layout, &originals, &others);
        let reference = reference.expect("examples have frames");
        let is_loop = self.settings.looping != Looping::Off;
        let is_repeatable = content.is_none() && fixed.is_empty();
        let adapts = self.adapts && is_repeatable;
        let repeats = adapts && is_loop && constraints.is_empty();
        // A loop with key frames cannot be rotated: the first attempt with a smooth seam is taken.
        let by_seam = is_loop && !constraints.is_empty() && content.is_none();
        let lengths: Vec<usize> = matrices.iter().map(Frames::frames).collect();
        let tried = match (adapts, by_seam) {
            (true, _) => attempts(&self.settings, &lengths, frames, repeats),
            (false, true) => vec![self.settings.clone(); MAX_LOOPS],
            (false, false) => vec![self.settings.clone()],
        };
        let attempts = tried.len();
        let mut best: Option<(f64, usize, MotionMatrix, Synthesis, Bvh)> = None;
        for (attempt, settings) in tried.iter().enumerate() {
            let request = Request {
                examples: &matrices,
                frames,
                settings,
                groups: &groups,
                constraints: &constraints,
            };
            let mut synthesis = match content {
                Some(content) => synthesize_like(&request, content)?,
                None if repeats && REPEATS.contains(&attempt) => {
                    let key = Key::new(self.seed, Purpose::Matching).at(attempt as u64);
                    synthesize_like(&request, &repeated(&matrices, frames, key.uniform()))?
                }
                None => {
                    let first = request.levels()?.synthesis[0];
                    let noise = start_noise(self.seed, attempt as u64, first, layout.channels());
                    synthesize_from(&request, &noise)?
                }
            };
            if is_loop && constraints.is_empty() && content.is_none() {
                synthesis.rotate_to_smoothest_seam();
            }
            let mut layout = layout.clone();
            let mut bvh = self.finished(&mut layout, &mut synthesis.frames, &constraints, usual)?;
            if is_loop && constraints.is_empty() {
                // A loop of a motion in place must not travel.
                let mut frames = synthesis.frames.clone();
                layout.stay_in_place(&mut frames);
                let in_place = layout.to_bvh(&frames)?;
                let toe = |bvh: &Bvh| reference.quality(bvh).motion.toe_speed_while_low;
                let strays = reference.strays(&layout.path(&synthesis.frames));
                if strays || toe(&in_place) < toe(&bvh) {
                    (synthesis.frames, bvh) = (frames, in_place);
                }
            }
            let seam = by_seam.then(|| Seam::of(&layout, &bvh)).flatten();
            let mut excess = seam.map_or(0.0, |seam| seam.jump() / SMOOTH_SEAM);
            if adapts {
                excess = excess.max(reference.quality(&bvh).excess());
            }
            if best.as_ref().is_none_or(|(least, ..)| excess < *least) {
                best = Some((excess, attempt, layout, synthesis, bvh));
            }
            if excess <= 1.0 {
                break;
            }
        }
        let (_, attempt, layout, synthesis, mut bvh) = best.expect("one motion or more");
        let jerk = usual.map(|usual| percentile_95(&jerks(&bvh)) / usual.max(f64::MIN_POSITIVE));
        let mut sliding = None;
        // Feet that creep in every attempt are locked if the motion gains by it.
        let strict = reference.quality(&bvh).strict_excess();
        let creeps = adapts && strict > 1.0 && constraints.is_empty();
        if self.lock_feet || creeps {
            let (motion, origins) = ((&synthesis.frames, &bvh), &synthesis.origins);
            let locked = lock_feet(&layout, motion, examples, &parts, origins, is_loop);
            let seam = |bvh: &Bvh| Seam::of(&layout, bvh).filter(|_| is_loop).map(Seam::jump);
            let torn = |locked: &Bvh| seam(locked) > seam(&bvh).map(|jump| jump.max(SMOOTH_SEAM));
            let gains =
                |locked: &Bvh| reference.quality(locked).strict_excess() < strict && !torn(locked);
            match locked {
                Ok((locked, slid)) if self.lock_feet || gains(&locked) => {
                    (bvh, sliding) = (locked, Some(slid));
                }
                Err(error) if self.lock_feet => return Err(error),
                _ => {}
            }
        }
        Ok(Made {
            settings: tried[attempt].clone(),
            adaptation: Adaptation::of(attempt, attempts, repeats).filter(|_| adapts),
            quality: reference.quality(&bvh),
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

/// The examples one after another, again and again, `frames` in all, from a part of them on.
fn repeated(examples: &[Frames], frames: usize, part: f64) -> Frames {
    let all = Frames::joined(examples);
    let first = (part * all.frames() as f64) as usize;
    let values = (first..first + frames).flat_map(|t| all.frame(t % all.frames()));
    Frames::new(all.channels(), values.copied().collect())
}

/// True if the headings of the examples range over more than 120 degrees.
fn turns_around(layout: &MotionMatrix, examples: &[Example]) -> Result<bool, Error> {
    let matrices = examples.iter().map(|example| layout.to_frames(example));
    let matrices: Vec<Frames> = matrices.collect::<Result<_, _>>()?;
    let arc = layout.heading_arc(&matrices);
    Ok(arc.is_some_and(|arc| arc.to_degrees() > TURNS))
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod keyframe_tests;
