//! The evaluation of a trained model on its held-out phrases.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::Arc;

use kinegrad_data::{DataKind, Dataset, PhraseItem, PhraseSet, Songs};

use super::listening::{self, Heard, Listened, Listening, ListeningSettings, Stage};
use super::report::evaluated;
use super::{CondSource, EvaluationSettings, evaluate};
use crate::TrainedModel;
use crate::error::Error;
use crate::evaluation::{Evaluate, EvaluationRequest};
use crate::systems::cc_motion::generate::{self, Generator};
use crate::systems::cc_motion::lengths::{leading, untrained, windows};
use crate::systems::cc_motion::{CcMotionConfig, EvaluationConfig};

/// Bytes of memory that a frame of a sample takes: the raw motion and the post-processed one, and
/// the differences that are measured of each.
const BYTES_A_FRAME: u64 = 800;

/// Samples of a phrase with each thing that is heard, by the seeds, that are drawn at a time.
const HEARD: usize = Heard::ALL.len();

/// An evaluation on the held-out phrases.
///
/// # Errors
/// If the request does not apply, or nothing is held out.
pub fn prepare<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
) -> Result<Evaluate<'a>, Error> {
    request.refuse(
        &["--trajectory-run"],
        trained.path(),
        "a run on phrases",
        "only models that follow goals take a path from a first stage",
    )?;
    let wanted = trained.config().own::<CcMotionConfig>().evaluation.clone();
    let mut data = trained.config().data.clone();
    if let Some(source) = &request.source {
        data.kind = DataKind::Phrases;
        data.source = Some(source.clone());
    }
    let unheard = |_, _| ControlFlow::Continue(());
    let dataset = Dataset::<PhraseItem>::open_among(&data, &unheard, &*request.together)?;
    if dataset.validation.is_empty() {
        let message = format!(
            "no phrase is held out for {}: all {} are trained on",
            trained.path().display(),
            dataset.train.len()
        );
        let hint = "its config's `data.validation` holds out none of them; give a dataset that it \
                    does with option `source URI`, or train with another `data.validation`";
        return Err(Error::usage(message, hint));
    }
    let mut held_out = dataset.validation.load()?;
    held_out.truncate(wanted.phrases.unwrap_or(usize::MAX));
    let frames = held_out.iter().map(|phrase| phrase.frames() as u64);
    let of_a_seed = frames.sum::<u64>() * BYTES_A_FRAME;
    request.must_fit(
        of_a_seed.saturating_mul(wanted.seeds as u64),
        "all samples are compared with each other: choose fewer `evaluation.seeds` or \
         `evaluation.phrases`",
    )?;
    if request.listening {
        let songs = Songs::read(&data)?;
        return listening(trained, request, &wanted, &songs, held_out, &dataset.train);
    }
    let hint = "choose fewer `evaluation.seeds`: the samples of a phrase are drawn at a time";
    let processes = request.together.ranks().local().size;
    let lengths: BTreeSet<usize> = held_out.iter().map(|phrase| phrase.frames()).collect();
    for frames in lengths {
        generate::must_fit(trained, wanted.seeds, frames, processes, hint)?;
    }
    let together = request.together.clone();
    let settings = EvaluationSettings {
        seeds: wanted.seeds,
        seed: request.seed,
        cond: wanted.cond,
        sampling: trained.config().sampling.clone(),
    };
    let training = dataset.train.load()?;
    let drawn = |phrase: &Arc<PhraseItem>| {
        let windows = windows(trained.config(), phrase.frames());
        Ok(windows.map_or(phrase.frames(), |windows| windows.length()))
    };
    let lengths = held_out.iter().map(drawn);
    let odd = untrained(
        trained.config(),
        lengths.collect::<Result<Vec<_>, Error>>()?,
    );
    Ok(Box::new(move |on_step| {
        let generator = Generator::load(trained)?;
        let mut told = |done, all| on_step("", done, all);
        let evaluation = evaluate(
            &generator, &held_out, &training, &settings, &together, &mut told,
        )?;
        let mut evaluated = evaluated(&evaluation);
        if generator.statistics().movement.is_empty() {
            evaluated.remarks.push(format!(
                "{} was trained before kinegrad measured how training motion moves: the bounds of \
                 `strict` are those of its dataset's {} training phrases",
                evaluation.run,
                training.len()
            ));
        }
        evaluated.remarks.extend(odd);
        Ok(evaluated)
    }))
}

/// An evaluation of listening on the `held_out` phrases with beats, of each as much as training
/// shows at a time.
fn listening<'a>(
    trained: &'a TrainedModel,
    request: &EvaluationRequest,
    wanted: &EvaluationConfig,
    songs: &Songs,
    held_out: Vec<Arc<PhraseItem>>,
    train: &PhraseSet,
) -> Result<Evaluate<'a>, Error> {
    if wanted.cond != CondSource::Phrases {
        let message = "option `audio_ablation` with `evaluation.cond = \"noise\"`";
        let hint = "it is about music: it compares each phrase's own with silence, with its frames \
                    in other orders and with another song's";
        return Err(Error::usage(message, hint));
    }
    let frames = trained.config().data.target_frames;
    let beats_per_bar = wanted.beats_per_bar.map(|beats| beats as f64);
    let listened = |phrases: Vec<Arc<PhraseItem>>| -> Vec<Listened> {
        let cut = phrases.iter().map(|phrase| leading(phrase, frames));
        cut.filter_map(|phrase| Listened::new(phrase, songs, beats_per_bar))
            .collect()
    };
    let all = held_out.len();
    let held_out = listened(held_out);
    if held_out.is_empty() {
        let message = format!(
            "none of the {all} held-out phrases of {} has beats: their phase advances by less than \
             a beat in the {frames} frames that training shows at a time",
            trained.path().display()
        );
        let hint = "prepare them with the beats of their songs, or give another dataset with \
                    option `source URI`";
        return Err(Error::usage(message, hint));
    }
    let longest = held_out.iter().map(|one| one.phrase.frames()).max();
    let hint = "choose fewer `evaluation.seeds`: the samples of a phrase are drawn at a time";
    let processes = request.together.ranks().local().size;
    let at_a_time = wanted.seeds.saturating_mul(HEARD);
    let longest = longest.unwrap_or_default();
    generate::must_fit(trained, at_a_time, longest, processes, hint)?;
    let settings = ListeningSettings {
        seeds: wanted.seeds,
        seed: request.seed,
        guidance_scales: wanted.guidance_scales.clone(),
        sampling: trained.config().sampling.clone(),
    };
    let together = request.together.clone();
    let real = train.load()?;
    let training = listened(real.clone());
    Ok(Box::new(move |on_step| {
        let generator = Generator::load(trained)?;
        let stage = Stage {
            held_out: &held_out,
            training: &training,
            real: &real,
        };
        let found = listening::listen(&generator, &stage, &settings, &together, on_step)?;
        let mut evaluated = listening::evaluated(&found);
        evaluated.remarks = remarks(&found, &held_out, all);
        Ok(evaluated)
    }))
}

/// What should be known of an evaluation of listening on those of `all` held-out phrases that have
/// beats.
fn remarks(found: &Listening, held_out: &[Listened], all: usize) -> Vec<String> {
    let mut remarks = vec![format!(
        "{}: in brackets intervals of 95 %, phrases drawn again within songs drawn again; a phase \
         without relation to the music errs by 0.25",
        found.run
    )];
    if held_out.len() < all {
        remarks.push(format!(
            "{}: {} of {all} held-out phrases have no beats and are left out",
            found.run,
            all - held_out.len()
        ));
    }
    if found.songs == 1 {
        remarks.push(format!(
            "{}: all phrases are of one song: the intervals say nothing of other songs",
            found.run
        ));
    }
    let guessed = held_out.iter().filter(|one| one.guessed).count();
    if guessed > 0 {
        remarks.push(format!(
            "{}: {guessed} phrases are taken to have four beats in a bar, as nothing says how many \
             (`evaluation.beats_per_bar`)",
            found.run
        ));
    }
    let lacks = |heard| found.conditions.iter().all(|each| each.heard != heard);
    if lacks(Heard::OtherSong) {
        remarks.push(format!(
            "{}: the dataset has one song alone: no other one can be heard",
            found.run
        ));
    }
    remarks
}
