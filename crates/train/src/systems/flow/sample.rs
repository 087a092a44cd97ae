//! Sampling motion that goes on from a history.

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_data::{Dataset, ItemSet, read_array};
use kinegrad_diffusion::FlowSamplerConfig;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_random::{Key, Purpose};

use super::networks::text_input;
use super::report::bone_lengths;
use super::{Flow, FlowGenerator, FlowTables, PoseSpace};
use crate::TrainedModel;
use crate::captions::{ClipText, TextInput, must_know_texts, text_of};
use crate::clips::{clips_named, dataset_or};
use crate::error::Error;
use crate::sampling::{
    BVH, Condition, Conditions, Contents, Drawn, MOTION, Names, Receiver, Record, Remark, Request,
    RolloutRecord, SaidRecord, item_seed,
};
use crate::system::System as _;
use crate::text_plan::TextPlan;

/// What a motion goes on from.
struct Start {
    history: Joints,
    /// What stands for it among several.
    stem: String,
    /// Its clip's id, if it is of one.
    item: Option<String>,
    /// What its clip is told.
    caption: Option<ClipText>,
    /// Seed of its noise.
    seed: u64,
}

/// Generates the requested motions: joints and BVH of each. Returns how often the network was asked.
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
            "--path",
        ],
        "a run of recipe `flow`",
        "its conditions are a history, `--history MOTION.npy` or `--item ID`, and texts, `--text`, \
         `--text-embedding FILE#KEY` or `--prompts PROMPTS.toml`",
    )?;
    if request.post_processing.is_some() {
        return Err(Error::usage(
            "`--postprocess` with a run of recipe `flow`",
            "its samples are not post-processed: leave it out",
        ));
    }
    let own: &FlowTables = trained.config().own();
    let sampler = FlowSamplerConfig::of(&trained.config().sampling.sampler)?;
    let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
    let input = text_input(trained.config());
    let plan = conditions.plan.as_deref().map(TextPlan::read).transpose()?;
    let script = Script::of(
        trained,
        request,
        plan.as_ref(),
        &input,
        own.evaluation.frames,
    )?;
    let longest = trained.config().data.target_frames;
    let space = PoseSpace::new(skeleton.clone(), &own.pose, longest);
    let starts = starts(trained, request, receiver, &space, &script)?;
    if script.frames > longest {
        receiver.note(&format!(
            "{} frames are more than `data.target_frames`, {longest}, the longest motion that the model is \
             told of: it is told that length, and goes on",
            script.frames
        ));
    }
    if let Some(warning) = untaught_guidance(trained, own) {
        receiver.warning(&warning);
    }
    let names = Names {
        stems: starts.iter().map(|start| start.stem.clone()).collect(),
        count: request.count,
    };
    if conditions.held_out.is_none() {
        receiver.announced(&names, &[MOTION, BVH])?;
    }
    let generator = FlowGenerator::load(trained)?;
    let all = starts.len() * request.count * script.frames;
    let (mut done, mut evaluations) = (0, 0);
    for start in &starts {
        for index in 0..request.count {
            let key = Key::new(start.seed, Purpose::Sampling).at(index as u64);
            let (history, how) = (&start.history, &own.evaluation);
            let mut rollout = generator.rollout(history, script.frames, &sampler, how, key)?;
            let mut frames = Vec::with_capacity(script.frames * skeleton.joints());
            let mut steps = script.steps.iter().peekable();
            while rollout.remaining() > 0 {
                let drawn = script.frames - rollout.remaining();
                if let Some((_, text)) = steps.next_if(|(begin, _)| *begin == drawn) {
                    let text = text.as_ref().or(start.caption.as_ref());
                    rollout.push_text(&generator.text(text)?)?;
                }
                let sample = || format!("`{}`", names.of(&start.stem, index));
                let frame = FlowGenerator::next_frame(&mut rollout, &sample)?;
                frames.extend(frame.expect("frames remain"));
                done += 1;
                if receiver.advance("", done, all).is_break() {
                    return Err(Error::Interrupted);
                }
            }
            evaluations += rollout.evaluations();
            let joints = Joints::new(frames, skeleton.joints()).expect("whole frames");
            let record = Record {
                rollout: Some(RolloutRecord {
                    constant_bones: how.constant_bones,
                    same_noise: how.same_noise,
                    evaluations_per_frame: rollout.evaluations() as f64 / script.frames as f64,
                    said: script.said(start),
                }),
                ..record(trained, request, start, index, &joints, &skeleton)
            };
            receiver.drawn(drawn(
                names.of(&start.stem, index),
                joints,
                &skeleton,
                record,
            ))?;
        }
    }
    let each = evaluations as f64 / all as f64;
    Ok(Some(Remark::Text(format!(
        "{all} frames, {each:.1} velocity evaluations each"
    ))))
}

/// What is said when.
struct Script {
    frames: usize,
    /// From which frame on what is said; nothing of a start's own caption.
    steps: Vec<(usize, Option<ClipText>)>,
}

impl Script {
    /// What was said when, to a motion from `start`.
    fn said(&self, start: &Start) -> Vec<SaidRecord> {
        let said = |(from, text): &(usize, Option<ClipText>)| {
            let text = text.as_ref().or(start.caption.as_ref());
            SaidRecord {
                from: *from,
                text: text.and_then(|text| text.caption.clone()),
            }
        };
        self.steps.iter().map(said).collect()
    }

    fn of(
        trained: &TrainedModel,
        request: &Request,
        plan: Option<&TextPlan>,
        input: &TextInput,
        default: usize,
    ) -> Result<Self, Error> {
        let Some(plan) = plan else {
            let inputs = std::slice::from_ref(input);
            return Ok(Self {
                frames: request.frames.unwrap_or(default),
                steps: vec![(0, text_of(&request.conditions, inputs, &trained.device)?)],
            });
        };
        if request.frames.is_some() {
            let hint = "the plan says how long the motion is: leave `--frames` or `--seconds` out";
            return Err(Error::usage("`--prompts` with a length", hint));
        }
        let path = request
            .conditions
            .plan
            .as_deref()
            .unwrap_or(Path::new("the plan"));
        let ends = plan.ends(path, Flow.fps(trained.config()))?;
        let begins = [0].into_iter().chain(ends.iter().copied());
        // A step that says nothing is no caption of a clip either.
        let said = plan.said(path, input)?.into_iter().map(Some);
        let steps = begins.zip(said).collect();
        Ok(Self {
            frames: ends.last().copied().unwrap_or_default(),
            steps,
        })
    }
}

/// What the motions go on from: the file of a history, or the beginnings of clips; without either that
/// of a clip which does what is said first, of a held-out one if there is one.
fn starts(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
    space: &PoseSpace,
    script: &Script,
) -> Result<Vec<Start>, Error> {
    let needed = space.history + 1;
    let Conditions {
        history,
        source,
        item,
        held_out,
        text,
        text_embedding,
        plan,
        ..
    } = &request.conditions;
    if let Some(path) = history {
        let clip = [("--item", item.is_some()), ("--source", source.is_some())];
        if let Some((other, _)) = clip.into_iter().find(|(_, given)| *given) {
            let hint = "both say what the motion goes on from: leave out one of the two";
            return Err(Error::usage(format!("`--history` with `{other}`"), hint));
        }
        return Ok(vec![Start {
            history: read_history(path, space)?,
            stem: String::new(),
            item: None,
            caption: None,
            seed: request.seed,
        }]);
    }
    let data = dataset_or(&trained.config().data, source.as_deref());
    let dataset = Dataset::<Clip>::open_with_progress(&data, &*receiver.reading())?;
    let chosen: Vec<Arc<Clip>> = match (item, held_out) {
        (Some(pattern), _) => clips_named(&dataset, pattern)?,
        (None, Some(count)) => dataset.held_out().evenly(*count)?,
        (None, None) => {
            let first = script.steps.first().and_then(|(_, text)| text.as_ref());
            let said = first.and_then(|text| text.caption.as_deref());
            let sets = [dataset.held_out(), &dataset.train];
            let clip = clip_that_does(&sets, said, needed)?;
            if let Some(clip) = &clip {
                let does = clip
                    .caption()
                    .map_or("without a caption", |caption| &caption.text);
                receiver.note(&format!(
                    "no history given: going on from the beginning of clip `{}`: {does}",
                    clip.id
                ));
            }
            clip.into_iter().collect()
        }
    };
    let speaks = text.is_none() && text_embedding.is_none() && plan.is_none();
    if speaks {
        must_know_texts(&text_input(trained.config()), &chosen)?;
    }
    let several = chosen.len() > 1;
    let start = |clip: &Arc<Clip>| {
        let frames = clip.features.frames();
        if frames < needed {
            let message = format!("clip `{}` has {frames} frames", clip.id);
            let hint = format!("a motion goes on from {needed} frames: name a longer clip");
            return Err(Error::usage(message, hint));
        }
        let stem = match (held_out, several) {
            (Some(_), _) => clip.id.clone(),
            (None, true) => format!("-{}", clip.id),
            (None, false) => String::new(),
        };
        Ok(Start {
            history: clip.features.slice(0..needed).joints(),
            stem,
            item: Some(clip.id.clone()),
            caption: ClipText::of(clip).filter(|_| speaks),
            seed: item_seed(request.seed, &clip.id),
        })
    };
    chosen.iter().map(start).collect()
}

/// The first clip of at least `needed` frames one of whose captions is `said`, else the first clip.
fn clip_that_does(
    sets: &[&ItemSet<Clip>],
    said: Option<&str>,
    needed: usize,
) -> Result<Option<Arc<Clip>>, Error> {
    let (mut first, mut too_short) = (None, None);
    for clips in sets {
        for position in 0..clips.len() {
            let clip = clips.get(position)?;
            if clip.features.frames() < needed {
                too_short.get_or_insert(clip);
                continue;
            }
            let mut captions = clip.captions.iter();
            if said.is_none_or(|said| captions.any(|caption| caption.text == said)) {
                return Ok(Some(clip));
            }
            first.get_or_insert(clip);
        }
    }
    // One that is too short is refused by its name.
    Ok(first.or(too_short))
}

/// What to say of guidance with a network that was always told its text.
pub(super) fn untaught_guidance(trained: &TrainedModel, own: &FlowTables) -> Option<String> {
    let scale = trained.config().sampling.sampler.guidance_scale;
    let guided = scale != 1.0 && own.pose.cond_drop_prob == 0.0;
    guided.then(|| {
        format!(
            "`sampling.sampler.guidance_scale` is {scale}, and the run was trained with \
             `pose.cond_drop_prob = 0`: it does not know what motion without a text is"
        )
    })
}

/// Furthest place of a history from the origin, metres.
const FURTHEST: f32 = 1e4;

/// Lengths of bones, metres: of bodies, not of numbers in other units.
const BONES: RangeInclusive<f64> = 0.005..=3.0;

/// Heights of the lowest joint, metres: of a body on the floor, or in a leap.
const LOWEST: RangeInclusive<f64> = -0.5..=1.5;

/// Joints `[T, J, 3]`.
fn read_history(path: &Path, space: &PoseSpace) -> Result<Joints, Error> {
    let array = read_array(path)?;
    let (joints, needed) = (space.skeleton.joints(), space.history + 1);
    let refused = |found: String| {
        let message = format!("{}: {found}", path.display());
        let hint = format!(
            "a history is joints in metres, `[T, {joints}, 3]` with {needed} frames or more, as \
             `kinegrad sample` writes them of a run on clips"
        );
        Error::usage(message, hint)
    };
    if !matches!(array.shape[..], [_, found, 3] if found == joints) {
        return Err(refused(format!("an array of shape {:?}", array.shape)));
    }
    let near = -FURTHEST..=FURTHEST;
    let bad = array.values.iter().position(|value| !near.contains(value));
    if let Some(place) = bad {
        let (frame, value) = (place / (3 * joints), array.values[place]);
        return Err(refused(format!(
            "frame {frame} has the number {value}: a place is at most {FURTHEST} m from the origin"
        )));
    }
    if array.shape[0] < needed {
        return Err(refused(format!("{} frames", array.shape[0])));
    }
    let found = Joints::from_f32(&array.values, joints)?;
    let names = &space.skeleton.description().joint_names;
    for frame in found.frames() - needed..found.frames() {
        let places = found.frame(frame);
        let bones = bone_lengths(&space.skeleton, places)
            .into_iter()
            .enumerate();
        for (bone, length) in bones {
            if !BONES.contains(&length) {
                return Err(refused(format!(
                    "the bone to joint {} ({}) is {length:.4} m long in frame {frame}, allowed: {} to {} m",
                    bone + 1,
                    names[bone + 1],
                    BONES.start(),
                    BONES.end()
                )));
            }
        }
        let lowest = places
            .iter()
            .map(|place| place[1])
            .fold(f64::INFINITY, f64::min);
        if !LOWEST.contains(&lowest) {
            return Err(refused(format!(
                "the lowest joint is at a height of {lowest:.2} m in frame {frame}, allowed: {} to {} m \
                 above the floor, which is where y is 0",
                LOWEST.start(),
                LOWEST.end()
            )));
        }
    }
    // What no features can be made of is refused with the file's name.
    let rows = space.rows(&found);
    rows.map_err(|error| refused(error.to_string()))?;
    Ok(found)
}

fn record(
    trained: &TrainedModel,
    request: &Request,
    start: &Start,
    index: usize,
    joints: &Joints,
    skeleton: &Skeleton,
) -> Record {
    let conditions = &request.conditions;
    Record {
        index,
        frames: joints.frames(),
        fps: skeleton.description().fps,
        condition: Condition {
            item: start.item.clone(),
            source: conditions.source.clone().or_else(|| {
                let own = || trained.config().data.source.clone();
                start.item.as_ref().and_then(|_| own())
            }),
            history: conditions.history.clone(),
            text: conditions.text.clone(),
            clip: conditions.clip.clone(),
            text_embedding: conditions.text_embedding.clone(),
            plan: conditions.plan.clone(),
            ..Condition::default()
        },
        ..Record::new(Flow.name(), trained, request.seed)
    }
}

fn drawn(name: String, joints: Joints, skeleton: &Skeleton, record: Record) -> Drawn {
    let array = Contents::Array {
        shape: vec![joints.frames(), joints.joints(), 3],
        values: joints.to_f32(),
    };
    let figure = Contents::Figure {
        joints,
        skeleton: Box::new(skeleton.clone()),
    };
    Drawn {
        name,
        files: vec![(MOTION, array), (BVH, figure)],
        record,
    }
}
