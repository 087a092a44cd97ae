//! Sampling motion composed of texts.

use std::sync::Arc;

use kinegrad_data::Dataset;
use kinegrad_data::humanml::Clip;
use kinegrad_motion::humanml::Root;
use kinegrad_random::{Key, Purpose};
use serde_json::to_value;

use super::networks::text_input;
use super::path::finish;
use super::{BpeTables, BpeTransformer, Composer, Line, PathMethod, RECIPE};
use crate::TrainedModel;
use crate::captions::{ClipText, must_know_texts, text_of};
use crate::clips::{clips_named, dataset_or};
use crate::error::Error;
use crate::memory::must_fit;
use crate::path_target::{PathTarget, features_of, in_words, read_path};
use crate::sampling::{
    BVH, CompositionRecord, Condition, Drawn, FEATURES, MOTION, Names, PathRecord, Receiver,
    Record, Remark, Request, SaidRecord, clip_files, item_seed,
};
use crate::system::System as _;
use crate::text_plan::TextPlan;

/// A motion that is asked for.
struct Motion {
    /// What stands for it among several.
    stem: String,
    /// Its clip's id, if it is for one.
    item: Option<String>,
    lines: Vec<Line>,
    /// Seed of its noise.
    seed: u64,
}

/// What a leg may be too short by without a word, metres.
const LEGS_SHORT: f64 = 0.02;

/// Generates the requested motions one after another: joints, features and BVH of each.
///
/// # Errors
/// If a condition cannot be used, or a checkpoint cannot be read.
pub(super) fn sample(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    let conditions = &request.conditions;
    conditions.refuse(
        &[
            "--audio-features",
            "--audio",
            "--goal",
            "--trajectory-run",
            "--continue-from",
            "--keep",
            "--style",
            "--history",
        ],
        "a run of recipe `bpe_motion`",
        "its conditions are texts: `--text`, `--text-embedding FILE#KEY`, `--prompts PROMPTS.toml` for several \
         one after another, or `--item ID` for a clip's caption",
    )?;
    if request.post_processing.is_some() {
        return Err(Error::usage(
            format!("`--postprocess` with a run of recipe `{RECIPE}`"),
            "its samples are not post-processed: leave it out",
        ));
    }
    let own: &BpeTables = trained.config().own();
    let motions = motions(trained, request, receiver)?;
    let longest = motions.iter().map(Motion::frames).max().unwrap_or(0);
    let mut networks = super::networks::footprint(trained.config(), longest)?;
    let path = &own.evaluation.path;
    let tracked = conditions.path.is_some() && path.method.guides() && path.through_network;
    if trained.config().sampling.sampler.guidance_scale != 1.0 {
        networks.passes = 2;
    }
    must_fit(
        &format!("drawing a motion of {longest} frames"),
        networks.of_sampling(1, tracked, trained.on_host),
        "ask for a shorter one",
    )?;
    let names = Names {
        stems: motions.iter().map(|motion| motion.stem.clone()).collect(),
        count: request.count,
    };
    if conditions.held_out.is_none() {
        receiver.announced(&names, &[MOTION, FEATURES, BVH])?;
    }
    let path = conditions.path.as_ref().map(read_path).transpose()?;
    if path.is_none() && own.evaluation.path.method != PathMethod::default() {
        receiver.note("`evaluation.path.method` acts with `--path` alone");
    }
    let composer = Composer::load(trained)?;
    let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
    let fps = skeleton.description().fps;
    let fastest = composer.fastest()?;
    let sampler = &trained.config().sampling.sampler;
    let all = motions.len() * request.count;
    let mut remarks = Vec::new();
    for (number, motion) in motions.iter().enumerate() {
        let target = path.as_ref().map(|(file, plan)| {
            let target = PathTarget::new(plan, motion.frames(), fps)?;
            if let Some(warning) = target.too_fast(file, fps, fastest) {
                receiver.warning(&warning);
            }
            Ok::<_, Error>(target)
        });
        let target = target.transpose()?;
        for index in 0..request.count {
            let key = Key::new(motion.seed, Purpose::Sampling).at(index as u64);
            let before = number * request.count + index;
            let features = composer.compose(
                &motion.lines,
                sampler,
                &own.evaluation,
                target.as_ref(),
                key,
                &mut |done, steps| receiver.advance("", before * steps + done, all * steps),
            )?;
            let settings = &own.evaluation.path;
            let (features, joints, followed) = match (&path, &target) {
                (Some((file, plan)), Some(target)) => {
                    let found = finish(target, &features, &skeleton, settings)?;
                    remarks.push(in_words(&found.report));
                    if found.legs_short > LEGS_SHORT {
                        receiver.warning(&format!(
                            "legs are up to {:.2} m too short to stand where they stood: the path is \
                             longer than the motion's own way, or turns more sharply",
                            found.legs_short
                        ));
                    }
                    let features = match settings.method.moves_afterwards() {
                        true => features_of(&found.joints, &skeleton, features.root())?,
                        false => features,
                    };
                    let record = PathRecord {
                        file: file.clone(),
                        content: plan.clone(),
                        settings: Some(to_value(settings).expect("plain data")),
                        report: found.report,
                    };
                    (features, found.joints, Some(record))
                }
                _ => {
                    let joints = features.joints();
                    (features, joints, None)
                }
            };
            let record = Record {
                index,
                frames: features.frames(),
                fps: skeleton.description().fps,
                composition: Some(CompositionRecord {
                    bpe_denoising_step: own.evaluation.bpe_denoising_step,
                    said: said(&motion.lines),
                }),
                path: followed,
                condition: Condition {
                    item: motion.item.clone(),
                    source: motion.item.as_ref().and_then(|_| {
                        let given = conditions.source.clone();
                        given.or_else(|| trained.config().data.source.clone())
                    }),
                    text: conditions.text.clone(),
                    clip: conditions.clip.clone(),
                    text_embedding: conditions.text_embedding.clone(),
                    plan: conditions.plan.clone(),
                    ..Condition::default()
                },
                ..Record::new(BpeTransformer.name(), trained, request.seed)
            };
            receiver.drawn(Drawn {
                name: names.of(&motion.stem, index),
                files: clip_files(features, joints, &skeleton),
                record,
            })?;
        }
    }
    Ok((!remarks.is_empty()).then(|| Remark::Text(remarks.join("\n"))))
}

impl Motion {
    fn frames(&self) -> usize {
        self.lines.iter().map(|line| line.frames).sum()
    }
}

/// Which text begins in which frame.
fn said(lines: &[Line]) -> Vec<SaidRecord> {
    let mut from = 0;
    let of_line = |line: &Line| {
        let begins = from;
        from += line.frames;
        SaidRecord {
            from: begins,
            text: line.text.as_ref().and_then(|text| text.caption.clone()),
        }
    };
    lines.iter().map(of_line).collect()
}

/// What is asked for: a plan, one text, or the captions of clips.
fn motions(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Vec<Motion>, Error> {
    let conditions = &request.conditions;
    let input = text_input(trained.config());
    let one = |lines| {
        vec![Motion {
            stem: String::new(),
            item: None,
            lines,
            seed: request.seed,
        }]
    };
    if let Some(path) = &conditions.plan {
        if request.frames.is_some() {
            let hint = "the plan says how long the motion is: leave `--frames` or `--seconds` out";
            return Err(Error::usage("`--prompts` with a length", hint));
        }
        conditions.refuse(
            &["--item", "--source"],
            "`--prompts` and a run of recipe `bpe_motion`",
            "the plan says what the texts are: leave out one of the two",
        )?;
        let plan = TextPlan::read(path)?;
        if plan.step.len() > 1 && trained.config().data.humanml3d.root == Root::Absolute {
            let message =
                "a plan of several texts, and a run with `data.humanml3d.root = \"absolute\"`";
            let hint =
                "every clip of its training begins at the origin: train with a relative root";
            return Err(Error::usage(message, hint));
        }
        let ends = plan.ends(path, BpeTransformer.fps(trained.config()))?;
        let begins = [0].into_iter().chain(ends.iter().copied());
        let lengths = ends.iter().zip(begins).map(|(end, begin)| end - begin);
        let said = plan.said(path, &input)?.into_iter();
        let lines = said.zip(lengths).map(|(text, frames)| Line {
            text: (text != ClipText::default()).then_some(text),
            frames,
        });
        return Ok(one(lines.collect()));
    }
    if conditions.item.is_some() || conditions.source.is_some() || conditions.held_out.is_some() {
        return of_clips(trained, request, receiver);
    }
    if conditions.is_empty() {
        receiver.note("no condition given: drawing without a text");
    }
    let text = text_of(conditions, &[input], &trained.device)?;
    let frames = request
        .frames
        .unwrap_or(trained.config().data.target_frames);
    Ok(one(vec![Line { text, frames }]))
}

/// A motion for each clip, of its caption and length.
fn of_clips(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Vec<Motion>, Error> {
    let conditions = &request.conditions;
    conditions.refuse(
        &["--text", "--text-embedding"],
        "`--item` and a run on clips of joint features",
        "`--item` alone stands for the first caption of all of the clip",
    )?;
    let data = dataset_or(&trained.config().data, conditions.source.as_deref());
    let dataset = Dataset::<Clip>::open_with_progress(&data, &*receiver.reading())?;
    let chosen: Vec<Arc<Clip>> = match (&conditions.item, conditions.held_out) {
        (Some(pattern), _) => clips_named(&dataset, pattern)?,
        (None, Some(count)) => dataset.held_out().evenly(count)?,
        (None, None) => {
            let hint = "name a clip with `--item ID`; `kinegrad data inspect URI` lists them";
            return Err(Error::usage("`--source` without `--item`", hint));
        }
    };
    must_know_texts(&text_input(trained.config()), &chosen)?;
    let several = chosen.len() > 1;
    let motion = |clip: &Arc<Clip>| {
        let own = || clip.features.frames().min(data.target_frames);
        let line = Line {
            text: ClipText::of(clip),
            frames: request.frames.unwrap_or_else(own),
        };
        Motion {
            stem: match (conditions.held_out, several) {
                (Some(_), _) => clip.id.clone(),
                (None, true) => format!("-{}", clip.id),
                (None, false) => String::new(),
            },
            item: Some(clip.id.clone()),
            lines: vec![line],
            seed: item_seed(request.seed, &clip.id),
        }
    };
    Ok(chosen.iter().map(motion).collect())
}
