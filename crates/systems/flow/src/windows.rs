//! The samples of clips: a history, the next pose and their conditions.

use std::f64::consts::TAU;
use std::sync::Arc;

use kinegrad_data::humanml::{Caption, Clip, ClipSet};
use kinegrad_data::{Batch, ConditionRows, Error, SampleShape, Samples, TEXT};
use kinegrad_motion::humanml::{
    Extraction, FeatureError, FeatureStream, Joints, NextPose, Skeleton, TEXT_CHANNELS,
};
use kinegrad_motion::{ChannelMoments, Quaternion, Statistics};
use kinegrad_random::{Key, Purpose};
use kinegrad_train::clips::captions::TextInput;

use super::PoseConfig;

/// Name of the condition on past frames, `[12 J - 1, history]`, normalized.
pub const HISTORY: &str = "history";

/// Name of the condition on the next pose's position in the motion, `[2, 1]`: progress, from 1 at
/// the first pose to 0 at the last pose, and the number of poses relative to the longest motion.
pub const PLACE: &str = "place";

/// The representation of a sample.
#[derive(Clone, Debug)]
pub(super) struct PoseSpace {
    pub skeleton: Skeleton,
    /// Rows in a history.
    pub history: usize,
    pub target: NextPose,
    /// Number of poses at a duration of 1.
    pub longest: usize,
    /// Noise on training histories, meters.
    pub drift: f64,
}

impl PoseSpace {
    pub fn new(skeleton: Skeleton, pose: &PoseConfig, longest: usize) -> Self {
        Self {
            skeleton,
            history: pose.history_frames,
            target: pose.target,
            longest,
            drift: pose.history_noise_std,
        }
    }

    /// Frames of a history and the next pose.
    pub fn window(&self) -> usize {
        self.history + 2
    }

    /// The rows of features of `frames` ([`rows`]).
    pub fn rows(&self, frames: &Joints) -> Result<Vec<Vec<f32>>, FeatureError> {
        rows(&self.skeleton, frames)
    }

    /// Moments of a clip's features and target, over the clip turned by four angles: training turns
    /// windows by random angles, and rotations depend on the angle. With noise on histories, the
    /// moments of noised windows.
    pub fn moments(&self, clip: &Clip) -> [ChannelMoments; 2] {
        let joints = clip.features.joints();
        let (mut histories, mut targets) = (Vec::new(), Vec::new());
        let rows_of = |frames: &Joints| {
            let rows = self.rows(frames);
            rows.expect("the reader takes clips of this skeleton alone")
        };
        for quarter in 0..4 {
            let angle = 0.25 * TAU * quarter as f64;
            if self.drift == 0.0 {
                let rows = rows_of(&turned(&joints, 0..joints.frames(), angle));
                targets.extend(rows.iter().flat_map(|row| self.target_of(row)));
                histories.extend(rows.concat());
                continue;
            }
            let key = Key::new(0, Purpose::HistoryDrift)
                .named(&clip.id)
                .at(quarter);
            // Windows overlap by half, so that nearly every frame is in a history.
            for first in (0..=joints.frames() - self.window()).step_by(self.window() / 2) {
                let window = turned(&joints, first..first + self.window(), angle);
                let mut rows = rows_of(&drifting(&window, self.drift, key.at(first as u64)));
                let last = rows.pop().expect("a window has a next pose");
                targets.extend(self.target_of(&last));
                histories.extend(rows.concat());
            }
        }
        let (channels, joints) = (self.skeleton.layout().channels(), self.skeleton.joints());
        [
            ChannelMoments::measure(channels, [&histories[..]]),
            ChannelMoments::measure(3 * joints, [&targets[..]]),
        ]
    }

    fn target_of(&self, row: &[f32]) -> Vec<f32> {
        let target = self.target.of_row(row);
        target.expect("rows of this skeleton")
    }
}

/// The rows of features of `frames`, one row less than frames; each row has its own heading. The
/// first frame may face any direction.
pub(super) fn rows(skeleton: &Skeleton, frames: &Joints) -> Result<Vec<Vec<f32>>, FeatureError> {
    let threshold = Extraction::default().contact_threshold;
    let mut stream = FeatureStream::new(skeleton.clone(), threshold)?.with_own_heading();
    let mut rows = Vec::with_capacity(frames.frames());
    for t in 0..frames.frames() {
        rows.extend(stream.push(frames.frame(t))?);
    }
    Ok(rows)
}

/// Windows of clips, one per sample. Each epoch has new random window positions and headings,
/// because rotation features depend on the heading.
#[derive(Clone, Debug)]
pub(super) struct PoseWindows {
    pub clips: ClipSet,
    pub space: PoseSpace,
    /// Normalizes histories.
    pub features: Arc<Statistics>,
    /// Normalizes poses.
    pub target: Arc<Statistics>,
    pub text: TextInput,
    pub seed: u64,
}

impl PoseWindows {
    fn text_of(&self, caption: Option<&Caption>) -> Vec<f32> {
        let none = || vec![0.0; TEXT_CHANNELS];
        match self.text.labels() {
            Some(labels) => labels.values(caption.and_then(|caption| labels.row(&caption.text))),
            None => caption
                .and_then(|caption| caption.embedding.as_deref())
                .map_or_else(none, <[f32]>::to_vec),
        }
    }
}

impl Samples for PoseWindows {
    type Item = Clip;
    type Read = Arc<Clip>;

    fn items(&self) -> &ClipSet {
        &self.clips
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: self.target.channels(),
            frames: 1,
            conditions: vec![
                (HISTORY, self.features.channels(), self.space.history),
                (PLACE, 2, 1),
                (TEXT, self.text.channels(), 1),
            ],
        }
    }

    fn read(&self, position: usize) -> Result<Arc<Clip>, Error> {
        self.clips.get(position)
    }

    /// Validation uses the first caption, and a window determined by the clip's id.
    fn push(&self, batch: &mut Batch, clip: &Arc<Clip>, number: Option<u64>) {
        let key = |purpose| match number {
            Some(number) => Key::new(self.seed, purpose).at(number),
            None => Key::new(0, purpose).named(&clip.id),
        };
        let below = |bound, purpose| key(purpose).integers(1, bound)[0];
        let caption = match (clip.captions.len(), number) {
            (0, _) => None,
            (_, None) => clip.captions.first(),
            (count, Some(_)) => Some(&clip.captions[below(count, Purpose::Caption)]),
        };
        let all = clip.features.frames();
        let range = caption.map_or(0..all, |caption| {
            caption.frames(all, self.space.skeleton.description().fps)
        });
        let range = match range.len() < self.space.window() {
            true => 0..all,
            false => range,
        };
        let poses = range.len() + 1 - self.space.window();
        let pose = below(poses, Purpose::Crop);
        let first = range.start + pose;
        let joints = clip.features.joints();
        let angle = number.map_or(0.0, |_| TAU * key(Purpose::Augment).uniform());
        let mut window = turned(&joints, first..first + self.space.window(), angle);
        if let (Some(_), true) = (number, self.space.drift > 0.0) {
            window = drifting(&window, self.space.drift, key(Purpose::HistoryDrift));
        }
        let rows = self.space.rows(&window);
        let mut rows = rows.expect("the reader takes clips of this skeleton alone");
        let last = rows.pop().expect("a window has a next pose");
        let (history, channels) = (rows.len(), self.features.channels());
        let rows = rows.iter().flat_map(|row| self.features.normalize(row));
        let rows: Vec<f32> = rows.collect();
        let by_channel = (0..channels).flat_map(|c| rows.iter().skip(c).step_by(channels));
        let by_channel: Vec<f32> = by_channel.copied().collect();
        let place = place(pose, poses, self.space.longest);
        let text = self.text_of(caption);
        let conditions = [
            ConditionRows::all(&by_channel, history),
            ConditionRows::all(&place, 1),
            ConditionRows::all(&text, 1),
        ];
        let target = self.space.target_of(&last);
        batch.push(&clip.id, &target, &self.target, &conditions);
    }
}

/// Progress and duration of pose number `pose` of `poses` poses.
pub(super) fn place(pose: usize, poses: usize, longest: usize) -> [f32; 2] {
    let behind = pose as f32 / (poses - 1).max(1) as f32;
    [1.0 - behind, poses.min(longest) as f32 / longest as f32]
}

/// The frames `frames`, turned about the vertical axis by an angle in radians.
fn turned(joints: &Joints, frames: std::ops::Range<usize>, angle: f64) -> Joints {
    let turn = Quaternion::from_yaw(angle);
    let places = frames.flat_map(|t| joints.frame(t).iter().map(|&place| turn.rotate(place)));
    Joints::new(places.collect(), joints.joints()).expect("whole frames")
}

/// Share of a drift that the next pose corrects. Correcting the whole error in one frame makes the
/// motion shake, because the network cannot infer the error from the history.
const RETURN: f64 = 0.1;

/// Number of steps over which a drift grows to its standard deviation: the length of the source's
/// histories. In shorter histories, the drift grows at the same rate and ends smaller.
const DRIFT_STEPS: f64 = 16.0;

/// Adds random walks of the whole body and of each joint to the frames. Each random walk has a
/// standard deviation of `deviation` meters after [`DRIFT_STEPS`]. The last frame has the previous
/// frame's drift reduced by the share [`RETURN`], so that a target from the last two frames
/// corrects this share.
fn drifting(window: &Joints, deviation: f64, key: Key) -> Joints {
    let (frames, joints) = (window.frames(), window.joints());
    let steps = frames - 1;
    let step = deviation / DRIFT_STEPS.sqrt();
    let normals = key.normals(steps * (joints + 1) * 3);
    let mut drift = vec![[0.0; 3]; joints + 1];
    let mut places = Vec::with_capacity(frames * joints);
    for (t, normals) in normals.chunks_exact(3 * (joints + 1)).enumerate() {
        for (drift, normals) in drift.iter_mut().zip(normals.as_chunks::<3>().0) {
            *drift = [0, 1, 2].map(|axis| drift[axis] + step * f64::from(normals[axis]));
        }
        let (body, beside) = drift.split_first().expect("the body's");
        let of_frame = window.frame(t).iter().zip(beside);
        places.extend(
            of_frame.map(|(place, beside)| {
                [0, 1, 2].map(|axis| place[axis] + body[axis] + beside[axis])
            }),
        );
    }
    let (body, beside) = drift.split_first().expect("the body's");
    let last = window.frame(frames - 1).iter().zip(beside);
    places.extend(last.map(|(place, beside)| {
        [0, 1, 2].map(|axis| place[axis] + (1.0 - RETURN) * (body[axis] + beside[axis]))
    }));
    Joints::new(places, joints).expect("whole frames")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use kinegrad_data::{DataConfig, DataKind, Dataset, Loader};
    use kinegrad_motion::humanml::FeatureLayout;
    use kinegrad_motion::vector::length;

    use super::*;

    const HISTORY_FRAMES: usize = 6;
    const LONGEST: usize = 60;

    fn config() -> DataConfig {
        let mut config = DataConfig {
            kind: DataKind::SyntheticWalks,
            batch_size: 5,
            num_workers: 0,
            ..DataConfig::default()
        };
        config.synthetic.phrases = 4;
        config.synthetic.frames = 48;
        config
    }

    fn space(target: NextPose) -> PoseSpace {
        PoseSpace {
            skeleton: Skeleton::humanml3d(),
            history: HISTORY_FRAMES,
            target,
            longest: LONGEST,
            drift: 0.0,
        }
    }

    /// Windows without normalization.
    fn windows(target: NextPose) -> PoseWindows {
        let clips = Dataset::<Clip>::open(&config()).expect("walks").train;
        let [features, poses] = [263, 66].map(|channels| Arc::new(Statistics::unit(channels)));
        PoseWindows {
            clips,
            space: space(target),
            features,
            target: poses,
            text: TextInput::Embedding,
            seed: 3,
        }
    }

    /// The rows of a sample's history.
    fn history(batch: &Batch, sample: usize) -> Vec<Vec<f32>> {
        let condition = batch.condition(HISTORY).expect("a history");
        let values = &condition.values[sample * 263 * HISTORY_FRAMES..][..263 * HISTORY_FRAMES];
        let row = |t: usize| (0..263).map(|c| values[c * HISTORY_FRAMES + t]).collect();
        (0..HISTORY_FRAMES).map(row).collect()
    }

    #[test]
    fn the_target_is_the_pose_after_the_history() {
        for target in [NextPose::Position, NextPose::Displacement] {
            let windows = windows(target);
            let clips = windows.items().load().expect("walks");
            let batch = windows.collate(0..clips.len()).expect("in memory");
            for (sample, clip) in clips.iter().enumerate() {
                let rows = space(target).rows(&clip.features.joints()).expect("rows");
                let found = history(&batch, sample);
                let same = |(first, _): &(usize, &Vec<f32>)| {
                    let part = rows[*first..].iter().take(HISTORY_FRAMES);
                    part.eq(found.iter())
                };
                let (first, _) = rows
                    .iter()
                    .enumerate()
                    .find(same)
                    .expect("rows of the clip");
                let last = first + HISTORY_FRAMES;
                let expected = target.of_row(&rows[last]).expect("a pose");
                assert_eq!(batch.x_start[sample * 66..][..66], expected);
                // The history does not contain the pose: the last row ends at the previous frame.
                assert_ne!(
                    target.of_row(found.last().expect("rows")).expect("a pose"),
                    expected
                );
                let place = &batch.condition(PLACE).expect("a place").values[2 * sample..][..2];
                let poses = (clip.features.frames() - HISTORY_FRAMES - 1) as f32;
                assert!((place[0] - (1.0 - first as f32 / (poses - 1.0))).abs() < 1e-6);
                assert!((place[1] - poses / LONGEST as f32).abs() < 1e-6);
            }
        }
        assert_eq!(place(0, 41, 82), [1.0, 0.5]);
        assert_eq!(place(40, 41, 41), [0.0, 1.0]);
        assert_eq!(place(0, 1, 1), [1.0, 1.0]);
    }

    #[test]
    fn training_samples_new_windows_and_turns_them() {
        let config = config();
        let mut loader = Loader::new(windows(NextPose::Displacement), &config, 1, 0);
        let skeleton = Skeleton::humanml3d();
        let clips = Dataset::<Clip>::open(&config).expect("walks").train;
        let mut starts = BTreeSet::new();
        let mut turns = 0;
        for _ in 0..6 {
            let batch = loader.next().expect("a batch");
            for sample in 0..batch.batch_size {
                let clip = clips
                    .find(&batch.ids[sample])
                    .expect("read")
                    .expect("there");
                let rows = space(NextPose::Displacement).rows(&clip.features.joints());
                let rows = rows.expect("rows");
                let found = history(&batch, sample);
                // Except for rotations, features equal the clip's features in any direction.
                let apart = |first: usize, range: std::ops::Range<usize>| {
                    let pairs = rows[first..].iter().zip(&found);
                    let each = pairs.flat_map(|(a, b)| {
                        let pairs = a[range.clone()].iter().zip(&b[range.clone()]);
                        pairs.map(|(a, b)| (a - b).abs()).collect::<Vec<_>>()
                    });
                    each.fold(0.0, f32::max)
                };
                let layout = skeleton.layout();
                let places = layout.positions();
                let first = (0..rows.len() - HISTORY_FRAMES)
                    .find(|&first| apart(first, places.clone()) < 1e-4)
                    .expect("a window of the clip");
                assert!(apart(first, FeatureLayout::ROOT) < 1e-4);
                assert!(apart(first, layout.velocities()) < 1e-4);
                turns += usize::from(apart(first, layout.rotations()) > 0.05);
                starts.insert((batch.ids[sample].clone(), first));
            }
        }
        assert!(starts.len() > 20, "{}", starts.len());
        assert!(turns > 20, "{turns} of 30 are turned");
        let turned = turned(
            &Joints::new(vec![[1.0, 2.0, 0.0]; 3], 1).expect("frames"),
            1..3,
            0.5,
        );
        assert_eq!(turned.frames(), 2);
        let [x, y, z] = turned.frame(0)[0];
        assert!((length([x, 0.0, z]) - 1.0).abs() < 1e-9 && (y - 2.0).abs() < 1e-9);
        assert!(z.abs() > 0.4, "half a radian");
    }

    #[test]
    fn the_next_pose_corrects_a_share_of_the_drift() {
        let clip = Dataset::<Clip>::open(&config()).expect("walks").train;
        let clip = clip.get(0).expect("a walk");
        let joints = clip.features.joints();
        let window = turned(&joints, 3..3 + HISTORY_FRAMES + 2, 0.4);
        let key = |sample| Key::new(1, Purpose::HistoryDrift).at(sample);
        let now = HISTORY_FRAMES;
        let (mut heights, mut beside) = (Vec::new(), Vec::new());
        for sample in 0..200 {
            let found = drifting(&window, 0.03, key(sample));
            let apart = |joint: usize| {
                let [a, b] = [&found, &window].map(|frames| frames.frame(now)[joint][1]);
                a - b
            };
            let mean = (0..22).map(apart).sum::<f64>() / 22.0;
            heights.push(mean);
            beside.push(apart(20) - mean);
            for target in [NextPose::Position, NextPose::Displacement] {
                let space = space(target);
                let skeleton = space.skeleton.clone();
                let rows = space.rows(&found).expect("rows");
                let of_row = space.target_of(rows.last().expect("a next pose"));
                let mut stream = FeatureStream::new(skeleton, 0.002)
                    .expect("a threshold")
                    .with_own_heading();
                for t in 0..=now {
                    stream.push(found.frame(t)).expect("finite");
                }
                let (frame, facing) = stream.last().expect("frames");
                let next = target.apply(&of_row, frame, facing).expect("a pose");
                for (joint, place) in next.iter().enumerate() {
                    let recorded = window.frame(now + 1)[joint];
                    let drift = |i: usize| found.frame(now)[joint][i] - window.frame(now)[joint][i];
                    let left = [0, 1, 2].map(|i| place[i] - recorded[i] - 0.9 * drift(i));
                    assert!(length(left) < 1e-4, "{target}");
                }
            }
        }
        let deviation = |values: &[f64]| {
            let squares: f64 = values.iter().map(|value| value * value).sum();
            (squares / values.len() as f64).sqrt()
        };
        // The same growth rate as over the sixteen steps of the source's histories.
        let expected = 0.03 * ((HISTORY_FRAMES + 1) as f64 / 16.0).sqrt();
        for found in [deviation(&heights), deviation(&beside)] {
            let share = found / expected;
            assert!((0.83..1.2).contains(&share), "{found} {expected}");
        }
    }

    #[test]
    fn histories_of_training_drift_and_validation_is_as_it_was_recorded() {
        let drifting = |drift: f64| {
            let mut windows = windows(NextPose::Displacement);
            windows.space.drift = drift;
            windows
        };
        let clips = drifting(0.0).items().load().expect("walks");
        let validation = |drift| drifting(drift).collate(0..clips.len()).expect("in memory");
        assert_eq!(validation(0.0).x_start, validation(0.02).x_start);
        let training = |drift| {
            let batch = Loader::new(drifting(drift), &config(), 1, 0).next();
            batch.expect("a batch")
        };
        let [plain, drifted, again] = [0.0, 0.02, 0.02].map(training);
        assert_eq!(plain.ids, drifted.ids);
        assert_ne!(history(&plain, 0), history(&drifted, 0));
        assert_ne!(plain.x_start, drifted.x_start);
        assert_eq!(drifted.x_start, again.x_start);
        // Statistics include the drift: the trunk hardly moves from frame to frame, but drifts do.
        let deviation = |drift: f64| {
            let [_, target] = PoseSpace {
                drift,
                ..space(NextPose::Displacement)
            }
            .moments(&clips[0]);
            target.std[0]
        };
        let (plain, drifted) = (deviation(0.0), deviation(0.02));
        assert!(drifted > 1.5 * plain, "{plain}, {drifted}");
    }
}
