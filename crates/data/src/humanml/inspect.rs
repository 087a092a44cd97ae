//! What is in a dataset of clips, and what is wrong with it.

use std::ops::Range;

use kinegrad_motion::humanml::{FeatureLayout, Features};
use serde::Serialize;

use crate::survey::OpenProgress;
use crate::{ChannelSummary, DataConfig, Error, Problem};

use super::Clip;
use super::dataset::ClipSurvey;

/// How far the columns of a rotation may be from unit length.
const COLUMN_TOLERANCE: f32 = 0.05;

/// The contents of a dataset of clips. Numbers describe the clips that are used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClipInspection {
    /// The dataset's address, or `synthetic_walks`.
    pub source: String,
    /// Name of the skeleton.
    pub skeleton: String,
    /// Clips that are used.
    pub clips: usize,
    /// Clips that cannot be used.
    pub bad_clips: usize,
    /// Clips that are too short, too long, or have captions of short passages only.
    pub left_out: usize,
    /// Training clips.
    pub train: usize,
    /// Clips held out for validation.
    pub validation: usize,
    /// Frames of all clips together.
    pub frames: usize,
    /// Their length in hours.
    pub hours: f64,
    /// Frames per second.
    pub fps: f64,
    /// Frames of the shortest clip.
    pub shortest_frames: usize,
    /// Frames of the longest clip.
    pub longest_frames: usize,
    /// Captions of all clips together.
    pub captions: usize,
    /// Those of them that describe a passage and not the whole clip.
    pub passage_captions: usize,
    /// Clips without any.
    pub clips_without_captions: usize,
    /// Whether there are embeddings of the captions.
    pub conditional: bool,
    /// Channels of the features.
    pub channels: usize,
    /// Each group of channels, as stored (relative root), its channels taken together.
    pub groups: Vec<ChannelSummary>,
    /// What is wrong with single clips, by id.
    pub problems: Vec<Problem>,
    /// What is odd about the dataset as a whole.
    pub warnings: Vec<String>,
}

/// Looks at every clip of the dataset that `config` describes, whatever `on_bad_phrase` says.
///
/// # Errors
/// As [`ClipDataset::open`](super::ClipDataset::open), but never for a single bad clip or for a
/// side of the split that is empty.
pub fn inspect_clips(config: &DataConfig, progress: OpenProgress) -> Result<ClipInspection, Error> {
    config.validate()?;
    let mut clips = ClipSurvey::new(config)?;
    clips.survey.tolerates_changes = true;
    let outcomes = clips.survey.meet_all(progress, |_, met| {
        let measured = match met.left_out {
            Some(reason) => Err(reason),
            None => Ok(Measured::new(&met.item, met.note)),
        };
        (met.entry.side, measured)
    })?;
    let layout = clips.skeleton.layout();
    let fps = clips.skeleton.description().fps;
    let mut all = Measured::default();
    let mut lengths = Vec::new();
    let mut left_out = Vec::new();
    let mut inspection = ClipInspection {
        source: clips.survey.source.clone(),
        skeleton: clips.skeleton.description().name.clone(),
        clips: 0,
        bad_clips: 0,
        left_out: 0,
        train: 0,
        validation: 0,
        frames: 0,
        hours: 0.0,
        fps,
        shortest_frames: 0,
        longest_frames: 0,
        captions: 0,
        passage_captions: 0,
        clips_without_captions: 0,
        conditional: clips.conditional,
        channels: layout.channels(),
        groups: Vec::new(),
        problems: Vec::new(),
        warnings: std::mem::take(&mut clips.survey.warnings),
    };
    for (id, outcome) in outcomes {
        let problem = |problem: String, unusable| Problem {
            id: id.clone(),
            problem,
            unusable,
        };
        match outcome {
            Err(cause) => {
                inspection.bad_clips += 1;
                inspection.problems.push(problem(cause.to_string(), true));
            }
            Ok((_, Err(reason))) => left_out.push(format!("clip `{id}`: {reason}")),
            Ok((side, Ok(measured))) => {
                match clips.holds_out(&id, side) {
                    true => inspection.validation += 1,
                    false => inspection.train += 1,
                }
                lengths.push(measured.frames);
                inspection.clips_without_captions += usize::from(measured.captions == 0);
                let problems = measured.problems.iter();
                inspection
                    .problems
                    .extend(problems.map(|text| problem(text.clone(), false)));
                all.merge(measured);
            }
        }
    }
    if inspection.train == 0 {
        let warning = "no clip is left to train on";
        inspection.warnings.push(warning.to_owned());
    }
    if let Some(first) = left_out.first() {
        let count = left_out.len();
        inspection.warnings.push(format!(
            "{count} clip(s) are left out for their length; the first: {first}"
        ));
    }
    Ok(ClipInspection {
        clips: lengths.len(),
        left_out: left_out.len(),
        frames: all.frames,
        hours: all.frames as f64 / fps / 3600.0,
        shortest_frames: lengths.iter().copied().min().unwrap_or(0),
        longest_frames: lengths.iter().copied().max().unwrap_or(0),
        captions: all.captions,
        passage_captions: all.passages,
        groups: all.groups.iter().map(Group::summary).collect(),
        ..inspection
    })
}

/// What one clip, or several, come to.
#[derive(Default)]
struct Measured {
    frames: usize,
    captions: usize,
    passages: usize,
    groups: Vec<Group>,
    problems: Vec<String>,
}

impl Measured {
    fn new(clip: &Clip, note: Option<String>) -> Self {
        let features = &clip.features;
        let captions = clip.captions.iter();
        Self {
            frames: features.frames(),
            captions: clip.captions.len(),
            passages: captions.filter(|caption| caption.seconds.is_some()).count(),
            groups: Group::of(features),
            problems: note.into_iter().chain(odd_rotation(features)).collect(),
        }
    }

    fn merge(&mut self, other: Self) {
        self.frames += other.frames;
        self.captions += other.captions;
        self.passages += other.passages;
        match self.groups.is_empty() {
            true => self.groups = other.groups,
            false => (self.groups.iter_mut().zip(&other.groups)).for_each(|(a, b)| a.merge(b)),
        }
    }
}

/// Where the first rotation stands that is none: features that were normalised, or of another
/// layout.
fn odd_rotation(features: &Features) -> Option<String> {
    let layout = features.layout();
    (0..features.frames()).find_map(|t| {
        let rotations = &features.frame(t)[layout.rotations()];
        let (columns, _) = rotations.as_chunks::<3>();
        let length = |column: &[f32; 3]| column.iter().map(|value| value * value).sum::<f32>();
        let odd = |column: &[f32; 3]| (length(column).sqrt() - 1.0).abs() > COLUMN_TOLERANCE;
        let place = columns.iter().position(odd)?;
        Some(format!(
            "joint rotations are none in frame {t}: a column of joint {} has length {:.3}, 1 \
             expected (are the features normalised already?)",
            1 + place / 2,
            length(&columns[place]).sqrt()
        ))
    })
}

/// Range, mean and spread of a group of channels.
struct Group {
    name: &'static str,
    count: f64,
    min: f64,
    max: f64,
    mean: f64,
    /// Sum of the squared differences from the mean.
    squares: f64,
}

impl Group {
    const NAMES: [&'static str; 7] = [
        "root rotation",
        "root ground velocity",
        "root height",
        "joint positions",
        "joint rotations",
        "joint velocities",
        "foot contacts",
    ];

    fn of(features: &Features) -> Vec<Self> {
        let groups = FeatureLayout::groups(features.layout());
        let groups = Self::NAMES.into_iter().zip(groups);
        groups
            .map(|(name, channels)| Self::measure(name, features, &channels))
            .collect()
    }

    fn measure(name: &'static str, features: &Features, channels: &Range<usize>) -> Self {
        let values = || {
            let frames = (0..features.frames()).map(|t| features.frame(t));
            let values = frames.flat_map(|frame| &frame[channels.clone()]);
            values.map(|&value| f64::from(value))
        };
        let count = (features.frames() * channels.len()) as f64;
        let mean = values().sum::<f64>() / count;
        Self {
            name,
            count,
            min: values().fold(f64::INFINITY, f64::min),
            max: values().fold(f64::NEG_INFINITY, f64::max),
            mean,
            squares: values().map(|value| (value - mean).powi(2)).sum(),
        }
    }

    /// Chan, Golub and LeVeque, "Algorithms for Computing the Sample Variance" (1983).
    fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        let apart = other.mean - self.mean;
        self.squares += other.squares + apart * apart * self.count * other.count / count;
        self.mean += apart * other.count / count;
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.count = count;
    }

    fn summary(&self) -> ChannelSummary {
        ChannelSummary {
            name: self.name.to_owned(),
            min: self.min,
            max: self.max,
            mean: self.mean,
            std: (self.squares / self.count).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DataKind;
    use crate::humanml::{walk, write_features, write_walks};
    use kinegrad_motion::humanml::Root;
    use std::fs;

    #[test]
    fn clips_are_counted_and_what_is_wrong_is_listed() {
        let folder = tempfile::tempdir().unwrap();
        write_walks(folder.path(), 12, 80, 4).unwrap();
        let features = |index: usize| {
            folder
                .path()
                .join(format!("new_joint_vecs/walk_{index:05}.npy"))
        };
        fs::write(features(1), b"no array").unwrap();
        write_features(&features(2), &walk(2, 30, 4).features).unwrap();
        let layout = walk(0, 80, 4).features.layout();
        let flat = Features::new(vec![0.25; 50 * 263], layout, Root::Relative).unwrap();
        write_features(&features(3), &flat).unwrap();
        let config = DataConfig {
            kind: DataKind::Humanml3d,
            source: Some(folder.path().display().to_string()),
            ..DataConfig::default()
        };
        let found = inspect_clips(&config, &|_, _| {}).unwrap();
        assert_eq!((found.clips, found.bad_clips, found.left_out), (10, 1, 1));
        assert_eq!(found.train + found.validation, 10);
        assert_eq!(
            (found.frames, found.shortest_frames, found.longest_frames),
            (770, 50, 80)
        );
        assert!((found.hours - 770.0 / 72_000.0).abs() < 1e-12);
        assert!(found.conditional && found.captions >= 20 && found.channels == 263);
        assert_eq!(found.clips_without_captions, 0);
        let problems: Vec<_> = (found.problems.iter())
            .map(|p| (p.id.as_str(), p.unusable))
            .collect();
        assert_eq!(
            problems,
            [("walk_00001", true), ("walk_00003", false)],
            "{found:?}"
        );
        assert!(
            found.problems[1]
                .problem
                .contains("joint rotations are none in frame 0")
        );
        assert!(found.warnings[0].contains("clip `walk_00002`: too short: 30 frames"));
    }

    #[test]
    fn groups_are_summed_up_over_all_clips() {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            ..DataConfig::default()
        };
        config.synthetic.phrases = 4;
        config.synthetic.frames = 50;
        let found = inspect_clips(&config, &|_, _| {}).unwrap();
        assert_eq!((found.clips, found.frames), (4, 200));
        let clips: Vec<_> = (0..4).map(|index| walk(index, 50, 0)).collect();
        let heights: Vec<f64> = (clips.iter())
            .flat_map(|clip| (0..50).map(|t| f64::from(clip.features.frame(t)[3])))
            .collect();
        let mean = heights.iter().sum::<f64>() / 200.0;
        let square = heights
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>();
        let height = &found.groups[2];
        assert_eq!(height.name, "root height");
        assert!((height.mean - mean).abs() < 1e-12);
        assert!((height.std - (square / 200.0).sqrt()).abs() < 1e-12);
        assert_eq!(height.max, heights.iter().copied().fold(f64::MIN, f64::max));
        assert!(found.problems.is_empty(), "{:?}", found.problems);
    }
}
