//! Sampling clips for the captions of a dataset's items.

use std::iter::repeat_n;
use std::sync::Arc;

use kinegrad_data::humanml::Clip;
use kinegrad_data::{DataConfig, Dataset};

use super::super::networks::text_input;
use super::{drawn, must_fit_as_batch, record};
use crate::TrainedModel;
use crate::captions::{ClipText, must_know_texts};
use crate::clips::{clips_named, dataset_or};
use crate::error::Error;
use crate::sampling::{
    BVH, Condition, FEATURES, MOTION, Names, Receiver, Record, Remark, Request, item_seed,
};
use crate::systems::gmd::generate::{ClipGenerator, ClipRequest, keys};
use crate::systems::gmd::recipe_name::RecipeName;

/// Generates one clip for each of `count` held-out clips, or training clips if none are held out,
/// conditioned on its caption.
pub(super) fn for_held_out(
    trained: &TrainedModel,
    count: usize,
    seed: u64,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    let config = trained.config();
    let dataset = Dataset::<Clip>::open_with_progress(&config.data, &*receiver.reading())?;
    let chosen = dataset.held_out().evenly(count)?;
    let hint = "all are drawn as one batch: draw fewer at the end of training \
                (`sampling.count_at_end`), or train on shorter clips (`data.target_frames`)";
    let items = Items {
        clips: &chosen,
        count: 1,
        frames: None,
        data: &config.data,
    };
    items.must_fit(trained, hint)?;
    let name = |clip: &Clip, _| clip.id.clone();
    items.draw(trained, seed, receiver, &name)
}

/// Generates the requested clips for captions of items of a dataset.
pub(super) fn for_items(
    trained: &TrainedModel,
    request: &Request,
    receiver: &mut dyn Receiver,
) -> Result<Option<Remark>, Error> {
    let conditions = &request.conditions;
    conditions.refuse(
        &[
            "--goal",
            "--path",
            "--trajectory-run",
            "--text",
            "--text-embedding",
        ],
        "`--item` and a run on clips of joint features",
        "`--item` alone stands for the first caption of all of the clip; beside a goal, name the \
         caption with `--text` or `--text-embedding FILE#KEY`",
    )?;
    let Some(pattern) = &conditions.item else {
        let hint = "name a clip with `--item ID`; `kinegrad data inspect URI` lists them";
        return Err(Error::usage("`--source` without `--item`", hint));
    };
    let data = dataset_or(&trained.config().data, conditions.source.as_deref());
    let dataset = Dataset::<Clip>::open_with_progress(&data, &*receiver.reading())?;
    let chosen = clips_named(&dataset, pattern)?;
    let items = Items {
        clips: &chosen,
        count: request.count,
        frames: request.frames,
        data: &data,
    };
    let hint = "all are drawn as one batch: name fewer (`--item`), ask for fewer (`--count`), or \
                shorter (`--frames`)";
    items.must_fit(trained, hint)?;
    let stem = |clip: &Clip| match chosen.len() {
        1 => String::new(),
        _ => format!("-{}", clip.id),
    };
    let names = Names {
        stems: chosen.iter().map(|clip| stem(clip)).collect(),
        count: request.count,
    };
    let extensions: &[&str] = match RecipeName::of(trained.config()) {
        RecipeName::Trajectory => &[MOTION],
        RecipeName::Motion => &[MOTION, FEATURES, BVH],
    };
    receiver.announced(&names, extensions)?;
    let name = |clip: &Clip, index| names.of(&stem(clip), index);
    items.draw(trained, request.seed, receiver, &name)
}

/// Clips whose first captions are conditions.
struct Items<'a> {
    clips: &'a [Arc<Clip>],
    /// Samples for each.
    count: usize,
    /// Frames of each; its clip's own, up to those of training, if not given.
    frames: Option<usize>,
    /// The dataset that they are of.
    data: &'a DataConfig,
}

impl Items<'_> {
    fn must_fit(&self, trained: &TrainedModel, hint: &str) -> Result<(), Error> {
        let clips = self.clips.len().saturating_mul(self.count);
        let frames = self.frames.unwrap_or(self.data.target_frames);
        must_fit_as_batch(trained, clips, frames, false, hint)
    }

    fn frames_of(&self, clip: &Clip) -> usize {
        let own = || clip.features.frames().min(self.data.target_frames);
        self.frames.unwrap_or_else(own)
    }

    /// Draws them as one batch. Sample k of a clip depends on the seed, the clip's id and k alone.
    fn draw(
        &self,
        trained: &TrainedModel,
        seed: u64,
        receiver: &mut dyn Receiver,
        name: &dyn Fn(&Clip, usize) -> String,
    ) -> Result<Option<Remark>, Error> {
        must_know_texts(&text_input(trained.config()), self.clips)?;
        let mut requests = Vec::new();
        let mut noise = Vec::new();
        for clip in self.clips {
            let request = ClipRequest {
                frames: self.frames_of(clip),
                goal: None,
                text: ClipText::of(clip),
            };
            requests.extend(repeat_n(request, self.count));
            noise.extend(keys(item_seed(seed, &clip.id), self.count));
        }
        let generator = ClipGenerator::load(trained)?;
        let samples = generator.sample_keyed(
            None,
            &requests,
            &trained.config().sampling,
            &noise,
            &mut |stage, done, all| receiver.advance(stage, done, all),
        )?;
        let skeleton = trained.config().data.humanml3d.skeleton.skeleton();
        for (clip, samples) in self.clips.iter().zip(samples.chunks(self.count)) {
            for (index, sample) in samples.iter().enumerate() {
                let record = Record {
                    condition: Condition {
                        item: Some(clip.id.clone()),
                        source: self.data.source.clone(),
                        ..Condition::default()
                    },
                    ..record(trained, seed, index, self.frames_of(clip), &skeleton)
                };
                receiver.drawn(drawn(name(clip, index), sample, &skeleton, record))?;
            }
        }
        Ok(None)
    }
}
