//! Sampling motion composed of texts.

use kinegrad_motion::humanml::Root;
use kinegrad_random::{Key, Purpose};
use kinegrad_train::clips::captions::{ClipText, must_know_texts, text_of};
use kinegrad_train::clips::path_target::{FollowedPath, features_of};
use kinegrad_train::clips::{TimedPrompt, requested};
use kinegrad_train::sampling::{
    CompositionRecord, Condition, Generated, Job, Needs, Record, Request, Run, SampleSink, Sampler,
    Summary,
};
use kinegrad_train::{Error, System as _, TrainedModel};
use serde_json::to_value;

use super::load::{footprint, text_input};
use super::path::finish;
use super::{BpeTables, BpeTransformer, Composer, PathMethod};

/// Largest missing leg length that causes no warning, meters.
const LEGS_SHORT: f64 = 0.02;

pub(super) struct Compositions<'a> {
    trained: &'a TrainedModel,
    request: &'a Request,
    jobs: Vec<Job>,
    prompts: Vec<Vec<TimedPrompt>>,
    paths: Vec<Option<FollowedPath>>,
}

impl<'a> Compositions<'a> {
    /// Reads the conditions of a request.
    pub fn new(
        trained: &'a TrainedModel,
        request: &'a Request,
        sink: &mut dyn SampleSink,
    ) -> Result<Self, Error> {
        let mut resolved = Self {
            trained,
            request,
            jobs: Vec::new(),
            prompts: Vec::new(),
            paths: Vec::new(),
        };
        let config = trained.config();
        let fps = BpeTransformer.fps(config);
        let input = text_input(config);
        let clips = requested(trained, request, sink)?;
        let texts: Vec<Condition> = request.text_conditions().collect();
        if let Some((data, clips)) = clips {
            if let Some(text) = texts.first() {
                let message = format!("option `item` with option `{}`", text.name());
                let hint =
                    "an item stands for the first caption of its clip: leave out one of the two";
                return Err(Error::usage(message, hint));
            }
            must_know_texts(&input, &clips)?;
            for clip in &clips {
                let own = || clip.features.frames().min(data.target_frames);
                let prompt = TimedPrompt {
                    text: ClipText::of(clip),
                    frames: request.frames.unwrap_or_else(own),
                };
                let condition = Condition::Item {
                    id: clip.id.clone(),
                    source: data.source.clone(),
                };
                resolved.push(Some(clip.id.clone()), vec![condition], vec![prompt])?;
            }
        } else if let Some(prompts) = TimedPrompt::requested(request, &input, fps)? {
            if prompts.len() > 1 && config.data.humanml3d.root == Root::Absolute {
                let message = "several texts, and a run with `data.humanml3d.root = \"absolute\"`";
                let hint = "every clip of its training begins at the origin: train with a relative \
                            root";
                return Err(Error::usage(message, hint));
            }
            resolved.push(None, texts, prompts)?;
        } else {
            if request.is_unconditional() {
                sink.note("no condition given: sampling without a text");
            }
            let prompt = TimedPrompt {
                text: text_of(request, &[input], &trained.device)?,
                frames: request.frames.unwrap_or(config.data.target_frames),
            };
            resolved.push(None, texts, vec![prompt])?;
        }
        let method = config.own::<BpeTables>().evaluation.path.method;
        if request.path().is_none() && method != PathMethod::default() {
            sink.note("`evaluation.path.method` acts with option `path` alone");
        }
        Ok(resolved)
    }

    fn push(
        &mut self,
        name: Option<String>,
        mut conditions: Vec<Condition>,
        prompts: Vec<TimedPrompt>,
    ) -> Result<(), Error> {
        let frames = prompts.iter().map(|prompt| prompt.frames).sum();
        let fps = BpeTransformer.fps(self.trained.config());
        let file = self.request.path();
        conditions.extend(file.cloned().map(Condition::Path));
        let path = file.map(|file| FollowedPath::read(file, frames, fps));
        self.paths.push(path.transpose()?);
        self.jobs.push(Job {
            name,
            conditions,
            caption: None,
            frames,
        });
        self.prompts.push(prompts);
        Ok(())
    }
}

impl Sampler for Compositions<'_> {
    fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    fn extensions(&self) -> &'static [&'static str] {
        Generated::CLIP
    }

    fn needs(&self) -> Result<Vec<Needs>, Error> {
        let (trained, config) = (self.trained, self.trained.config());
        let longest = self.jobs.iter().map(|job| job.frames).max().unwrap_or(0);
        let mut networks = footprint(config, longest)?;
        let path = &config.own::<BpeTables>().evaluation.path;
        let tracked = self.request.path().is_some() && path.method.guides() && path.through_network;
        if config.sampling.sampler.guidance_scale != 1.0 {
            networks.passes = 2;
        }
        Ok(vec![Needs {
            work: format!("sampling a motion of {longest} frames"),
            bytes: networks.of_sampling(1, tracked, trained.on_host),
            hint: "ask for a shorter one",
        }])
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let config = self.trained.config();
        let own: &BpeTables = config.own();
        let composer = Composer::load(self.trained)?;
        let skeleton = config.data.humanml3d.skeleton();
        let (fps, fastest) = (skeleton.description().fps, composer.fastest()?);
        let (settings, count) = (&own.evaluation.path, self.request.count);
        let all = self.jobs.len() * count;
        for (job, prompts) in self.prompts.iter().enumerate() {
            let path = self.paths[job].as_ref();
            if let Some(warning) = path.and_then(|path| path.too_fast(fps, fastest)) {
                run.sink.warning(&warning);
            }
            for index in 0..count {
                let key = Key::new(self.jobs[job].seed(self.request.seed), Purpose::Sampling)
                    .at(index as u64);
                let before = job * count + index;
                let features = composer.compose(
                    prompts,
                    &config.sampling.sampler,
                    &own.evaluation,
                    path.map(|path| &path.target),
                    key,
                    &mut |done, steps| run.sink.advance("", before * steps + done, all * steps),
                )?;
                let mut record = Record {
                    composition: Some(CompositionRecord {
                        bpe_denoising_step: own.evaluation.bpe_denoising_step,
                        prompts: TimedPrompt::records(prompts),
                    }),
                    ..run.record(job, index)
                };
                let (joints, features) = match path {
                    None => (features.joints(), features),
                    Some(path) => {
                        let found = finish(&path.target, &features, &skeleton, settings)?;
                        if found.legs_short > LEGS_SHORT {
                            run.sink.warning(&format!(
                                "feet in contact slide by up to {:.2} m, because the legs do not \
                                 reach: the path is longer than the root path of the motion, or turns \
                                 more sharply",
                                found.legs_short
                            ));
                        }
                        if let Some(cut) = found.cut {
                            run.sink.warning(&cut.warning(self.jobs[job].frames, fps));
                        }
                        let features = match settings.method.moves_afterwards() {
                            true => features_of(&found.joints, &skeleton, features.root())?,
                            false => features,
                        };
                        let settings = to_value(settings).expect("plain data");
                        record.path = Some(path.record(found.report, Some(settings)));
                        (found.joints, features)
                    }
                };
                let clip = Generated::Clip {
                    joints,
                    skeleton: Box::new(skeleton.clone()),
                    features: Some(features),
                    path: None,
                };
                run.pass(job, index, clip, record)?;
            }
        }
        Ok(None)
    }
}
