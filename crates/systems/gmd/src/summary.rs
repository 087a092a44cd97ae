//! The printed summary of sampled clips with goals.

use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::metrics::{GoalReport, GoalSample};
use kinegrad_train::sampling::GroundRecord;

use super::generate::{ClipRequest, GeneratedClip};

/// The frame of the paths' fastest step, and the fastest step of training, as two lines.
pub(super) fn speeds(grounds: &[GroundRecord]) -> String {
    let steps = grounds.iter().enumerate();
    let steps = steps.filter_map(|(number, ground)| Some((number, ground, ground.fastest_step?)));
    let Some((number, ground, step)) = steps.max_by(|a, b| a.2.speed.total_cmp(&b.2.speed)) else {
        return String::new();
    };
    let of = match grounds.len() {
        1 => String::new(),
        _ => format!(" of sample {number:03}"),
    };
    let (frame, most) = (step.frame, ground.fastest_of_training);
    let (place, name) = ("frame of fastest step", "fastest of training");
    format!("\n{place:<24} {frame:>9}{of}\n{name:<24} {most:>9.4} m/s")
}

/// Distances of the clips from their goals.
pub(super) fn report(
    samples: &[GeneratedClip],
    requests: &[ClipRequest],
    skeleton: &Skeleton,
) -> Option<String> {
    let measured = samples
        .iter()
        .zip(requests)
        .filter_map(|(sample, request)| {
            Some(GoalSample {
                goal: request.goal.as_ref()?,
                ground: &sample.ground,
                joints: None,
            })
        });
    let measured: Vec<GoalSample> = measured.collect();
    let (fps, feet) = (skeleton.description().fps, skeleton.contact_joints());
    (!measured.is_empty()).then(|| GoalReport::compute(&measured, fps, &feet).to_string())
}
