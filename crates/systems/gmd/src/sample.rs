//! Sampling clips conditioned on text, with or without goals.

use std::iter::repeat_n;

use kinegrad_motion::goal::{Goal, Trajectory};
use kinegrad_motion::humanml::Skeleton;
use kinegrad_settings::counted;
use kinegrad_train::checkpoint::SavedCheckpoint;
use kinegrad_train::clips::captions::{ClipText, must_know_texts, text_of};
use kinegrad_train::clips::path_target::{Fastest, FollowedPath};
use kinegrad_train::clips::read_goal;
use kinegrad_train::clips::requested;
use kinegrad_train::sampling::{
    BatchRecord, Condition, Generated, GoalCondition, GoalRecord, GroundRecord, Job, Needs, Record,
    Request, Run, SampleSink, Sampler, Summary,
};
use kinegrad_train::{Error, System, TrainedModel};

use super::generate::{
    ClipGenerator, ClipRequest, GeneratedClip, GroundBounds, keys, sampled_frames,
};
use super::load::{footprint, text_input};
use super::recipe_name::RecipeName;
use super::summary::{report, speeds};
use super::{Gmd, GmdConfig};

pub(super) fn accepts(recipe: &str) -> &'static [&'static str] {
    let all = &[
        "item",
        "held_out",
        "text",
        "text_embedding",
        "goal",
        "path",
        "trajectory",
    ];
    match recipe == RecipeName::Trajectory.name() {
        true => &all[..5],
        false => all,
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
                    let frames = request.frames.unwrap_or_else(own);
                    let source = data.source.clone();
                    clips.jobs.push(Job::of_clip(clip, source, &[], frames));
                    clips.clips.push(ClipRequest {
                        frames,
                        goal: None,
                        text: ClipText::of(clip),
                    });
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
        let Some(other) = others.next() else {
            return Ok(());
        };
        let message = format!("option `item` with option `{}`", other.name());
        let hint = "an item stands for the first caption of its clip; beside a goal, name the caption \
                    with option `text` or option `text_embedding`";
        Err(Error::usage(message, hint))
    }

    /// Reads goals, path and text.
    fn resolve(&mut self, sink: &mut dyn SampleSink) -> Result<(), Error> {
        let (trained, request) = (self.trained, self.request);
        let config = trained.config();
        let steering = &config.own::<GmdConfig>().steering;
        let usual = steering.usual_frames(config.data.target_frames);
        let skeleton = config.data.humanml3d.skeleton();
        let fps = skeleton.description().fps;
        // Each goal has its file, for warnings.
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
            let frames = request.frames.unwrap_or(usual);
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
            let file = goal.file.display();
            let hint = format!("{file} sets the length of the clip: `frames = {frames}`");
            let message = "option `frames` or option `seconds` with option `goal`";
            return Err(Error::usage(message, hint));
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
        let models = [config]
            .into_iter()
            .chain(self.trajectory.iter().map(TrainedModel::config));
        let inputs: Vec<_> = models.map(text_input).collect();
        let text = text_of(request, &inputs, &trained.device)?;
        let fastest = Fastest::of_clips(&trained.saved.state.statistics, &skeleton);
        for (file, goal, _) in &goals {
            for warning in goal.feasibility_warnings(fps, fastest.speed()) {
                sink.warning(&format!("{}: {warning}", file.display()));
            }
        }
        let path = self.path.as_ref();
        if let Some(warning) = path.and_then(|path| path.too_fast(fps, fastest)) {
            sink.warning(&warning);
        }
        let stage = request.trajectory().cloned().map(Condition::Trajectory);
        let shared: Vec<Condition> = request.text_conditions().chain(stage).collect();
        let frames = request.frames.unwrap_or(usual);
        let goals = goals.into_iter();
        let mut goals: Vec<_> = goals
            .map(|(_, goal, condition)| (Some(goal), Some(condition)))
            .collect();
        if goals.is_empty() {
            goals.push((None, None));
        }
        for (goal, condition) in goals {
            let request = ClipRequest {
                frames,
                goal,
                text: text.clone(),
            };
            self.longest = self.longest.max(request.length());
            self.jobs.push(Job {
                name: None,
                conditions: condition.into_iter().chain(shared.clone()).collect(),
                caption: None,
                frames: request.length(),
            });
            self.clips.push(request);
        }
        Ok(())
    }

    fn steered(&self) -> bool {
        self.clips.iter().any(|clip| clip.goal.is_some())
    }

    fn record(&self, run: &Run<'_>, job: usize, index: usize) -> Record {
        let own = &self.trained.config().own::<GmdConfig>().steering;
        let (padding, steering) = match self.path.is_some() || self.trajectory.is_some() {
            true => own.along_path().record(),
            false => own.record(),
        };
        let steered = self.clips[job].goal.is_some();
        let mut record = run.record(job, index);
        record.sampler.padding = Some(padding);
        record.sampler.steering = steered.then_some(steering);
        record.batch = steered.then(|| BatchRecord {
            count: self.request.count,
            goals: self.goals.clone(),
        });
        record
    }

    /// A clip that follows its path, with the record.
    fn finished(
        &self,
        sample: GeneratedClip,
        mut record: Record,
        skeleton: &Skeleton,
    ) -> Result<(Generated, Record), Error> {
        let Some(features) = sample.features else {
            return Ok((Generated::Ground(sample.ground), record));
        };
        let (mut joints, mut path) = (features.joints(), sample.path);
        if let Some(followed) = &self.path {
            let placed = followed.target.placed(&joints, skeleton)?;
            record.path = Some(followed.record(placed.report, None));
            joints = placed.joints;
            path = path.map(|points| followed.target.on_path(&points));
        }
        let clip = Generated::Clip {
            joints,
            skeleton: Box::new(skeleton.clone()),
            features: Some(features),
            path,
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

    /// Goals have consecutive numbers, because the guidance of each goal depends on the keyframes
    /// of all goals.
    fn is_one_batch(&self) -> bool {
        self.jobs.iter().all(|job| job.name.is_none())
    }

    fn needs(&self) -> Result<Vec<Needs>, Error> {
        let (trained, frames) = (self.trained, self.longest);
        let clips = self.jobs.len().saturating_mul(self.request.count);
        let networks = footprint(trained.config(), sampled_frames(trained.config(), frames))?;
        Ok(vec![Needs {
            work: format!(
                "sampling {} of {}",
                counted(clips, "clip"),
                counted(frames, "frame")
            ),
            bytes: networks.of_sampling(clips, self.steered(), trained.on_host),
            hint: match self.request.held_out_items() {
                Some(_) => HELD_OUT_HINT,
                None => HINT,
            },
        }])
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let (count, seed) = (self.request.count, self.request.seed);
        let repeated = |clip: &ClipRequest| repeat_n(clip.clone(), count);
        let requests: Vec<ClipRequest> = self.clips.iter().flat_map(repeated).collect();
        let of_job = |job: &Job| keys(job.seed(seed), count);
        let noise: Vec<_> = match self.is_one_batch() {
            true => keys(seed, requests.len()).collect(),
            false => self.jobs.iter().flat_map(of_job).collect(),
        };
        let longest = requests.iter().map(ClipRequest::length).max().unwrap_or(0);
        let trained = self.trained.config().data.target_frames;
        if longest > trained {
            run.sink.warning(&format!(
                "clips of {longest} frames are longer than those of training (`data.target_frames`, \
                 {trained}): no frame may be usable"
            ));
        }
        let trajectory = self.trajectory.as_ref().map(ClipGenerator::load);
        let generator = ClipGenerator::load(self.trained)?;
        let generator = match &self.path {
            Some(_) => generator.along_paths(),
            None => generator,
        };
        let samples = generator.sample(
            trajectory.transpose()?.as_ref(),
            &requests,
            &self.trained.config().sampling,
            &noise,
            &mut |stage, done, all| run.sink.advance(stage, done, all),
        )?;
        let skeleton = self.trained.config().data.humanml3d.skeleton();
        let bounds = GroundBounds::of(self.trained);
        let grounds = samples.iter().zip(&requests);
        let grounds =
            grounds.map(|(sample, request)| bounds.measured(sample, request.goal.as_ref()));
        let grounds: Vec<GroundRecord> = grounds.collect();
        let goals = report(&samples, &requests, &skeleton);
        let summary = goals.map(|goals| Summary::Text(format!("{goals}{}", speeds(&grounds))));
        for (number, (sample, ground)) in samples.into_iter().zip(grounds).enumerate() {
            let (job, index) = (number / count, number % count);
            let name = run.title(job, index);
            if ground.rejected > 0 {
                run.sink.note(&format!(
                    "{name} is attempt {} (at most {}, `steering.attempts`): the root's path was out \
                     of bounds before",
                    ground.rejected + 1,
                    self.trained.config().own::<GmdConfig>().steering.attempts,
                ));
            }
            let mut record = self.record(run, job, index);
            record.ground = Some(ground);
            let (clip, record) = self.finished(sample, record, &skeleton)?;
            run.pass(job, index, clip, record)?;
        }
        Ok(summary)
    }
}

/// The path as a goal with one position per frame, starting at the origin.
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

/// The trajectory model of a checkpoint, for the motion model `trained`.
pub(super) fn trajectory_model(
    trained: &TrainedModel,
    saved: SavedCheckpoint,
) -> Result<TrainedModel, Error> {
    let recipe = &saved.state.config.train.recipe;
    if recipe == RecipeName::Trajectory.name() {
        return Ok(trained.beside((&Gmd as &dyn System).read_tables(saved)?));
    }
    let path = saved.path.display();
    let message = format!("option `trajectory` is {path}, a run of recipe `{recipe}`");
    Err(Error::usage(
        message,
        "give a run of recipe `gmd_trajectory`",
    ))
}
