use kinegrad_diffusion::SamplerKind;
use kinegrad_models::Initializer;
use kinegrad_motion::ChannelMoments;
use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_random::Purpose;

use super::*;
use crate::network::FlowConfig;

/// A walk straight on.
fn walked(frames: usize) -> Joints {
    let skeleton = Skeleton::humanml3d();
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|seconds| 0.3 * seconds.sin()),
    };
    let places = walk::joints(&course, &skeleton, frames);
    Joints::new(places, skeleton.joints()).expect("finite")
}

fn space(next: NextPose) -> FlowSpace {
    let skeleton = Skeleton::humanml3d();
    let mut stream = FeatureStream::new(skeleton.clone(), 0.002).expect("valid");
    let clip = walked(60);
    let rows: Vec<Vec<f32>> = (0..60)
        .filter_map(|t| stream.push(clip.frame(t)).expect("a frame"))
        .collect();
    let targets = rows.iter().map(|row| next.of_row(row).expect("a row"));
    let statistics = |channels: usize, rows: Vec<f32>| {
        Statistics::standard(ChannelMoments::measure(channels, [&rows[..]]))
    };
    FlowSpace {
        features: statistics(263, rows.concat()),
        target: statistics(66, targets.flatten().collect()),
        next,
        prediction: FlowPrediction::Velocity,
        history: 5,
        longest: 196,
        skeleton,
    }
}

fn settings(frames: usize) -> RolloutSettings {
    RolloutSettings {
        sampler: SamplerConfig::new(SamplerKind::Euler, 3),
        frames,
        constant_bones: false,
        same_noise: false,
        contact_threshold: 0.002,
    }
}

fn begin(
    space: FlowSpace,
    settings: RolloutSettings,
    history: &Joints,
    seed: u64,
) -> Result<FlowRollout, Error> {
    let device = Device::flex();
    let init = Initializer::new(2, &device);
    let model = FlowConfig::tiny()
        .init(&space.skeleton, &init)
        .expect("a model");
    let key = Key::new(seed, Purpose::Sampling);
    FlowRollout::new(model, space, settings, history, key, &device)
}

fn all(mut rollout: FlowRollout) -> Vec<Vec<[f64; 3]>> {
    std::iter::from_fn(|| rollout.next_frame().expect("a frame")).collect()
}

fn apart(a: &[Vec<[f64; 3]>], b: &[Vec<[f64; 3]>]) -> f64 {
    let pairs = a
        .iter()
        .flatten()
        .flatten()
        .zip(b.iter().flatten().flatten());
    pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
}

#[test]
fn as_many_frames_are_drawn_as_asked_and_each_is_finite() {
    for next in [NextPose::Position, NextPose::Displacement] {
        let mut rollout = begin(space(next), settings(8), &walked(6), 1).expect("valid");
        for done in 0..8 {
            assert_eq!(rollout.remaining(), 8 - done);
            let frame = rollout.next_frame().expect("finite").expect("not the last");
            assert_eq!(frame.len(), 22);
            assert!(frame.as_flattened().iter().all(|value| value.is_finite()));
        }
        assert!(rollout.next_frame().expect("the end").is_none());
        assert_eq!(rollout.evaluations(), 8 * 3);
    }
}

#[test]
fn a_rollout_repeats_itself_and_everything_given_changes_it() {
    let (next, history) = (NextPose::Position, walked(9));
    let sample = |settings, history: &Joints, seed| {
        all(begin(space(next), settings, history, seed).expect("valid"))
    };
    let sampled = sample(settings(6), &history, 1);
    assert_eq!(sampled, sample(settings(6), &history, 1));
    // The rollout uses only the frames of one history.
    let recent = Joints::new(history.as_slice()[3 * 22..].to_vec(), 22).expect("frames");
    assert_eq!(sampled, sample(settings(6), &recent, 1));
    let older = Joints::new(history.as_slice()[..6 * 22].to_vec(), 22).expect("frames");
    let guided = RolloutSettings {
        sampler: SamplerConfig {
            guidance_scale: 3.0,
            ..settings(6).sampler
        },
        ..settings(6)
    };
    let midpoint = RolloutSettings {
        sampler: SamplerConfig {
            kind: SamplerKind::Midpoint,
            ..settings(6).sampler
        },
        ..settings(6)
    };
    let of_text = |settings, text: f32| {
        let mut rollout = begin(space(next), settings, &history, 1).expect("valid");
        rollout.push_text(&[text; 512]).expect("a text");
        all(rollout)
    };
    let text = of_text(settings(6), 0.2);
    for (what, other) in [
        ("key", sample(settings(6), &history, 2)),
        ("history", sample(settings(6), &older, 1)),
        ("frames", sample(settings(9), &history, 1)),
        ("solver", sample(midpoint, &history, 1)),
        ("text", text.clone()),
    ] {
        assert!(apart(&sampled, &other) > 1e-6, "{what}");
    }
    // Guidance acts on the text: without a text, guidance changes nothing.
    assert!(apart(&sampled, &sample(guided.clone(), &history, 1)) < 1e-6);
    assert!(apart(&text, &of_text(guided, 0.2)) > 1e-6);
}

#[test]
fn bones_are_constant_where_they_are_asked_to_be() {
    let lengths = |frame: &[[f64; 3]]| {
        let bones = Skeleton::humanml3d().offsets_of_frame(frame);
        bones
            .into_iter()
            .map(kinegrad_motion::vector::length)
            .collect::<Vec<f64>>()
    };
    let history = walked(6);
    let expected = lengths(history.frame(5));
    let furthest = |constant_bones| {
        let settings = RolloutSettings {
            constant_bones,
            ..settings(6)
        };
        let rollout = begin(space(NextPose::Displacement), settings, &history, 1);
        let frames = all(rollout.expect("valid"));
        let each = frames.iter().flat_map(|frame| {
            let pairs = lengths(frame).into_iter().zip(expected.clone());
            pairs.map(|(a, b)| (a - b).abs()).collect::<Vec<f64>>()
        });
        each.fold(0.0, f64::max)
    };
    assert!(furthest(true) < 1e-9);
    assert!(furthest(false) > 1e-3);
}

#[test]
fn the_same_noise_is_that_of_the_first_frame() {
    let history = walked(6);
    let sample = |same_noise| {
        let settings = RolloutSettings {
            same_noise,
            ..settings(4)
        };
        all(begin(space(NextPose::Position), settings, &history, 1).expect("valid"))
    };
    let (own, same) = (sample(false), sample(true));
    assert_eq!(own[0], same[0]);
    assert!(apart(&own[1..2], &same[1..2]) > 1e-6);
}

#[test]
fn what_a_rollout_cannot_begin_with_is_refused() {
    let good = || space(NextPose::Position);
    let short = begin(good(), settings(4), &walked(5), 1).expect_err("too short");
    assert_eq!(
        short.to_string(),
        "the history has 5 frames where at least 6 are needed"
    );
    let none = begin(good(), settings(0), &walked(6), 1).expect_err("no frames");
    assert!(none.to_string().starts_with("`frames` is 0"), "{none}");
    let narrow = FlowSpace {
        target: Statistics::unit(63),
        ..good()
    };
    let narrow = begin(narrow, settings(4), &walked(6), 1).expect_err("narrow");
    assert!(
        narrow.to_string().contains("statistics of the target"),
        "{narrow}"
    );
    let other = Joints::new(vec![[0.0; 3]; 21 * 6], 21).expect("finite");
    let other = begin(good(), settings(4), &other, 1).expect_err("another skeleton");
    assert!(other.to_string().contains("21"), "{other}");
    let mut rollout = begin(good(), settings(4), &walked(6), 1).expect("valid");
    for (text, expected) in [(vec![0.0; 511], "511"), (vec![f32::NAN; 512], "512")] {
        let refused = rollout
            .push_text(&text)
            .expect_err("a bad text")
            .to_string();
        assert!(refused.contains(expected), "{refused}");
    }
}
