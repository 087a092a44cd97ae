//! Sampling motion that continues a history.

use std::ops::RangeInclusive;
use std::path::Path;
use std::slice::from_ref;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_data::{Alone, Dataset, ItemSet, read_array};
use kinegrad_diffusion::SamplerConfig;
use kinegrad_motion::humanml::Joints;
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::counted;
use kinegrad_train::clips::captions::{ClipText, must_know_texts, text_of};
use kinegrad_train::clips::{TimedPrompt, requested};
use kinegrad_train::sampling::{
    Condition, Generated, Job, Record, Request, RolloutRecord, Run, SampleSink, Sampler, Summary,
};
use kinegrad_train::{Error, System as _, TrainedModel};

use super::load::text_input;
use super::report::bone_lengths;
use super::{Flow, FlowGenerator, FlowTables, PoseSpace};

pub(super) struct Rollouts<'a> {
    trained: &'a TrainedModel,
    request: &'a Request,
    sampler: SamplerConfig,
    jobs: Vec<Job>,
    /// One for each job.
    starts: Vec<Start>,
}

struct Start {
    history: Joints,
    prompts: Vec<TimedPrompt>,
}

impl<'a> Rollouts<'a> {
    /// Reads the conditions of a request.
    pub fn new(
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Self, Error> {
        let config = trained.config();
        let own: &FlowTables = config.own();
        let mut rollouts = Self {
            trained,
            request,
            sampler: config.sampling.sampler.clone(),
            jobs: Vec::new(),
            starts: Vec::new(),
        };
        let input = text_input(config);
        let texts: Vec<Condition> = request.text_conditions().collect();
        let mut prompts = TimedPrompt::requested(request, &input, Flow.fps(config))?;
        let mut frames = request.frames.unwrap_or(own.evaluation.frames);
        match &prompts {
            Some(prompts) => frames = prompts.iter().map(|prompt| prompt.frames).sum(),
            None => {
                let text = text_of(request, from_ref(&input), &trained.device)?;
                prompts = text.map(|text| {
                    vec![TimedPrompt {
                        text: Some(text),
                        frames,
                    }]
                });
            }
        }
        let skeleton = config.data.humanml3d.skeleton();
        let longest = config.data.target_frames;
        let space = PoseSpace::new(skeleton, &own.pose, longest);
        if let Some(file) = request.history() {
            if request.item().is_some() {
                let hint = "both are beginnings of the motion: leave out one of the two";
                let message = "option `history` with option `item`";
                return Err(Error::usage(message, hint));
            }
            let joints = match &request.history_joints {
                Some(joints) => joints.clone(),
                None => read_history(file, &space)?,
            };
            let history = checked_history(file, joints, &space)?;
            let prompts = prompts.unwrap_or_else(|| vec![TimedPrompt { text: None, frames }]);
            let condition = Condition::History(file.to_path_buf());
            rollouts.jobs.push(Job {
                name: None,
                conditions: [condition].into_iter().chain(texts).collect(),
                caption: None,
                frames,
            });
            rollouts.starts.push(Start { history, prompts });
        } else {
            let needed = space.history + 1;
            let (source, clips) = match requested(trained, request, sink)? {
                Some((data, clips)) => (data.source, clips),
                None => rollouts.chosen(prompts.as_deref(), needed, sink)?,
            };
            if prompts.is_none() {
                must_know_texts(&input, &clips)?;
            }
            for clip in &clips {
                let found = clip.features.frames();
                if found < needed {
                    let message = format!("clip `{}` has {}", clip.id, counted(found, "frame"));
                    let hint =
                        format!("a rollout needs {needed} frames of history: name a longer clip");
                    return Err(Error::usage(message, hint));
                }
                let text = ClipText::of(clip);
                let own = || vec![TimedPrompt { text, frames }];
                let job = Job::of_clip(clip, source.clone(), &texts, frames);
                rollouts.jobs.push(job);
                rollouts.starts.push(Start {
                    history: clip.features.slice(0..needed).joints(),
                    prompts: prompts.clone().unwrap_or_else(own),
                });
            }
        }
        if frames > longest {
            sink.note(&format!(
                "{frames} frames are more than `data.target_frames`, {longest}, the largest length \
                 that the model is trained with: it is given that length"
            ));
        }
        if let Some(warning) = guidance_without_dropout(trained, own) {
            sink.warning(&warning);
        }
        Ok(rollouts)
    }

    /// The initial clip of a rollout without a history: a clip with the first text as caption,
    /// preferably held out.
    fn chosen(
        &self,
        prompts: Option<&[TimedPrompt]>,
        needed: usize,
        sink: &mut dyn SampleSink,
    ) -> Result<(Option<String>, Vec<Arc<Clip>>), Error> {
        let data = &self.trained.config().data;
        let dataset = Dataset::<Clip>::open_among(data, &*sink.reading(), &Alone)?;
        let first = prompts.and_then(|prompts| prompts.first()?.text.as_ref());
        let caption = first.and_then(|text| text.caption.as_deref());
        let sets = [dataset.held_out(), &dataset.train];
        let clip = clip_with_caption(&sets, caption, needed)?;
        if let Some(clip) = &clip {
            let caption = clip.caption();
            let caption = caption.map_or("without a caption", |caption| &caption.text);
            sink.note(&format!(
                "no history given: continuing the beginning of clip `{}`: {caption}",
                clip.id
            ));
        }
        Ok((data.source.clone(), clip.into_iter().collect()))
    }
}

impl Sampler for Rollouts<'_> {
    fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    fn extensions(&self) -> &'static [&'static str] {
        Generated::JOINTS
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let config = self.trained.config();
        let how = &config.own::<FlowTables>().evaluation;
        let skeleton = config.data.humanml3d.skeleton();
        let generator = FlowGenerator::load(self.trained)?;
        let count = self.request.count;
        let all = count * self.jobs.iter().map(|job| job.frames).sum::<usize>();
        let (mut done, mut evaluations) = (0, 0);
        for (job, start) in self.starts.iter().enumerate() {
            let length = self.jobs[job].frames;
            let seed = self.jobs[job].seed(self.request.seed);
            for index in 0..count {
                let key = Key::new(seed, Purpose::Sampling).at(index as u64);
                let mut rollout =
                    generator.rollout(&start.history, length, &self.sampler, how, key)?;
                let mut frames = Vec::with_capacity(length * skeleton.joints());
                for prompt in &start.prompts {
                    rollout.push_text(&generator.text(prompt.text.as_ref())?)?;
                    for _ in 0..prompt.frames {
                        let sample = || format!("`{}`", run.name(job, index));
                        let frame = FlowGenerator::next_frame(&mut rollout, &sample)?;
                        frames.extend(frame.expect("frames remain"));
                        done += 1;
                        if run.sink.advance("", done, all).is_break() {
                            return Err(Error::Interrupted);
                        }
                    }
                }
                evaluations += rollout.evaluations();
                let record = Record {
                    rollout: Some(RolloutRecord {
                        constant_bones: how.constant_bones,
                        same_noise: how.same_noise,
                        evaluations_per_frame: rollout.evaluations() as f64 / length as f64,
                        prompts: TimedPrompt::records(&start.prompts),
                    }),
                    ..run.record(job, index)
                };
                let clip = Generated::Clip {
                    joints: Joints::new(frames, skeleton.joints()).expect("whole frames"),
                    skeleton: Box::new(skeleton.clone()),
                    features: None,
                    path: None,
                };
                run.pass(job, index, clip, record)?;
            }
        }
        let each = evaluations as f64 / all as f64;
        let frames = counted(all, "frame");
        let summary = format!("{frames}, {each:.1} velocity evaluations each");
        Ok(Some(Summary::Text(summary)))
    }
}

/// The first clip with the caption `text` and at least `needed` frames. Without such a clip, the
/// first clip.
fn clip_with_caption(
    sets: &[&ItemSet<Clip>],
    text: Option<&str>,
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
            if text.is_none_or(|text| captions.any(|caption| caption.text == text)) {
                return Ok(Some(clip));
            }
            first.get_or_insert(clip);
        }
    }
    // A clip that is too short causes an error with the clip's name.
    Ok(first.or(too_short))
}

/// The warning about guidance with a network trained without text dropout.
pub(super) fn guidance_without_dropout(trained: &TrainedModel, own: &FlowTables) -> Option<String> {
    let scale = trained.config().sampling.sampler.guidance_scale;
    let guided = scale != 1.0 && own.pose.cond_drop_prob == 0.0;
    guided.then(|| {
        format!(
            "`sampling.sampler.guidance_scale` is {scale}, and the run was trained with \
             `pose.cond_drop_prob = 0`: it does not know what motion without a text is"
        )
    })
}

/// Largest coordinate of a history, meters.
const FURTHEST: f32 = 1e4;

/// Allowed lengths of bones, meters.
const BONES: RangeInclusive<f64> = 0.005..=3.0;

/// Allowed heights of the lowest joint in meters, from the floor to a leap.
const LOWEST: RangeInclusive<f64> = -0.5..=1.5;

/// The error of an unusable history.
fn refused(path: &Path, space: &PoseSpace, found: String) -> Error {
    let (joints, needed) = (space.skeleton.joints(), space.history + 1);
    let hint = format!(
        "a history is joints in metres, `[T, {joints}, 3]` with {needed} frames or more, as \
         `kinegrad sample` writes them of a run on clips, or a BVH file"
    );
    Error::usage(format!("{}: {found}", path.display()), hint)
}

/// Joints `[T, J, 3]`.
fn read_history(path: &Path, space: &PoseSpace) -> Result<Joints, Error> {
    let array = read_array(path)?;
    let refused = |found: String| refused(path, space, found);
    let joints = space.skeleton.joints();
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
    Ok(Joints::from_f32(&array.values, joints)?)
}

/// A history of enough frames with a body.
fn checked_history(path: &Path, found: Joints, space: &PoseSpace) -> Result<Joints, Error> {
    let refused = |found: String| refused(path, space, found);
    let needed = space.history + 1;
    if found.frames() < needed || found.joints() != space.skeleton.joints() {
        let found = format!(
            "{} of {} joints",
            counted(found.frames(), "frame"),
            found.joints()
        );
        return Err(refused(found));
    }
    let names = &space.skeleton.description().joint_names;
    for frame in found.frames() - needed..found.frames() {
        let places = found.frame(frame);
        let bones = bone_lengths(&space.skeleton, places);
        for (bone, length) in bones.into_iter().enumerate() {
            if !BONES.contains(&length) {
                let (joint, name) = (bone + 1, &names[bone + 1]);
                let (least, most) = (BONES.start(), BONES.end());
                return Err(refused(format!(
                    "the bone to joint {joint} ({name}) is {length:.4} m long in frame {frame}, \
                     allowed: {least} to {most} m"
                )));
            }
        }
        let heights = places.iter().map(|place| place[1]);
        let lowest = heights.fold(f64::INFINITY, f64::min);
        if !LOWEST.contains(&lowest) {
            let (least, most) = (LOWEST.start(), LOWEST.end());
            return Err(refused(format!(
                "the lowest joint is at a height of {lowest:.2} m in frame {frame}, allowed: {least} \
                 to {most} m above the floor, which is where y is 0"
            )));
        }
    }
    // Motion without features causes an error with the file's name.
    match space.rows(&found) {
        Ok(_) => Ok(found),
        Err(error) => Err(refused(error.to_string())),
    }
}
