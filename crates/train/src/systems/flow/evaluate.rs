//! The evaluation of motion that goes on: rollouts from the beginnings of held-out clips.

use std::ops::ControlFlow;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_random::{Key, Purpose};
use serde::Serialize;
use serde_json::to_value;

use super::networks::text_input;
use super::report::{RolloutReport, TextReport};
use super::sample::untaught_guidance;
use super::{FlowGenerator, FlowTables, RolloutEvaluationConfig};
use crate::TrainedModel;
use crate::clips::captions::{ClipText, must_know_texts};
use crate::clips::{dataset_or, with_held_out};
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group, Number, OnStep};
use crate::sampling::item_seed;
use crate::together::Together;

/// Results of an evaluation of rollouts.
#[derive(Clone, Debug, Serialize)]
struct RolloutEvaluation {
    /// Name of the run.
    run: String,
    /// Step of its checkpoint.
    step: u64,
    /// Seed of the noise.
    seed: u64,
    /// The settings.
    settings: RolloutEvaluationConfig,
    /// The solver.
    sampler: SamplerConfig,
    /// Velocities asked for, of each frame.
    evaluations_per_frame: f64,
    /// The generated motion.
    drawn: RolloutReport,
    /// How far it is from what follows, told the clips' own texts.
    own_texts: TextReport,
    /// The same, told the texts of other clips.
    other_texts: TextReport,
    /// What follows in the held-out clips.
    real: RolloutReport,
}

/// An evaluation of rollouts.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--audio-ablation", "--trajectory-run"],
        trained.path(),
        "a run of recipe `flow`",
        "leave it out",
    )?;
    let own: &FlowTables = trained.config().own();
    let sampler = trained.config().sampling.sampler.clone();
    let data = dataset_or(&trained.config().data, request.source.as_deref());
    let dataset = with_held_out(
        &data,
        trained.path(),
        "motions go on from held-out clips",
        &request.together,
    )?;
    let mut remarks = Vec::new();
    let begin = beginning(own.pose.history_frames + 1);
    let asked_for = dataset.validation.evenly(own.evaluation.rollouts)?;
    let long_enough = asked_for
        .iter()
        .filter(|clip| clip.features.frames() > begin);
    let held_out: Vec<Arc<Clip>> = long_enough.cloned().collect();
    if held_out.is_empty() {
        let message = format!(
            "no held-out clip of {} has more than {begin} frames",
            trained.path().display()
        );
        let hint = "a motion goes on from so many: hold out longer clips, or name others with option `source`";
        return Err(Error::usage(message, hint));
    }
    if held_out.len() < asked_for.len() {
        remarks.push(format!(
            "note: {} of {} clips have no more than {begin} frames and are left out",
            asked_for.len() - held_out.len(),
            asked_for.len()
        ));
    }
    if let Some(warning) = untaught_guidance(trained, own) {
        remarks.push(format!("warning: {warning}"));
    }
    let asked = own.evaluation.clone();
    if asked_for.len() < asked.rollouts {
        remarks.push(format!(
            "note: {} clips are held out for {}, fewer than {} rollouts",
            asked_for.len(),
            trained.path().display(),
            asked.rollouts
        ));
    }
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let joints = trained.config().data.humanml3d.skeleton.skeleton().joints();
    let numbers = held_out.len() as u64 * asked.frames as u64 * 3 * joints as u64;
    let hint = "fewer or shorter motions: `evaluation.rollouts`, `evaluation.frames`";
    request.must_fit(numbers * size_of::<f64>() as u64, hint)?;
    let (seed, together) = (request.seed, request.together.clone());
    Ok(Box::new(move |on_step| {
        let generator = FlowGenerator::load(trained)?;
        let evaluation = evaluate(
            &generator, &held_out, asked, &sampler, seed, &together, on_step,
        )?;
        Ok(Evaluated {
            run: evaluation.run.clone(),
            report: "eval-rollouts",
            drawn: column(
                Some(evaluation.step),
                &evaluation.drawn,
                [evaluation.own_texts, evaluation.other_texts],
            ),
            real: column(None, &evaluation.real, [TextReport::default(); 2]),
            json: to_value(&evaluation).expect("plain data"),
            remarks: {
                let each = evaluation.evaluations_per_frame;
                remarks.push(format!("{each:.1} velocity evaluations for each frame"));
                remarks
            },
        })
    }))
}

fn evaluate(
    generator: &FlowGenerator,
    held_out: &[Arc<Clip>],
    settings: RolloutEvaluationConfig,
    sampler: &SamplerConfig,
    seed: u64,
    together: &Together,
    on_step: &mut OnStep<'_>,
) -> Result<RolloutEvaluation, Error> {
    let skeleton = generator.space().skeleton.clone();
    let needed = generator.shortest_history();
    let begin = beginning(needed);
    let texts: Vec<Option<ClipText>> = held_out.iter().map(|clip| ClipText::of(clip)).collect();
    let other = |number: usize| {
        let others = texts[number + 1..].iter().chain(&texts[..number]);
        others.into_iter().find(|text| **text != texts[number])
    };
    let told = if held_out.len() > 1 && other(0).is_some() {
        2
    } else {
        1
    };
    let begun = |clip: &Clip| {
        let joints = clip.features.joints();
        let history = part(&joints, begin - needed, begin);
        (history, part(&joints, begin, joints.frames()))
    };
    let [_, own] = together.own_of(0, held_out.len());
    let (all, mut done) = (own * settings.frames * told, 0);
    // Of each clip the motions by what is said, and how many velocities the first asked for.
    let rollouts = together.each(held_out.len(), |number| {
        let clip = &held_out[number];
        let (history, _) = begun(clip);
        let key = Key::new(item_seed(seed, &clip.id), Purpose::Sampling);
        let said = [Some(&texts[number]), other(number)];
        let (mut motions, mut evaluations) = (Vec::new(), 0);
        for (which, text) in said.into_iter().enumerate().take(told) {
            let Some(text) = text else {
                motions.push(None);
                continue;
            };
            let frames = settings.frames;
            let mut rollout = generator.rollout(&history, frames, sampler, &settings, key)?;
            rollout.push_text(&generator.text(text.as_ref())?)?;
            let mut places = Vec::with_capacity(frames * skeleton.joints());
            let sample = || format!("after clip `{}`", clip.id);
            while let Some(frame) = FlowGenerator::next_frame(&mut rollout, &sample)? {
                places.extend(frame);
                done += 1;
                if let ControlFlow::Break(()) = on_step("", done, all) {
                    return Err(Error::Interrupted);
                }
            }
            motions.push(Some(places));
            if which == 0 {
                evaluations = rollout.evaluations();
            }
        }
        Ok((motions, evaluations))
    })?;
    let (mut drawn, mut real) = (Vec::new(), Vec::new());
    let mut pairs = [Vec::new(), Vec::new()];
    let mut evaluations = 0;
    for (clip, (motions, asked)) in held_out.iter().zip(rollouts) {
        let (history, rest) = begun(clip);
        evaluations += asked;
        for (which, places) in motions.into_iter().enumerate() {
            let Some(places) = places else { continue };
            let motion = Joints::new(places, skeleton.joints()).expect("whole frames");
            let both = rest.frames().min(motion.frames());
            if both >= RolloutReport::SHORTEST {
                pairs[which].push((part(&motion, 0, both), part(&rest, 0, both)));
            }
            if which == 0 {
                drawn.push((bones(&skeleton, &history), motion));
            }
        }
        if rest.frames() >= RolloutReport::SHORTEST {
            real.push((bones(&skeleton, &history), rest));
        }
    }
    let config = generator.config();
    let [own_texts, other_texts] = pairs.map(|pairs| TextReport::compute(&skeleton, &pairs));
    Ok(RolloutEvaluation {
        run: config.run.name.clone(),
        step: generator.step(),
        seed,
        evaluations_per_frame: evaluations as f64 / (held_out.len() * settings.frames) as f64,
        settings,
        sampler: sampler.clone(),
        drawn: RolloutReport::compute(&skeleton, &drawn, &real),
        own_texts,
        other_texts,
        real: RolloutReport::compute(&skeleton, &real, &real),
    })
}

/// Frames of a clip after which rollouts begin: the same, however long a run's histories are.
fn beginning(needed: usize) -> usize {
    needed.max(RolloutReport::SHORTEST)
}

fn part(joints: &Joints, first: usize, end: usize) -> Joints {
    let places = (first..end).flat_map(|t| joints.frame(t).to_vec());
    Joints::new(places.collect(), joints.joints()).expect("whole frames")
}

/// The bones of the last frame of a history: of each joint but the root the offset from its parent.
fn bones(skeleton: &Skeleton, history: &Joints) -> Vec<f64> {
    let last = history.frame(history.frames() - 1);
    super::report::bone_lengths(skeleton, last)
}

fn column(step: Option<u64>, report: &RolloutReport, texts: [TextReport; 2]) -> Column {
    let [own, other] = texts;
    let texts = [
        ("speed error", own.speed_error, ", m/s"),
        ("speed error, other texts", other.speed_error, ", m/s"),
        ("turn error", own.turn_error, ", degrees/s"),
        ("turn error, other texts", other.turn_error, ", degrees/s"),
    ];
    let rows = report.rows().into_iter().chain(texts);
    let numbers = rows.map(|(name, value, unit)| Number {
        name: name.to_string(),
        value,
        line: Some((
            format!("{name}{unit}"),
            value.map(|value| format!("{value:.4}")),
        )),
    });
    Column {
        facts: vec![("step", step)],
        groups: vec![Group {
            key: "rollouts",
            title: "",
            numbers: numbers.collect(),
        }],
    }
}
