//! The evaluation of autoregressive motion: rollouts that continue the beginnings of held-out
//! clips.

use std::ops::ControlFlow;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::Joints;
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::counted;
use kinegrad_train::clips::captions::{ClipText, must_know_texts};
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, Group, OnStep, Results, clips_with_held_out, for_each_item,
    note_if_fewer,
};
use kinegrad_train::sampling::item_seed;
use kinegrad_train::{Error, TrainedModel};
use serde_json::json;

use super::load::text_input;
use super::report::{RolloutReport, TextReport, bone_lengths};
use super::sample::guidance_without_dropout;
use super::{FlowGenerator, FlowTables};

pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluation<'a>, Error> {
    let own: &FlowTables = trained.config().own();
    let purpose = "rollouts continue held-out clips";
    let own_data = &trained.config().data;
    let (data, dataset) = clips_with_held_out(own_data, trained, request, purpose)?;
    let settings = &own.evaluation;
    let begin = beginning(own.pose.history_frames + 1);
    let chosen = dataset.validation.evenly(settings.rollouts)?;
    let long_enough = chosen.iter().filter(|clip| clip.features.frames() > begin);
    let held_out: Vec<Arc<Clip>> = long_enough.cloned().collect();
    if held_out.is_empty() {
        let path = trained.path().display();
        let message = format!("no held-out clip of {path} has more than {begin} frames");
        let hint = "a rollout continues so many frames: hold out longer clips, or give another \
                    dataset with option `source`";
        return Err(Error::usage(message, hint));
    }
    let mut remarks = Vec::new();
    if held_out.len() < chosen.len() {
        remarks.push(format!(
            "note: {} of {} left out, with no more than {begin} frames",
            chosen.len() - held_out.len(),
            counted(chosen.len(), "clip")
        ));
    }
    let warning = guidance_without_dropout(trained, own);
    remarks.extend(warning.map(|warning| format!("warning: {warning}")));
    let wanted = settings.rollouts;
    remarks.extend(note_if_fewer(chosen.len(), wanted, "rollouts", trained));
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let joints = data.humanml3d.skeleton().joints();
    let coordinates = held_out.len() * settings.frames * 3 * joints;
    let request = request.clone();
    Ok(Evaluation {
        report: "eval-rollouts",
        memory: (coordinates * size_of::<f64>()) as u64,
        memory_hint: "fewer or shorter motions: `evaluation.rollouts`, `evaluation.frames`",
        remarks,
        measure: Box::new(move |on_step| {
            let generator = FlowGenerator::load(trained)?;
            evaluate(&generator, &held_out, &request, on_step)
        }),
    })
}

/// One rollout per clip for the clip's text, and one for the text of another clip with another
/// text, if any.
fn evaluate(
    generator: &FlowGenerator,
    held_out: &[Arc<Clip>],
    request: &EvaluationRequest,
    on_step: &mut OnStep<'_>,
) -> Result<Results, Error> {
    let config = generator.config();
    let (own, sampler) = (config.own::<FlowTables>(), &config.sampling.sampler);
    let settings = &own.evaluation;
    let skeleton = config.data.humanml3d.skeleton();
    let history_frames = own.pose.history_frames + 1;
    let begin = beginning(history_frames);
    let texts: Vec<Option<ClipText>> = held_out.iter().map(|clip| ClipText::of(clip)).collect();
    let other_text = |number: usize| {
        let others = texts[number + 1..].iter().chain(&texts[..number]);
        others.into_iter().find(|text| **text != texts[number])
    };
    let each = 1 + usize::from(other_text(0).is_some());
    let split = |clip: &Clip| {
        let joints = clip.features.joints();
        let history = part(&joints, begin - history_frames, begin);
        (history, part(&joints, begin, joints.frames()))
    };
    let frames = settings.frames;
    // The rollouts of each clip by text, and the number of velocity evaluations in the first
    // rollouts.
    let count = held_out.len();
    let rollouts = for_each_item(&request.group, count, on_step, |number, on_step| {
        let clip = &held_out[number];
        let (history, _) = split(clip);
        let key = Key::new(item_seed(request.seed, &clip.id), Purpose::Sampling);
        let (mut motions, mut evaluations, mut done) = (Vec::new(), 0, 0);
        for text in [Some(&texts[number]), other_text(number)] {
            let Some(text) = text else { continue };
            let mut rollout = generator.rollout(&history, frames, sampler, settings, key)?;
            rollout.push_text(&generator.text(text.as_ref())?)?;
            let mut positions = Vec::with_capacity(frames * skeleton.joints());
            let sample = || format!("after clip `{}`", clip.id);
            while let Some(frame) = FlowGenerator::next_frame(&mut rollout, &sample)? {
                positions.extend(frame);
                done += 1;
                if let ControlFlow::Break(()) = on_step("", done, each * frames) {
                    return Err(Error::Interrupted);
                }
            }
            if motions.is_empty() {
                evaluations = rollout.evaluations();
            }
            motions.push(positions);
        }
        Ok((motions, evaluations))
    })?;
    let (mut samples, mut real) = (Vec::new(), Vec::new());
    let mut pairs = [Vec::new(), Vec::new()];
    let mut evaluations = 0;
    for (clip, (motions, of_first)) in held_out.iter().zip(rollouts) {
        let (history, rest) = split(clip);
        let bones = bone_lengths(&skeleton, history.frame(history.frames() - 1));
        evaluations += of_first;
        for (which, positions) in motions.into_iter().enumerate() {
            let motion = Joints::new(positions, skeleton.joints()).expect("whole frames");
            let common = rest.frames().min(motion.frames());
            if common >= RolloutReport::SHORTEST {
                pairs[which].push((part(&motion, 0, common), part(&rest, 0, common)));
            }
            if which == 0 {
                samples.push((bones.clone(), motion));
            }
        }
        if rest.frames() >= RolloutReport::SHORTEST {
            real.push((bones, rest));
        }
    }
    let [own, other] = pairs.map(|pairs| TextReport::compute(&skeleton, &pairs));
    let per_frame = evaluations as f64 / (count * frames) as f64;
    let of_samples = RolloutReport::compute(&skeleton, &samples, &real);
    let of_real = RolloutReport::compute(&skeleton, &real, &real);
    let groups = |report: &RolloutReport, own: &TextReport, other: &TextReport| {
        let mut group = Group::new("rollouts", "", report);
        group.numbers.extend(TextReport::rows(own, other));
        vec![group]
    };
    let none = TextReport::default();
    Ok(Results {
        json: json!({
            "settings": settings,
            "sampler": sampler,
            "evaluations_per_frame": per_frame,
            "sampled": of_samples,
            "own_texts": own,
            "other_texts": other,
            "real": of_real,
        }),
        facts: Vec::new(),
        samples: Some(groups(&of_samples, &own, &other)),
        real: groups(&of_real, &none, &none),
        verdict: Vec::new(),
        remarks: vec![format!(
            "{per_frame:.1} velocity evaluations for each frame"
        )],
    })
}

/// Frames of a clip before a rollout; all runs with short histories have the same number.
fn beginning(history_frames: usize) -> usize {
    history_frames.max(RolloutReport::SHORTEST)
}

fn part(joints: &Joints, first: usize, end: usize) -> Joints {
    let positions = (first..end).flat_map(|t| joints.frame(t).to_vec());
    Joints::new(positions.collect(), joints.joints()).expect("whole frames")
}
