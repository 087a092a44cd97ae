//! The report of an ablation of audio.

use kinegrad_data::BeatAgreement;
use kinegrad_train::evaluation::{Better, Group, Metrics, Number, Results, with_sampling};
use serde_json::{Value, json};

use super::audio_variant::AudioVariant;
use super::means::{Mean, PHASE_ERRORS, to_json};
use super::scores::MeasuredPhrase;
use super::{Ablation, loss};
use crate::evaluate::Measures;
use crate::evaluate::beat_verdict::beat_verdict;

/// The numbers of an ablation.
pub(super) struct AblationReport {
    /// Number of songs of the held-out phrases.
    pub songs: usize,
    /// Agreement of the phrases' phase with the beats tracked in their music.
    pub tracked_beats: Option<BeatAgreement>,
    /// Error of the network's beat tracker; the estimate is `None` without a tracker.
    pub tracked_beat_error: Mean,
    /// The means for each audio variant.
    pub conditions: Vec<(AudioVariant, Vec<Mean>)>,
    /// Beat alignment of the real phrases.
    pub real: Vec<Mean>,
    /// Phase errors and measures of samples with own music at each guidance scale.
    pub guidance: Vec<(f64, Vec<Mean>, Measures)>,
    /// The values of each phrase.
    pub measured: Vec<MeasuredPhrase>,
}

impl AblationReport {
    /// The results, without remarks.
    pub fn results(&self, ablation: &Ablation<'_>) -> Results {
        let count = |count: usize| Some(count as u64);
        let (phrases, seeds) = (ablation.held_out.len(), ablation.settings.seeds);
        Results {
            json: self.json(ablation),
            facts: vec![
                ("phrases", [count(phrases); 2]),
                ("songs", [count(self.songs); 2]),
                ("seeds", [count(seeds), None]),
            ],
            samples: Some(groups(
                |variant| self.rows(variant),
                self.guidance.iter().flat_map(guidance_rows).collect(),
            )),
            real: groups(
                |variant| match variant {
                    AudioVariant::Own => self.real.rows(),
                    _ => Vec::new(),
                },
                Vec::new(),
            ),
            verdict: self.verdict(phrases),
            remarks: Vec::new(),
        }
    }

    /// Whether the samples follow the beat of their own music.
    fn verdict(&self, phrases: usize) -> Vec<String> {
        let mut own = self.conditions.iter();
        let own = own.find(|(variant, _)| *variant == AudioVariant::Own);
        let own = own.and_then(|(_, means)| {
            let error = means.iter().find(|mean| mean.name == PHASE_ERRORS[0].0);
            error?.estimate
        });
        let own = own.map(|own| beat_verdict(&own, phrases, self.tracked_beats.as_ref()));
        own.into_iter().collect()
    }

    fn json(&self, ablation: &Ablation<'_>) -> Value {
        let conditions = self.conditions.iter().map(|(variant, means)| {
            let mut json = to_json(means);
            json["audio"] = json!(variant);
            if *variant == AudioVariant::Own {
                json["own_minus"] = Value::Null;
            }
            json
        });
        let guidance = self.guidance.iter().map(|(scale, means, measures)| {
            let mut json = to_json(means);
            json["guidance_scale"] = json!(scale);
            json["measures"] = json!(measures);
            json
        });
        let (generator, settings) = (ablation.generator, ablation.settings);
        let json = json!({
            "phrases": ablation.held_out.len(),
            "songs": self.songs,
            "seeds": settings.seeds,
            "guidance_scales": settings.guidance_scales,
            "timesteps": loss::high_noise(generator.diffusion.config.num_train_timesteps),
            "tracked_beats": self.tracked_beats,
            "tracked_beat_error": self.tracked_beat_error.estimate,
            "conditions": conditions.collect::<Vec<_>>(),
            "real": to_json(&self.real),
            "guidance": guidance.collect::<Vec<_>>(),
            "measured": self.measured,
        });
        with_sampling(json, ablation.sampling())
    }

    /// The numbers of an audio variant; for another song, including errors relative to the
    /// conditioning music.
    fn rows(&self, variant: AudioVariant) -> Vec<Number> {
        let own = variant == AudioVariant::Own;
        let of_variant = self.conditions.iter().find(|(found, _)| *found == variant);
        let means = of_variant.into_iter().flat_map(|(_, means)| means);
        let tracked = Some(&self.tracked_beat_error);
        let tracked = tracked.filter(|mean| own && mean.estimate.is_some());
        let shown = |mean: &&Mean| {
            !mean.name.starts_with("condition_") || (!own && mean.estimate.is_some())
        };
        means
            .filter(shown)
            .chain(tracked)
            .flat_map(Mean::rows)
            .collect()
    }
}

/// A group for each audio variant and a group for the guidance scales.
fn groups(numbers: impl Fn(AudioVariant) -> Vec<Number>, guidance: Vec<Number>) -> Vec<Group> {
    let group = |(key, title), numbers| Group {
        key,
        title,
        numbers,
    };
    let variants = AudioVariant::ALL.map(|variant| {
        let numbers = Number::mark(numbers(variant), main(variant));
        group(variant.names(), numbers)
    });
    let guidance = group(("guidance", "GUIDANCE SCALES, OWN MUSIC"), guidance);
    variants.into_iter().chain([guidance]).collect()
}

/// The main measures of a variant.
fn main(variant: AudioVariant) -> &'static [(&'static str, Better)] {
    match variant {
        AudioVariant::Own => &[
            ("beat_phase_error.mean", Better::Lower),
            ("bar_phase_error.mean", Better::Lower),
            ("tracked_beat_error.mean", Better::Lower),
            ("peak_alignment.above_chance.mean", Better::NearReal),
        ],
        AudioVariant::Silence => &[
            ("own_minus.loss.mean", Better::Lower),
            ("own_minus.beat_phase_error.mean", Better::Lower),
        ],
        AudioVariant::HalfBeat | AudioVariant::OtherSong => {
            &[("own_minus.beat_phase_error.mean", Better::Lower)]
        }
        AudioVariant::Shuffled | AudioVariant::Reversed => &[],
    }
}

/// Names and titles begin with the scale.
fn guidance_rows((scale, means, measures): &(f64, Vec<Mean>, Measures)) -> Vec<Number> {
    let main = [("beat_phase_error.mean", Better::Lower)];
    let prefixed = |row: Number| Number {
        name: format!("{scale}.{}", row.name),
        line: row
            .line
            .map(|(title, shown)| (format!("{scale}: {title}"), shown)),
        ..row
    };
    // The means have the phase errors.
    let measures = measures.rows().into_iter();
    let measures = measures.filter(|row| !row.name.starts_with(PHASE_ERRORS[0].0));
    let rows = means.rows().into_iter().chain(measures);
    let rows = Number::mark(rows.collect(), &main).into_iter();
    rows.map(prefixed).collect()
}
