//! Metrics of composed motion, and of transitions between texts.

use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{Features, Joints, Skeleton};
use kinegrad_motion::metrics::{
    FeatureMoments, TransitionJerk, frechet_distance, jerk_of_frames, mean_jerk, skating_ratio,
};
use kinegrad_train::evaluation::{Better, Metrics, Number};
use serde::Serialize;

/// Means over motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ComposedReport {
    pub motions: usize,
    pub jerk: Option<f64>,
    /// Share of the frame steps in which a toe slides, as published.
    pub foot_skating: Option<f64>,
    /// Lowest height of any joint above the floor, over all frames, meters.
    pub lowest_joint: Option<f64>,
    pub speed: Option<f64>,
    pub transitions: usize,
    /// Peak jerk around transitions ([`TransitionJerk::peak`]), or around the middles of real
    /// clips; meters per frame cubed.
    pub peak_jerk: Option<f64>,
    /// Area between the jerk and the mean jerk of real windows ([`TransitionJerk::area`]).
    pub area_under_jerk: Option<f64>,
    /// Fréchet distance between the mean normalized features of segments and of real clips.
    pub frechet_distance: Option<f64>,
}

pub(super) struct Measured<'a> {
    /// Complete motions.
    pub motions: &'a [Joints],
    /// Windows around transitions; each window is decoded from its own first frame.
    pub windows: &'a [Joints],
    /// Clips, or the part of a composition that belongs to one text.
    pub segments: &'a [Features],
}

impl Measured<'_> {
    /// The mean jerk of all windows, meters per frame cubed; `None` without windows.
    pub fn window_jerk(&self) -> Option<f64> {
        mean(self.windows.iter().flat_map(jerk_of_frames).collect())
    }

    /// The report; `real` are the real segments for comparison.
    pub fn report(
        &self,
        skeleton: &Skeleton,
        statistics: &Statistics,
        real_jerk: Option<f64>,
        real: Option<&[Features]>,
    ) -> ComposedReport {
        let fps = skeleton.description().fps;
        let feet = skeleton.contact_joints();
        let each = |of: &dyn Fn(&Joints) -> Option<f64>| {
            mean(self.motions.iter().filter_map(of).collect())
        };
        let curves: Vec<Vec<f64>> = self.windows.iter().map(jerk_of_frames).collect();
        let transition = TransitionJerk::of(&curves, real_jerk.unwrap_or(0.0));
        ComposedReport {
            motions: self.motions.len(),
            jerk: each(&|joints| mean_jerk(joints, fps)),
            // The toes are the second of each pair of contacts.
            foot_skating: each(&|joints| skating_ratio(joints, fps, &[feet[1], feet[3]])),
            lowest_joint: each(&|joints| {
                let heights = joints.as_slice().iter().map(|place| place[1]);
                heights.reduce(f64::min)
            }),
            speed: each(&|joints| {
                let root = joints.track(0);
                let step =
                    |pair: &[[f64; 3]]| (pair[1][0] - pair[0][0]).hypot(pair[1][2] - pair[0][2]);
                let metres: f64 = root.windows(2).map(step).sum();
                (root.len() > 1).then(|| metres * fps / (root.len() - 1) as f64)
            }),
            transitions: self.windows.len(),
            peak_jerk: transition.map(|found| found.peak),
            area_under_jerk: transition.zip(real_jerk).map(|(found, _)| found.area),
            frechet_distance: real.and_then(|real| distance(self.segments, real, statistics)),
        }
    }
}

fn mean(values: Vec<f64>) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Fréchet distance between the mean normalized features of clips and of real clips.
pub(super) fn distance(
    clips: &[Features],
    real: &[Features],
    statistics: &Statistics,
) -> Option<f64> {
    let moments = |clips: &[Features]| {
        let rows = clips.iter().map(|clip| means(clip, statistics));
        FeatureMoments::compute(&rows.collect::<Vec<_>>())
    };
    Some(frechet_distance(&moments(clips)?, &moments(real)?))
}

/// The mean over frames of each normalized channel.
fn means(features: &Features, statistics: &Statistics) -> Vec<f64> {
    let channels = features.layout().channels();
    let rows = statistics.normalize(features.as_slice());
    let mut sums = vec![0.0; channels];
    for row in rows.chunks(channels) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += f64::from(*value);
        }
    }
    let frames = features.frames() as f64;
    sums.iter().map(|sum| sum / frames).collect()
}

impl Metrics for ComposedReport {
    fn rows(&self) -> Vec<Number> {
        let main = [
            ("jerk", Better::NearReal),
            ("foot skating", Better::NearReal),
            ("speed", Better::NearReal),
            ("peak jerk", Better::NearReal),
            ("area under the jerk", Better::Lower),
            ("Fréchet distance", Better::Lower),
        ];
        let rows = Number::list([
            ("jerk", self.jerk, ", m/s³"),
            ("foot skating", self.foot_skating, ""),
            ("lowest joint", self.lowest_joint, ", m"),
            ("speed", self.speed, ", m/s"),
            ("peak jerk", self.peak_jerk, ", m/frame³"),
            ("area under the jerk", self.area_under_jerk, ", m/frame³"),
            ("Fréchet distance", self.frechet_distance, ""),
        ]);
        Number::mark(rows, &main)
    }
}
