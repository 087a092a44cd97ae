//! The evaluation of motion along paths: samples follow the root paths of held-out clips, with the
//! clips' captions and lengths.

use std::sync::Arc;
use std::time::Instant;

use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::metrics::mean;
use kinegrad_motion::path::PathReport;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::Error;
use kinegrad_train::clips::TimedPrompt;
use kinegrad_train::clips::captions::ClipText;
use kinegrad_train::clips::path_target::{PathTarget, features_of, root_trajectory};
use kinegrad_train::evaluation::{
    Better, EvaluationRequest, Metrics, Number, OnStep, for_each_item,
};
use kinegrad_train::sampling::item_seed;
use serde::Serialize;

use super::path::finish;
use super::report::distance;
use super::{BpeTables, Composer};

/// Length of the shortest path that a sample follows, meters; excludes clips in place.
const SHORTEST: f64 = 2.0;

/// Path errors and quality of motions: means over motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct PathFollowingReport {
    pub motions: usize,
    /// Share of the asked distance that the root travels along the path.
    pub progress: Option<f64>,
    /// Mean distance of the root from the path, meters.
    pub mean_distance: Option<f64>,
    /// Mean over motions of the root's largest distance from the path, meters.
    pub largest_distance: Option<f64>,
    /// Mean distance of the root from its target position in each frame, meters.
    pub mean_error: Option<f64>,
    /// Mean angle between the headings of body and path, degrees.
    pub heading_error: Option<f64>,
    /// Sliding distance of low, slow feet per frame, meters.
    pub slide: Option<f64>,
    /// Share of the frame steps in which a toe slides, as published.
    pub foot_skating: Option<f64>,
    /// Share of the frames whose lowest joint is more than 3 cm above the floor.
    pub floating: Option<f64>,
    pub jerk: Option<f64>,
    /// 99th percentile of the jerk.
    pub jerk_99: Option<f64>,
    /// Fréchet distance of the mean normalised features from those of the clips.
    pub frechet_distance: Option<f64>,
    pub seconds: Option<f64>,
}

impl PathFollowingReport {
    fn of(reports: &[PathReport], frechet_distance: Option<f64>, seconds: Option<f64>) -> Self {
        let each = |of: &dyn Fn(&PathReport) -> Option<f64>| mean(reports.iter().map(of));
        Self {
            motions: reports.len(),
            progress: each(&|report| Some(report.travelled / report.asked)),
            mean_distance: each(&|report| Some(report.mean_distance)),
            largest_distance: each(&|report| Some(report.largest_distance)),
            mean_error: each(&|report| Some(report.mean_error)),
            heading_error: each(&|report| report.heading_error),
            slide: each(&|report| report.slide),
            foot_skating: each(&|report| report.body.foot_skating),
            floating: each(&|report| report.body.floating),
            jerk: each(&|report| report.body.jerk),
            jerk_99: each(&|report| report.body.jerk_99),
            frechet_distance,
            seconds,
        }
    }
}

impl Metrics for PathFollowingReport {
    fn rows(&self) -> Vec<Number> {
        let main = [
            ("progress", Better::NearReal),
            ("error in time", Better::Lower),
            ("foot skating", Better::NearReal),
        ];
        let rows = Number::list([
            ("progress", self.progress, ""),
            ("distance from the path", self.mean_distance, ", m"),
            ("largest distance", self.largest_distance, ", m"),
            ("error in time", self.mean_error, ", m"),
            ("heading error", self.heading_error, ", degrees"),
            ("slide", self.slide, ", m/frame"),
            ("foot skating", self.foot_skating, ""),
            ("floating frames", self.floating, ""),
            ("jerk", self.jerk, ", m/s³"),
            ("jerk, 99th percentile", self.jerk_99, ", m/s³"),
            ("Fréchet distance", self.frechet_distance, ""),
            ("seconds", self.seconds, ""),
        ]);
        Number::mark(rows, &main)
    }
}

/// The metrics of samples, and of the clips that provide the samples' paths.
pub(super) struct PathEvaluation {
    pub samples: PathFollowingReport,
    pub real: PathFollowingReport,
}

struct Walk {
    id: String,
    text: Option<ClipText>,
    joints: Joints,
    target: PathTarget,
}

impl Walk {
    /// The first `max_frames` frames of a clip and its path; `None` if the path is shorter than
    /// [`SHORTEST`].
    fn of(clip: &Clip, max_frames: usize, fps: f64) -> Option<Self> {
        let frames = clip.features.frames().min(max_frames);
        let joints = clip.features.slice(0..frames).joints();
        let target = PathTarget::through(root_trajectory(&joints.track(0), fps)).ok()?;
        (target.line.length() >= SHORTEST).then(|| Self {
            id: clip.id.clone(),
            text: ClipText::of(clip),
            joints,
            target,
        })
    }
}

/// Generates motion along the paths of `num_paths` clips, evenly chosen among walking clips. Each
/// motion has the clip's length, at most `max_frames`.
pub(super) fn evaluate(
    composer: &Composer,
    held_out: &[Arc<Clip>],
    max_frames: usize,
    request: &EvaluationRequest,
    on_step: &mut OnStep<'_>,
) -> Result<PathEvaluation, Error> {
    let config = composer.config();
    let settings = &config.own::<BpeTables>().evaluation;
    let (humanml3d, sampler) = (&config.data.humanml3d, &config.sampling.sampler);
    let skeleton = humanml3d.skeleton();
    let fps = skeleton.description().fps;
    let walks = held_out
        .iter()
        .filter_map(|clip| Walk::of(clip, max_frames, fps));
    let walks: Vec<Walk> = walks.collect();
    if walks.is_empty() {
        let message = format!("no held-out clip walks {SHORTEST} m: there is no path to follow");
        return Err(Error::usage(message, "set `evaluation.num_paths = 0`"));
    }
    let count = settings.num_paths.min(walks.len());
    let chosen = (0..count).map(|n| &walks[n * walks.len() / count]);
    let chosen: Vec<&Walk> = chosen.collect();
    let samples = for_each_item(&request.group, count, on_step, |number, on_step| {
        let (walk, start) = (chosen[number], Instant::now());
        let line = TimedPrompt {
            text: walk.text.clone(),
            frames: walk.joints.frames(),
        };
        let key = Key::new(item_seed(request.seed, &walk.id), Purpose::Sampling);
        let (target, on_step) = (Some(&walk.target), &mut |done, all| {
            on_step("paths", done, all)
        });
        let features = composer.compose(&[line], sampler, settings, target, key, on_step)?;
        let followed = finish(&walk.target, &features, &skeleton, &settings.path)?;
        let seconds = start.elapsed().as_secs_f64();
        Ok((followed.report, followed.joints, seconds))
    })?;
    let (mut reports, mut features) = ([vec![], vec![]], [vec![], vec![]]);
    let mut seconds = 0.0;
    for (walk, (report, joints, taken)) in chosen.into_iter().zip(samples) {
        seconds += taken;
        let PathTarget { line, course, .. } = &walk.target;
        let real = PathReport::of(&walk.joints, &skeleton, line, course, 0.0)?;
        let both = [(report, &joints), (real, &walk.joints)];
        for (side, (report, joints)) in both.into_iter().enumerate() {
            reports[side].push(report);
            features[side].push(features_of(joints, &skeleton, humanml3d.root)?);
        }
    }
    let apart = distance(&features[0], &features[1], composer.statistics()?);
    Ok(PathEvaluation {
        samples: PathFollowingReport::of(&reports[0], apart, Some(seconds / count as f64)),
        real: PathFollowingReport::of(&reports[1], None, None),
    })
}
