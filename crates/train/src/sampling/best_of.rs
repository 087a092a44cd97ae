//! The best of several samples of a condition.

use kinegrad_motion::goal::Goal;
use serde::{Deserialize, Serialize};

use super::generated::{BVH, FEATURES};
use super::{Condition, Generated, Record, Request, Sample, Sampler};
use crate::error::Error;

/// A request for the best of several samples of each condition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BestOf {
    /// Samples of which one is kept.
    pub count: usize,
    /// What they are compared by: the first measure decides, the next ones if it is equal, and then
    /// the number of the sample.
    pub by: Vec<SelectBy>,
}

impl BestOf {
    /// # Errors
    /// [`Error::Usage`] for a measure that the samples of `sampler` for `request` do not have.
    pub(crate) fn must_suit(&self, sampler: &dyn Sampler, request: &Request) -> Result<(), Error> {
        let extensions = sampler.extensions();
        let is_body = extensions.contains(&BVH);
        let has = |by: SelectBy| match by {
            SelectBy::Checks => is_body || extensions == Generated::PHRASE,
            SelectBy::Beat => extensions == Generated::PHRASE,
            SelectBy::Goal => request.goals().next().is_some() || request.path().is_some(),
            SelectBy::Skating => is_body,
            SelectBy::Text => {
                let has_text = sampler.jobs().iter().all(|job| job.text().is_some());
                has_text && extensions.contains(&FEATURES)
            }
        };
        let Some(by) = self.by.iter().find(|by| !has(**by)) else {
            return Ok(());
        };
        // An evaluator is not known to be configured.
        let known = SelectBy::ALL.into_iter();
        let known = known.filter(|by| has(*by) && *by != SelectBy::Text);
        let known: Vec<&str> = known.map(SelectBy::name).collect();
        let hint = match known.is_empty() {
            true => "leave option `best_of` out".to_owned(),
            false => format!("these samples can be selected by {}", known.join(", ")),
        };
        let problem = format!(
            "option `select_by` is `{}`, which these samples lack",
            by.name()
        );
        Err(Error::usage(problem, hint))
    }
}

/// A measure that samples are ranked by; the least value is best.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SelectBy {
    /// Number of failed checks and, below 1, how far the measures are out of the 1st and 99th
    /// percentile of training motion.
    Checks,
    /// 1 less the beat alignment of the root's speed peaks with the audio features of a phrase.
    Beat,
    /// Mean distance of the root from the goal's keyframes or from its place on the path, metres, and
    /// how far the root's path is out of bounds.
    Goal,
    /// Foot skating of a body.
    Skating,
    /// Distance between the embeddings of text and motion, by the run's text-motion evaluator.
    Text,
}

impl SelectBy {
    /// All measures.
    pub const ALL: [Self; 5] = [
        Self::Checks,
        Self::Beat,
        Self::Goal,
        Self::Skating,
        Self::Text,
    ];

    /// The name in options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Checks => "checks",
            Self::Beat => "beat",
            Self::Goal => "goal",
            Self::Skating => "skating",
            Self::Text => "text",
        }
    }

    /// The score of a measured sample; `None` if it lacks the measure.
    fn score(self, generated: &Generated, record: &Record) -> Option<f64> {
        let measured = record.body.as_ref().or(record.phrase.as_ref());
        match self {
            Self::Checks => {
                let measured = measured?;
                let out = measured.measures.values().filter_map(|found| {
                    let [least, most] = found.training?;
                    let out = (least - found.value).max(found.value - most).max(0.0);
                    Some(out / (most - least).max(f64::MIN_POSITIVE))
                });
                let out: f64 = out.sum();
                Some(measured.failed.len() as f64 + out / (1.0 + out))
            }
            Self::Beat => Some(1.0 - record.beat_alignment?),
            Self::Goal => {
                let goals = record
                    .condition
                    .iter()
                    .filter_map(|condition| match condition {
                        Condition::Goal(goal) => goal.goal.as_ref(),
                        _ => None,
                    });
                let missed = goals.filter_map(|goal| distance(goal, generated)).next();
                let path = record.path.as_ref().map(|path| path.report.mean_error);
                let ground = record.ground.as_ref().map(|ground| ground.excess());
                let missed = missed.or(path)?;
                Some(missed + ground.unwrap_or(0.0))
            }
            Self::Skating => Some(measured?.measures.get("skating")?.value),
            Self::Text => record.text_distance,
        }
    }
}

/// Mean distance of the root from a goal's keyframes, metres; `None` without keyframes or a root.
fn distance(goal: &Goal, generated: &Generated) -> Option<f64> {
    let places: Vec<[f64; 2]> = match generated {
        Generated::Clip { joints, .. } => {
            let roots = joints.track(0).into_iter();
            roots.map(|[x, _, z]| [x, z]).collect()
        }
        Generated::Ground(places) => places.clone(),
        Generated::Phrase { .. } | Generated::Rows { .. } => return None,
    };
    let distances = goal.keyframes.iter().filter_map(|keyframe| {
        let [x, z] = places.get(keyframe.frame)?;
        Some((x - keyframe.x).hypot(z - keyframe.z))
    });
    let distances: Vec<f64> = distances.collect();
    let count = distances.len() as f64;
    (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / count)
}

/// The selection of a sample among others, for its record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelectionRecord {
    /// What the samples are compared by.
    pub by: Vec<SelectBy>,
    /// The scores of all samples by number; the least is best.
    pub scores: Vec<Vec<f64>>,
    /// The number of the best sample, from 0.
    pub selected: usize,
}

impl SelectionRecord {
    /// A line about the selection of the sample called `title`.
    pub(super) fn line(&self, title: &str) -> String {
        let scores = |name: usize| self.scores.iter().map(move |scores| scores[name]);
        let of_measure = self.by.iter().enumerate().map(|(place, by)| {
            let [least, most] = [f64::min, f64::max].map(|of| scores(place).reduce(of));
            format!(
                "{} {:.3} (of all: {:.3} to {:.3})",
                by.name(),
                self.scores[self.selected][place],
                least.unwrap_or_default(),
                most.unwrap_or_default()
            )
        });
        let measures: Vec<String> = of_measure.collect();
        format!(
            "{title} is number {} of 0 to {}: {}",
            self.selected,
            self.scores.len() - 1,
            measures.join(", ")
        )
    }
}

/// The best of a job's samples so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Selection {
    best: Option<(usize, Sample)>,
    scores: Vec<Vec<f64>>,
}

impl Selection {
    /// Adds the next sample. Returns the best sample after the last one. A sample without a measure
    /// comes last.
    pub fn add(
        &mut self,
        best_of: &BestOf,
        generated: Generated,
        record: Record,
    ) -> Option<Sample> {
        let score = |by: &SelectBy| by.score(&generated, &record).unwrap_or(f64::INFINITY);
        let scores: Vec<f64> = best_of.by.iter().map(score).collect();
        let is_better = self.best.as_ref().is_none_or(|(best, _)| {
            let pairs = scores.iter().zip(&self.scores[*best]);
            let mut orders = pairs.map(|(a, b)| a.total_cmp(b));
            orders
                .find(|order| order.is_ne())
                .is_some_and(|order| order.is_lt())
        });
        if is_better {
            let sample = Sample {
                name: String::new(),
                files: generated.files(),
                record,
            };
            self.best = Some((self.scores.len(), sample));
        }
        self.scores.push(scores);
        if self.scores.len() < best_of.count {
            return None;
        }
        let Self { best, scores } = std::mem::take(self);
        let (selected, mut sample) = best.expect("a sample");
        sample.record.selection = Some(SelectionRecord {
            by: best_of.by.clone(),
            scores,
            selected,
        });
        Some(sample)
    }
}

#[cfg(test)]
mod tests {
    use kinegrad_diffusion::SamplerConfig;
    use kinegrad_motion::{CHANNELS, Phrase};

    use super::super::{MeasureRecord, MeasuresRecord, SamplerRecord};
    use super::*;
    use crate::config::{ClipSample, ProductPrecision};

    fn record(failed: usize, skating: f64) -> Record {
        let measure = MeasureRecord {
            value: skating,
            frame: None,
            joint: None,
            training: Some([0.0, 0.5]),
        };
        Record {
            body: Some(MeasuresRecord {
                measures: [("skating".to_owned(), measure)].into(),
                failed: vec!["check".to_owned(); failed],
                far: false,
            }),
            ..Record::blank(SamplerRecord {
                settings: SamplerConfig::default(),
                clip: ClipSample::default(),
                clip_range: None,
                precision: ProductPrecision::default(),
                padding: None,
                steering: None,
            })
        }
    }

    fn generated() -> Generated {
        let motion = Phrase::new(vec![0.0; CHANNELS]).unwrap();
        Generated::Phrase {
            raw: motion.clone(),
            motion,
        }
    }

    /// The number of the selected sample.
    fn selected(by: &[SelectBy], samples: &[(usize, f64)]) -> usize {
        let best_of = BestOf {
            count: samples.len(),
            by: by.to_vec(),
        };
        let mut selection = Selection::default();
        for (index, &(failed, skating)) in samples.iter().enumerate() {
            let record = Record {
                index,
                ..record(failed, skating)
            };
            let found = selection.add(&best_of, generated(), record);
            assert_eq!(found.is_some(), index + 1 == samples.len());
            if let Some(sample) = found {
                let selection = sample.record.selection.expect("scores");
                assert_eq!(selection.scores.len(), samples.len());
                return sample.record.index;
            }
        }
        unreachable!("the last sample ends it")
    }

    #[test]
    fn the_first_measure_decides_then_the_next_then_the_number() {
        use SelectBy::{Checks, Skating};
        assert_eq!(selected(&[Checks], &[(2, 0.1), (0, 0.4), (1, 0.0)]), 1);
        assert_eq!(selected(&[Skating], &[(2, 0.1), (0, 0.4), (1, 0.0)]), 2);
        assert_eq!(
            selected(&[Checks, Skating], &[(1, 0.2), (1, 0.1), (1, 0.1)]),
            1
        );
        // Equal numbers of failed checks: the measures nearer to training.
        assert_eq!(selected(&[Checks], &[(1, 0.9), (1, 0.6), (1, 0.7)]), 1);
        assert_eq!(selected(&[Skating], &[(0, f64::NAN), (0, 0.9)]), 1);
    }

    #[test]
    fn the_text_distance_decides() {
        let best_of = BestOf {
            count: 3,
            by: vec![SelectBy::Text],
        };
        let mut selection = Selection::default();
        let mut add = |index: usize, text_distance: Option<f64>| {
            let record = Record {
                text_distance,
                index,
                ..record(0, 0.1)
            };
            selection.add(&best_of, generated(), record)
        };
        assert!(add(0, None).is_none() && add(1, Some(2.0)).is_none());
        let best = add(2, Some(1.5)).expect("the best").record;
        assert_eq!(best.index, 2);
        let scores = best.selection.expect("scores").scores;
        assert_eq!(scores, [[f64::INFINITY], [2.0], [1.5]]);
    }

    #[test]
    fn a_sample_without_a_measure_comes_last() {
        let best_of = BestOf {
            count: 2,
            by: vec![SelectBy::Beat],
        };
        let mut selection = Selection::default();
        assert!(
            selection
                .add(&best_of, generated(), record(0, 0.1))
                .is_none()
        );
        let aligned = Record {
            beat_alignment: Some(0.2),
            index: 1,
            ..record(3, 0.9)
        };
        let best = selection
            .add(&best_of, generated(), aligned)
            .expect("the best");
        assert_eq!(best.record.index, 1);
    }
}
