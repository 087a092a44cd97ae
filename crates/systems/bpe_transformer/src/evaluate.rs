//! The evaluation of composed motion, generated from the texts and lengths of several held-out clips
//! in a row.

use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::{Features, Joints};
use kinegrad_random::{Key, Purpose};
use serde_json::json;

use super::load::{footprint, text_input};
use super::path_evaluation;
use super::report::Measured;
use super::{BpeTables, Composer};
use kinegrad_train::Error;
use kinegrad_train::TrainedModel;
use kinegrad_train::clips::TimedPrompt;
use kinegrad_train::clips::captions::{ClipText, must_know_texts};
use kinegrad_train::evaluation::{
    Evaluation, EvaluationRequest, Group, OnStep, Results, clips_with_held_out, for_each_item,
};

/// An evaluation of compositions.
///
/// # Errors
/// If nothing is held out, or the model does not know a text.
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
    let skeleton = config.data.humanml3d.skeleton.skeleton();
    let key = Key::new(request.seed, Purpose::Sampling);
    let texts = key
        .named("texts")
        .integers(settings.compositions * settings.texts, held_out.len());
    let compositions = texts.chunks(settings.texts).map(|clips| {
        let lines = clips.iter().map(|&clip| TimedPrompt {
            text: ClipText::of(&held_out[clip]),
            frames: held_out[clip].features.frames().min(max_frames),
        });
        lines.collect()
    });
    let compositions: Vec<Vec<TimedPrompt>> = compositions.collect();
    let composed: Vec<Features> = for_each_item(
        &request.group,
        compositions.len(),
        on_step,
        |number, on_step| {
            composer.compose(
                &compositions[number],
                sampler,
                settings,
                None,
                key.at(number as u64),
                &mut |done, all| on_step("", done, all),
            )
        },
    )?;
    let window = settings.transition_frames;
    let joints_of = |features: &Features, first: usize| {
        let window = features.to_relative().slice(first..first + window);
        window.joints()
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
    let real = held_out.iter().map(|clip| {
        clip.features
            .slice(0..clip.features.frames().min(max_frames))
    });
    let real: Vec<Features> = real.collect();
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
    let paths = (settings.num_paths > 0)
        .then(|| {
            path_evaluation::evaluate(composer, held_out, settings, max_frames, request, on_step)
        })
        .transpose()?;
    let of_samples = of_samples.report(&skeleton, statistics, real_jerk, Some(&real));
    let of_real = of_real.report(&skeleton, statistics, real_jerk, None);
    let mut json = json!({
        "settings": settings,
        "sampler": sampler,
        "drawn": of_samples,
        "real": of_real,
    });
    let mut samples = vec![Group::new("compositions", "", &of_samples)];
    let mut real = vec![Group::new("compositions", "", &of_real)];
    if let Some(paths) = paths {
        json["paths"] = json!({ "drawn": paths.samples, "real": paths.real });
        samples.push(Group::new("paths", "along paths", &paths.samples));
        real.push(Group::new("paths", "along paths", &paths.real));
    }
    Ok(Results {
        json,
        facts: Vec::new(),
        samples: Some(samples),
        real,
        remarks: Vec::new(),
    })
}
