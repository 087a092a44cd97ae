//! Sampling clips conditioned on text, with or without goals.

use std::iter::repeat_n;

use kinegrad_motion::goal::{Goal, Trajectory};
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::metrics::{GoalReport, GoalSample};

use super::generate::{ClipGenerator, ClipRequest, GeneratedClip, keys, sampled_frames};
use super::load::{footprint, text_input};
use super::recipe_name::RecipeName;
use super::{Gmd, GmdConfig};
use kinegrad_train::Error;
use kinegrad_train::System;
use kinegrad_train::TrainedModel;
use kinegrad_train::checkpoint::SavedCheckpoint;
use kinegrad_train::clips::captions::{ClipText, must_know_texts, text_of};
use kinegrad_train::clips::path_target::{Fastest, FollowedPath};
use kinegrad_train::clips::read_goal;
use kinegrad_train::clips::requested;
use kinegrad_train::sampling::{
    BatchRecord, Condition, Generated, GoalCondition, GoalRecord, Job, Needs, Record, Request, Run,
    SampleSink, Sampler, SamplerRecord, Summary, item_seed,
};

/// Conditions of clips, and of ground paths.
pub(super) fn accepts(recipe: &str) -> &'static [&'static str] {
    match recipe == RecipeName::Trajectory.name() {
        true => &["item", "held_out", "text", "text_embedding", "goal"],
        false => &[
            "item",
            "held_out",
            "text",
            "text_embedding",
            "goal",
            "path",
            "trajectory",
        ],
    }
}

/// Hint for clips that do not fit into memory.
const HINT: &str = "all clips are one batch: ask for fewer (options `count`, `goal`, `item`), or \
                    shorter (option `frames`)";

/// Hint for held-out clips that do not fit into memory.
const HELD_OUT_HINT: &str = "all are one batch: sample fewer at the end of training \
                             (`sampling.count_at_end`), or train on shorter clips \
                             (`data.target_frames`)";

/// A request for clips: all are sampled as one batch.
pub(super) struct Clips<'a> {
    trained: &'a TrainedModel,
    request: &'a Request,
    jobs: Vec<Job>,
    /// One for each job.
    clips: Vec<ClipRequest>,
    /// Goal files, in order.
    goals: Vec<GoalRecord>,
    path: Option<FollowedPath>,
    trajectory: Option<TrainedModel>,
    /// Frames of the longest clip, for the estimate of memory.
    longest: usize,
}

impl<'a> Clips<'a> {
    /// Reads the conditions of a request.
    ///
    /// # Errors
    /// If one cannot be used.
    pub fn new(
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Self, Error> {
        let mut clips = Self {
            trained,
            request,
            jobs: Vec::new(),
            clips: Vec::new(),
            goals: Vec::new(),
            path: None,
            trajectory: None,
            longest: 0,
        };
        match requested(trained, request, sink)? {
            Some((data, chosen)) => {
                clips.must_stand_alone()?;
                must_know_texts(&text_input(trained.config()), &chosen)?;
                clips.longest = request.frames.unwrap_or(data.target_frames);
                for clip in &chosen {
                    let own = || clip.features.frames().min(data.target_frames);
                    let condition = Condition::Item {
                        id: clip.id.clone(),
                        source: data.source.clone(),
                    };
                    clips.push(
                        Some(clip.id.clone()),
                        vec![condition],
                        ClipRequest {
                            frames: request.frames.unwrap_or_else(own),
                            goal: None,
                            text: ClipText::of(clip),
                        },
                    );
                }
            }
            None => clips.resolve(sink)?,
        }
        Ok(clips)
    }

    /// Rejects conditions beside an item.
    fn must_stand_alone(&self) -> Result<(), Error> {
        let others = self.request.conditions.iter();
        let mut others = others.filter(|condition| {
            !matches!(condition, Condition::Item { .. } | Condition::HeldOut(_))
        });
        match others.next() {
            None => Ok(()),
            Some(other) => Err(Error::usage(
                format!("option `item` with option `{}`", other.name()),
                "an item stands for the first caption of its clip; beside a goal, name the caption \
                 with option `text` or option `text_embedding`",
            )),
        }
    }

    /// Reads goals, path and text.
    fn resolve(&mut self, sink: &mut dyn SampleSink) -> Result<(), Error> {
        let (trained, request) = (self.trained, self.request);
        let config = trained.config();
        let skeleton = config.data.humanml3d.skeleton.skeleton();
        let fps = skeleton.description().fps;
        // Each with its file, for warnings.
        let mut goals = Vec::new();
        for GoalCondition { file, .. } in request.goals() {
            let (goal, digest) = read_goal(file)?;
            let sha256 = digest.to_string();
            self.goals.push(GoalRecord {
                file: file.clone(),
                sha256: sha256.clone(),
            });
            let condition = GoalCondition {
                file: file.clone(),
                goal: Some(goal.clone()),
                sha256: Some(sha256),
            };
            goals.push((file.clone(), goal, Condition::Goal(condition)));
        }
        if let Some(file) = request.path() {
            let frames = request.frames.unwrap_or(config.data.target_frames);
            let path = FollowedPath::read(file, frames, fps)?;
            let goal = along(&path);
            goals.push((file.file.clone(), goal, Condition::Path(file.clone())));
            self.path = Some(path);
        }
        if goals.is_empty() && request.trajectory().is_some() {
            let hint = "the first stage generates a path for a goal: pass option `goal` too";
            let message = "option `trajectory` without option `goal`";
            return Err(Error::usage(message, hint));
        }
        if let (Some(_), Some(goal)) = (request.frames, request.goals().next()) {
            let frames = goals[0].1.frames;
            let hint = format!(
                "{} sets the length of the clip: `frames = {frames}`",
                goal.file.display()
            );
            return Err(Error::usage(
                "option `frames` or option `seconds` with option `goal`",
                hint,
            ));
        }
        if request.is_unconditional() {
            sink.note("no condition given: sampling without a text and without a goal");
        }
        if let Some(condition) = request.trajectory() {
            let saved = match &condition.saved {
                Some(saved) => SavedCheckpoint::clone(saved),
                None => SavedCheckpoint::read(&condition.checkpoint)?,
            };
            self.trajectory = Some(trajectory_model(trained, saved)?);
        }
        let mut inputs = vec![text_input(config)];
        let of_stage = self.trajectory.iter();
        inputs.extend(of_stage.map(|model| text_input(model.config())));
        let text = request.text_conditions().next();
        let text = text.map(|condition| text_of(&condition, &inputs, &trained.device));
        let text = text.transpose()?.flatten();
        for (file, goal, _) in &goals {
            for doubt in goal.feasibility_warnings(fps) {
                sink.warning(&format!("{}: {doubt}", file.display()));
            }
        }
        if let Some(path) = &self.path {
            // Displacements of joint 0, metres per frame.
            let first = skeleton.layout().velocities().start;
            let fastest = Fastest::of(&trained.saved.state.statistics, first, fps);
            if let Some(doubt) = path.too_fast(fps, fastest) {
                sink.warning(&doubt);
            }
        }
        let shared: Vec<Condition> = request.text_conditions().collect();
        let stage = request.trajectory().cloned().map(Condition::Trajectory);
        let shared = shared.into_iter().chain(stage);
        let frames = request.frames.unwrap_or(config.data.target_frames);
        let goals: Vec<_> = goals
            .into_iter()
            .map(|(_, goal, condition)| (Some(goal), Some(condition)))
            .collect();
        let goals = match goals.is_empty() {
            true => vec![(None, None)],
            false => goals,
        };
        for (goal, condition) in goals {
            let request = ClipRequest {
                frames,
                goal,
                text: text.clone(),
            };
            self.longest = self.longest.max(request.length());
            let conditions = condition.into_iter().chain(shared.clone()).collect();
            self.push(None, conditions, request);
        }
        Ok(())
    }

    fn push(&mut self, name: Option<String>, conditions: Vec<Condition>, clip: ClipRequest) {
        self.jobs.push(Job {
            name,
            conditions,
            frames: clip.length(),
        });
        self.clips.push(clip);
    }

    fn steered(&self) -> bool {
        self.clips.iter().any(|clip| clip.goal.is_some())
    }

    /// The record of a clip.
    fn record(&self, run: &Run<'_>, job: usize, index: usize) -> Record {
        let own = &self.trained.config().own::<GmdConfig>().steering;
        let (padding, steering) = own.record();
        let steered = self.clips[job].goal.is_some();
        let record = run.record(job, index);
        Record {
            sampler: SamplerRecord {
                padding: Some(padding),
                steering: steered.then_some(steering),
                ..record.sampler
            },
            batch: steered.then(|| BatchRecord {
                count: self.request.count,
                goals: self.goals.clone(),
            }),
            ..record
        }
    }

    /// A clip cut to its length, on its path, with its record.
    fn finished(
        &self,
        sample: &GeneratedClip,
        record: Record,
        skeleton: &Skeleton,
    ) -> Result<(Generated, Record), Error> {
        let frames = record.frames;
        let Some(features) = &sample.features else {
            return Ok((Generated::Ground(sample.ground[..frames].to_vec()), record));
        };
        let features = features.slice(0..frames);
        let first = sample.path.as_ref().map(|path| path[..frames].to_vec());
        let mut record = record;
        let (joints, first) = match &self.path {
            None => (features.joints(), first),
            Some(path) => {
                let placed = path.target.placed(&features.joints(), skeleton)?;
                record.path = Some(path.record(placed.report, None));
                let first = first.map(|first| path.target.on_path(&first));
                (placed.joints, first)
            }
        };
        let clip = Generated::Clip {
            joints,
            skeleton: Box::new(skeleton.clone()),
            features: Some(features),
            path: first,
        };
        Ok((clip, record))
    }
}

impl Sampler for Clips<'_> {
    fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    fn extensions(&self) -> &'static [&'static str] {
        match (RecipeName::of(self.trained.config()), self.is_one_batch()) {
            (RecipeName::Trajectory, _) => Generated::ROWS,
            (RecipeName::Motion, true) => Generated::CLIP_OF_STAGES,
            (RecipeName::Motion, false) => Generated::CLIP,
        }
    }

    /// Goals are numbered through, as the guidance of each depends on the keyframes of all.
    fn is_one_batch(&self) -> bool {
        self.jobs.iter().all(|job| job.name.is_none())
    }

    fn needs(&self) -> Result<Vec<Needs>, Error> {
        let (trained, frames) = (self.trained, self.longest);
        let clips = self.jobs.len().saturating_mul(self.request.count);
        let networks = footprint(trained.config(), sampled_frames(trained.config(), frames))?;
        Ok(vec![Needs {
            work: format!("sampling {clips} clips of {frames} frames"),
            bytes: networks.of_sampling(clips, self.steered(), trained.on_host),
            hint: match self.request.held_out_items() {
                Some(_) => HELD_OUT_HINT,
                None => HINT,
            },
        }])
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let (count, seed) = (self.request.count, self.request.seed);
        let mut requests = Vec::new();
        for clip in &self.clips {
            requests.extend(repeat_n(clip.clone(), count));
        }
        let noise: Vec<_> = match self.is_one_batch() {
            true => keys(seed, requests.len()).collect(),
            false => {
                let names = self.jobs.iter().filter_map(|job| job.name.as_deref());
                names
                    .flat_map(|id| keys(item_seed(seed, id), count))
                    .collect()
            }
        };
        let trajectory = self.trajectory.as_ref().map(ClipGenerator::load);
        let samples = ClipGenerator::load(self.trained)?.sample_keyed(
            trajectory.transpose()?.as_ref(),
            &requests,
            &self.trained.config().sampling,
            &noise,
            &mut |stage, done, all| run.sink.advance(stage, done, all),
        )?;
        let skeleton = self.trained.config().data.humanml3d.skeleton.skeleton();
        for (number, sample) in samples.iter().enumerate() {
            let (job, index) = (number / count, number % count);
            let record = self.record(run, job, index);
            let (clip, record) = self.finished(sample, record, &skeleton)?;
            run.pass(job, index, clip, record)?;
        }
        Ok(report(&samples, &requests, &skeleton).map(Summary::Text))
    }
}

/// The path as a goal with a position for each frame, from the origin.
fn along(path: &FollowedPath) -> Goal {
    let points = path.target.at_origin().course.points;
    Goal {
        trajectory: Some(Trajectory {
            first_frame: 0,
            points,
        }),
        ..Goal::new(path.target.course.frames())
    }
}

/// The trajectory model of a checkpoint, beside the motion model `trained`.
///
/// # Errors
/// [`Error::Usage`] for a checkpoint of another recipe.
pub(super) fn trajectory_model(
    trained: &TrainedModel,
    saved: SavedCheckpoint,
) -> Result<TrainedModel, Error> {
    let recipe = &saved.state.config.train.recipe;
    if recipe == RecipeName::Trajectory.name() {
        return Ok(trained.beside((&Gmd as &dyn System).read_tables(saved)?));
    }
    let message = format!(
        "option `trajectory` is {}, a run of recipe `{recipe}`",
        saved.path.display()
    );
    Err(Error::usage(
        message,
        "give a run of recipe `gmd_trajectory`",
    ))
}

/// Distances of the clips from their goals.
fn report(
    samples: &[GeneratedClip],
    requests: &[ClipRequest],
    skeleton: &Skeleton,
) -> Option<String> {
    let measured: Vec<GoalSample> = samples
        .iter()
        .zip(requests)
        .filter_map(|(sample, request)| {
            Some(GoalSample {
                goal: request.goal.as_ref()?,
                ground: &sample.ground,
                joints: None,
            })
        })
        .collect();
    let (fps, feet) = (skeleton.description().fps, skeleton.contact_joints());
    (!measured.is_empty()).then(|| GoalReport::compute(&measured, fps, &feet).to_string())
}
