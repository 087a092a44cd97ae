//! The evaluation of motion along paths: the ways of held-out clips are followed, for their captions and
//! in their lengths.

use std::sync::Arc;
use std::time::Instant;

use kinegrad_data::humanml::Clip;
use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::humanml::{Features, Joints, Root, Skeleton};
use kinegrad_motion::metrics::mean;
use kinegrad_motion::path::PathReport;
use kinegrad_random::{Key, Purpose};
use serde::Serialize;

use super::path::finish;
use super::report::distance;
use super::{ComposeEvaluationConfig, Composer};
use crate::clips::TimedPrompt;
use crate::clips::captions::ClipText;
use crate::clips::path_target::{PathTarget, features_of, way};
use crate::error::Error;
use crate::evaluation::{EvaluationRequest, OnStep};
use crate::sampling::item_seed;

/// The shortest way that is followed, metres: who stays where he is follows none.
const SHORTEST: f64 = 2.0;

/// How motions follow their paths, and how they look meanwhile: means over motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WaysReport {
    /// Motions.
    pub motions: usize,
    /// Mean distance of the root from the path, metres.
    pub mean_distance: Option<f64>,
    /// The largest distance of each motion, metres.
    pub largest_distance: Option<f64>,
    /// Mean distance of the root from where it should be in that frame, metres.
    pub mean_error: Option<f64>,
    /// Mean angle between where the body faces and where the path leads, degrees.
    pub heading_error: Option<f64>,
    /// Way per frame of feet that are low and slow, metres.
    pub slide: Option<f64>,
    /// Share of the steps in which a toe slides, as published.
    pub foot_skating: Option<f64>,
    /// Mean jerk of the joints, metres per second cubed.
    pub jerk: Option<f64>,
    /// Fréchet distance of the mean normalised features from those of the clips.
    pub frechet_distance: Option<f64>,
    /// Seconds that a motion took.
    pub seconds: Option<f64>,
}

impl WaysReport {
    fn of(reports: &[PathReport], frechet_distance: Option<f64>, seconds: Option<f64>) -> Self {
        let each = |of: &dyn Fn(&PathReport) -> Option<f64>| mean(reports.iter().map(of));
        Self {
            motions: reports.len(),
            mean_distance: each(&|report| Some(report.mean_distance)),
            largest_distance: each(&|report| Some(report.largest_distance)),
            mean_error: each(&|report| Some(report.mean_error)),
            heading_error: each(&|report| report.heading_error),
            slide: each(&|report| report.slide),
            foot_skating: each(&|report| report.foot_skating),
            jerk: each(&|report| report.jerk),
            frechet_distance,
            seconds,
        }
    }

    /// The metrics: name, value and unit.
    pub fn rows(&self) -> [(&'static str, Option<f64>, &'static str); 9] {
        [
            ("distance from the path", self.mean_distance, ", m"),
            ("largest distance", self.largest_distance, ", m"),
            ("error in time", self.mean_error, ", m"),
            ("heading error", self.heading_error, ", degrees"),
            ("slide", self.slide, ", m/frame"),
            ("foot skating", self.foot_skating, ""),
            ("jerk", self.jerk, ", m/s³"),
            ("Fréchet distance", self.frechet_distance, ""),
            ("seconds", self.seconds, ""),
        ]
    }
}

/// What is measured of drawn motions and of the clips whose ways they follow.
#[derive(Clone, Debug, Serialize)]
pub(super) struct WaysEvaluation {
    /// The drawn motions.
    pub drawn: WaysReport,
    /// The clips.
    pub real: WaysReport,
}

/// A clip and its way.
struct Walked {
    id: String,
    text: Option<ClipText>,
    joints: Joints,
    target: PathTarget,
}

/// The first `most` frames of a clip and its way; none of a clip that stays where it is.
fn walked(clip: &Clip, most: usize, fps: f64) -> Option<Walked> {
    let frames = clip.features.frames().min(most);
    let joints = clip.features.slice(0..frames).joints();
    let target = PathTarget::through(way(&joints.track(0), fps)).ok()?;
    (target.line.length() >= SHORTEST).then(|| Walked {
        id: clip.id.clone(),
        text: ClipText::of(clip),
        joints,
        target,
    })
}

/// Draws motions along the ways of `settings.num_paths` of the clips, evenly from those that go
/// somewhere, each as long as its clip and `most` frames at most.
///
/// # Errors
/// [`Error::Usage`] if no clip goes anywhere; as [`Composer::compose`].
pub(super) fn evaluate(
    composer: &Composer,
    held_out: &[Arc<Clip>],
    settings: &ComposeEvaluationConfig,
    sampler: &SamplerConfig,
    most: usize,
    request: &EvaluationRequest,
    on_step: &mut OnStep<'_>,
) -> Result<WaysEvaluation, Error> {
    let (seed, together) = (request.seed, &request.together);
    let humanml3d = &composer.config().data.humanml3d;
    let skeleton = humanml3d.skeleton.skeleton();
    let fps = skeleton.description().fps;
    let all: Vec<Walked> = held_out
        .iter()
        .filter_map(|clip| walked(clip, most, fps))
        .collect();
    if all.is_empty() {
        return Err(Error::usage(
            format!("no held-out clip goes {SHORTEST} m: there is no way to follow"),
            "set `evaluation.num_paths = 0`",
        ));
    }
    let count = settings.num_paths.min(all.len());
    let chosen: Vec<&Walked> = (0..count).map(|n| &all[n * all.len() / count]).collect();
    let followed = together.each(count, |number| {
        let [before, count] = together.own_of(number, count);
        let (clip, begun) = (chosen[number], Instant::now());
        let line = TimedPrompt {
            text: clip.text.clone(),
            frames: clip.joints.frames(),
        };
        let target = &clip.target;
        let features = composer.compose(
            &[line],
            sampler,
            settings,
            Some(target),
            Key::new(item_seed(seed, &clip.id), Purpose::Sampling),
            &mut |done, steps| on_step("paths", before * steps + done, count * steps),
        )?;
        let followed = finish(target, &features, &skeleton, &settings.path)?;
        let seconds = begun.elapsed().as_secs_f64();
        Ok((followed.report, followed.joints, seconds))
    })?;
    let (mut drawn, mut real) = (Measured::default(), Measured::default());
    let mut seconds = 0.0;
    for (clip, (report, joints, taken)) in chosen.into_iter().zip(followed) {
        seconds += taken;
        let root = humanml3d.root;
        drawn.push(report, &joints, &skeleton, root)?;
        let PathTarget { line, course, .. } = &clip.target;
        let report = PathReport::of(&clip.joints, &skeleton, line, course)?;
        real.push(report, &clip.joints, &skeleton, root)?;
    }
    let apart = distance(&drawn.features, &real.features, composer.statistics()?);
    Ok(WaysEvaluation {
        drawn: WaysReport::of(&drawn.reports, apart, Some(seconds / count as f64)),
        real: WaysReport::of(&real.reports, None, None),
    })
}

/// What is measured of some motions.
#[derive(Default)]
struct Measured {
    reports: Vec<PathReport>,
    features: Vec<Features>,
}

impl Measured {
    fn push(
        &mut self,
        report: PathReport,
        joints: &Joints,
        skeleton: &Skeleton,
        root: Root,
    ) -> Result<(), Error> {
        self.reports.push(report);
        self.features.push(features_of(joints, skeleton, root)?);
        Ok(())
    }
}
