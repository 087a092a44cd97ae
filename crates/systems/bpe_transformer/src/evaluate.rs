//! The evaluation of composed motion, generated from the texts and lengths of several held-out
//! clips.

use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::{Features, Joints};
use kinegrad_random::{Key, Purpose};
use kinegrad_train::clips::TimedPrompt;
use kinegrad_train::clips::captions::{ClipText, must_know_texts};
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, Group, OnStep, Results, clips_with_held_out, for_each_item,
};
use kinegrad_train::{Error, TrainedModel};
use serde_json::json;

use super::load::{footprint, text_input};
use super::report::Measured;
use super::{BpeTables, Composer, path_evaluation};

pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluation<'a>, Error> {
    let purpose = "texts and lengths are those of held-out clips";
    let own_data = &trained.config().data;
    let (data, dataset) = clips_with_held_out(own_data, trained, request, purpose)?;
    let held_out = dataset.validation.evenly(dataset.validation.len())?;
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let max_frames = data.target_frames;
    let longest = held_out.iter().map(|clip| clip.features.frames()).max();
    let texts = trained.config().own::<BpeTables>().evaluation.texts;
    let frames = longest.unwrap_or(0).min(max_frames) * texts;
    let networks = footprint(trained.config(), frames)?;
    let request = request.clone();
    Ok(Evaluation {
        report: "eval-compositions",
        memory: networks.of_sampling(1, false, trained.on_host),
        memory_hint: "compose fewer texts: `evaluation.texts`",
        remarks: Vec::new(),
        measure: Box::new(move |on_step| {
            let composer = Composer::load(trained)?;
            evaluate(&composer, &held_out, max_frames, &request, on_step)
        }),
    })
}

fn evaluate(
    composer: &Composer,
    held_out: &[Arc<Clip>],
    max_frames: usize,
    request: &EvaluationRequest,
    on_step: &mut OnStep<'_>,
) -> Result<Results, Error> {
    let config = composer.config();
    let settings = &config.own::<BpeTables>().evaluation;
    let sampler = &config.sampling.sampler;
    let skeleton = config.data.humanml3d.skeleton();
    let key = Key::new(request.seed, Purpose::Sampling);
    let count = settings.compositions * settings.texts;
    let texts = key.named("texts").integers(count, held_out.len());
    let prompt = |&clip: &usize| TimedPrompt {
        text: ClipText::of(&held_out[clip]),
        frames: held_out[clip].features.frames().min(max_frames),
    };
    let compositions = texts.chunks(settings.texts);
    let compositions: Vec<Vec<TimedPrompt>> = compositions
        .map(|clips| clips.iter().map(prompt).collect())
        .collect();
    let count = compositions.len();
    let composed: Vec<Features> =
        for_each_item(&request.group, count, on_step, |number, on_step| {
            let (lines, key) = (&compositions[number], key.at(number as u64));
            let on_step = &mut |done, all| on_step("", done, all);
            composer.compose(lines, sampler, settings, None, key, on_step)
        })?;
    let window = settings.transition_frames;
    let joints_of = |features: &Features, first: usize| {
        features.to_relative().slice(first..first + window).joints()
    };
    let (mut windows, mut segments) = (Vec::new(), Vec::new());
    for (lines, features) in compositions.iter().zip(&composed) {
        let mut begin = 0;
        for (index, line) in lines.iter().enumerate() {
            segments.push(features.crop(&skeleton, begin..begin + line.frames)?);
            if index > 0
                && let Some(first) = begin.checked_sub(window / 2)
                && first + window <= features.frames()
            {
                windows.push(joints_of(features, first));
            }
            begin += line.frames;
        }
    }
    let features = held_out.iter().map(|clip| &clip.features);
    let real: Vec<Features> = features
        .map(|features| features.slice(0..features.frames().min(max_frames)))
        .collect();
    let middle = |clip: &Features| {
        let first = clip.frames().checked_sub(window)? / 2;
        Some(joints_of(clip, first))
    };
    let joints = |all: &[Features]| all.iter().map(Features::joints).collect::<Vec<Joints>>();
    let of_real = Measured {
        motions: &joints(&real),
        windows: &real.iter().filter_map(middle).collect::<Vec<_>>(),
        segments: &real,
    };
    let of_samples = Measured {
        motions: &joints(&composed),
        windows: &windows,
        segments: &segments,
    };
    let statistics = composer.statistics()?;
    let real_jerk = of_real.window_jerk();
    let paths = match settings.num_paths {
        0 => None,
        _ => Some(path_evaluation::evaluate(
            composer, held_out, max_frames, request, on_step,
        )?),
    };
    let of_samples = of_samples.report(&skeleton, statistics, real_jerk, Some(&real));
    let of_real = of_real.report(&skeleton, statistics, real_jerk, None);
    let mut json = json!({
        "settings": settings,
        "sampler": sampler,
        "sampled": of_samples,
        "real": of_real,
    });
    let mut samples = vec![Group::new("compositions", "", &of_samples)];
    let mut real = vec![Group::new("compositions", "", &of_real)];
    if let Some(paths) = paths {
        json["paths"] = json!({ "sampled": paths.samples, "real": paths.real });
        samples.push(Group::new("paths", "along paths", &paths.samples));
        real.push(Group::new("paths", "along paths", &paths.real));
    }
    Ok(Results {
        json,
        facts: Vec::new(),
        samples: Some(samples),
        real,
        verdict: Vec::new(),
        remarks: Vec::new(),
    })
}
