//! The evaluation of composed motion: of the texts and lengths of held-out clips, several in a row.

use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::humanml::Features;
use kinegrad_random::{Key, Purpose};
use serde::Serialize;
use serde_json::to_value;

use super::networks::footprint;
use super::networks::text_input;
use super::report::{ComposedReport, Measured};
use super::ways::{self, WaysEvaluation, WaysReport};
use super::{BpeTables, ComposeEvaluationConfig, Composer};
use crate::TrainedModel;
use crate::clips::TimedPrompt;
use crate::clips::captions::{ClipText, must_know_texts};
use crate::clips::{dataset_or, with_held_out};
use crate::error::Error;
use crate::evaluation::{Column, Evaluate, Evaluated, EvaluationRequest, Group, Number, OnStep};

/// Results of an evaluation of compositions.
#[derive(Clone, Debug, Serialize)]
struct ComposeEvaluation {
    /// Name of the run.
    run: String,
    /// Step of its checkpoint.
    step: u64,
    /// Seed of the noise.
    seed: u64,
    /// The settings.
    settings: ComposeEvaluationConfig,
    /// The sampler.
    sampler: SamplerConfig,
    /// The generated motion.
    drawn: ComposedReport,
    /// Held-out clips.
    real: ComposedReport,
    /// Motion along the ways of held-out clips, where that is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    paths: Option<WaysEvaluation>,
}

/// An evaluation of compositions.
///
/// # Errors
/// If the request does not apply, or too few clips are held out.
pub(super) fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--audio-ablation", "--trajectory-run"],
        trained.path(),
        "a run of recipe `bpe_motion`",
        "leave it out",
    )?;
    let own: &BpeTables = trained.config().own();
    let asked = own.evaluation.clone();
    let data = dataset_or(&trained.config().data, request.source.as_deref());
    let dataset = with_held_out(
        &data,
        trained.path(),
        "texts and lengths are those of held-out clips",
        &request.together,
    )?;
    let held_out = dataset.validation.evenly(dataset.validation.len())?;
    must_know_texts(&text_input(trained.config()), &held_out)?;
    let longest = held_out.iter().map(|clip| clip.features.frames()).max();
    let frames = longest.unwrap_or(0).min(data.target_frames) * asked.texts;
    let networks = footprint(trained.config(), frames)?;
    request.must_fit(
        networks.of_sampling(1, false, trained.on_host),
        "compose fewer texts: `evaluation.texts`",
    )?;
    let request = request.clone();
    let most = data.target_frames;
    Ok(Box::new(move |on_step| {
        let composer = Composer::load(trained)?;
        let evaluation = evaluate(
            trained, &composer, &held_out, &asked, most, &request, on_step,
        )?;
        Ok(Evaluated {
            run: evaluation.run.clone(),
            report: "eval-compositions",
            drawn: column(
                Some(evaluation.step),
                &evaluation.drawn,
                evaluation.paths.as_ref().map(|paths| &paths.drawn),
            ),
            real: column(
                None,
                &evaluation.real,
                evaluation.paths.as_ref().map(|paths| &paths.real),
            ),
            json: to_value(&evaluation).expect("plain data"),
            remarks: Vec::new(),
        })
    }))
}

fn evaluate(
    trained: &TrainedModel,
    composer: &Composer,
    held_out: &[Arc<Clip>],
    asked: &ComposeEvaluationConfig,
    most: usize,
    request: &EvaluationRequest,
    on_step: &mut OnStep<'_>,
) -> Result<ComposeEvaluation, Error> {
    let (seed, together) = (request.seed, &request.together);
    let sampler = &trained.config().sampling.sampler;
    let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
    let key = Key::new(seed, Purpose::Sampling);
    let chosen = key
        .named("texts")
        .integers(asked.compositions * asked.texts, held_out.len());
    let window = asked.transition_frames;
    let (mut motions, mut windows, mut segments) = (Vec::new(), Vec::new(), Vec::new());
    let compositions = chosen.chunks(asked.texts).map(|chosen| {
        let lines = chosen.iter().map(|&clip| TimedPrompt {
            text: ClipText::of(&held_out[clip]),
            frames: held_out[clip].features.frames().min(most),
        });
        lines.collect()
    });
    let compositions: Vec<Vec<TimedPrompt>> = compositions.collect();
    let composed: Vec<Features> = together.each(compositions.len(), |number| {
        let [before, count] = together.own_of(number, compositions.len());
        composer.compose(
            &compositions[number],
            sampler,
            asked,
            None,
            key.at(number as u64),
            &mut |done, all| on_step("", before * all + done, count * all),
        )
    })?;
    for (lines, features) in compositions.iter().zip(composed) {
        let mut begin = 0;
        for (index, line) in lines.iter().enumerate() {
            let range = begin..begin + line.frames;
            segments.push(features.crop(&skeleton, range)?);
            if index > 0
                && let Some(first) = begin.checked_sub(window / 2)
                && first + window <= features.frames()
            {
                windows.push(features.to_relative().slice(first..first + window).joints());
            }
            begin += line.frames;
        }
        motions.push(features.joints());
    }
    let real: Vec<Features> = held_out
        .iter()
        .map(|clip| clip.features.slice(0..clip.features.frames().min(most)))
        .collect();
    let middle = |clip: &Features| {
        let first = clip.frames().checked_sub(window)? / 2;
        Some(clip.to_relative().slice(first..first + window).joints())
    };
    let of_real = Measured {
        motions: &real.iter().map(Features::joints).collect::<Vec<_>>(),
        windows: &real.iter().filter_map(middle).collect::<Vec<_>>(),
        segments: &real,
    };
    let of_drawn = Measured {
        motions: &motions,
        windows: &windows,
        segments: &segments,
    };
    let statistics = composer.statistics()?;
    let real_jerk = of_real.window_jerk();
    let paths = (asked.num_paths > 0)
        .then(|| ways::evaluate(composer, held_out, asked, sampler, most, request, on_step))
        .transpose()?;
    Ok(ComposeEvaluation {
        run: composer.config().run.name.clone(),
        step: composer.step(),
        seed,
        settings: asked.clone(),
        sampler: sampler.clone(),
        drawn: of_drawn.report(&skeleton, statistics, real_jerk, Some(&real)),
        real: of_real.report(&skeleton, statistics, real_jerk, None),
        paths,
    })
}

fn column(step: Option<u64>, report: &ComposedReport, paths: Option<&WaysReport>) -> Column {
    let composed = group("compositions", "", &report.rows());
    let paths = paths.map(|paths| group("paths", "along paths", &paths.rows()));
    Column {
        facts: vec![("step", step)],
        groups: [composed].into_iter().chain(paths).collect(),
    }
}

fn group(
    key: &'static str,
    title: &'static str,
    rows: &[(&'static str, Option<f64>, &'static str)],
) -> Group {
    let numbers = rows.iter().map(|(name, value, unit)| Number {
        name: (*name).to_string(),
        value: *value,
        line: Some((
            format!("{name}{unit}"),
            value.map(|value| format!("{value:.4}")),
        )),
    });
    Group {
        key,
        title,
        numbers: numbers.collect(),
    }
}
