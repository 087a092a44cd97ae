//! Properties of every synthesis.

use proptest::prelude::*;

use super::*;
use crate::{CoarseRatio, Distance, Preset};

/// A motion of smooth channels, different for every seed.
fn motion(seed: u64, frames: usize, channels: usize) -> Frames {
    let key = Key::new(seed, Purpose::Synthetic);
    let phases = key.uniforms(2 * channels);
    let values = (0..frames).flat_map(|t| {
        let phases = &phases;
        (0..channels).map(move |c| {
            let speed = 0.05 + 0.3 * phases[2 * c];
            0.8 * (speed * t as f32 + 6.0 * phases[2 * c + 1]).sin()
        })
    });
    Frames::new(channels, values.collect())
}

fn settings(patch_size: usize) -> Settings {
    Settings {
        patch_size,
        ..Settings::of(Preset::Published)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_length_and_any_examples_work(
        seed in 0..100u64,
        half in 1..6usize,
        lengths in proptest::collection::vec(11..90usize, 1..4),
        frames in 11..200usize,
        around in 0..3usize,
        paper: bool,
        ratio in 0.001..1.5f64,
        direct: bool,
    ) {
        let examples: Vec<Frames> = lengths
            .iter()
            .enumerate()
            .map(|(index, &frames)| motion(seed + index as u64, frames, 3))
            .collect();
        let settings = Settings {
            patch_size: 2 * half + 1,
            looping: [Looping::Off, Looping::Halves, Looping::Even][around],
            coarse_ratio: match direct {
                true => CoarseRatio::Ratio(ratio),
                false => CoarseRatio::Patches(4.0 * ratio),
            },
            ..Settings::of(if paper { Preset::Paper } else { Preset::Published })
        };
        let request = Request {
            examples: &examples,
            frames,
            settings: &settings,
            groups: &[],
            constraints: &[],
        };
        let new = synthesize(&request, seed).unwrap();
        prop_assert_eq!(new.frames.frames(), frames);
        let [origins] = &new.origins[..] else { panic!("one group") };
        prop_assert_eq!(origins.len(), frames);
        for &(example, frame) in origins {
            prop_assert!(frame < lengths[example]);
        }
        // Every value is a mean of the examples' values.
        for channel in 0..3 {
            let of = |frames: &Frames| frames.columns(&[channel]).values().to_vec();
            let all = examples.iter().flat_map(of).collect::<Vec<_>>();
            let (low, high) = (
                all.iter().copied().fold(f32::INFINITY, f32::min),
                all.iter().copied().fold(f32::NEG_INFINITY, f32::max),
            );
            for value in of(&new.frames) {
                prop_assert!(value >= low - 1e-5 && value <= high + 1e-5);
            }
        }
    }

    #[test]
    fn neighbours_are_those_of_the_definition(
        seed in 0..1000u64,
        half in 0..4usize,
        n in 9..40usize,
        lengths in proptest::collection::vec(3..30usize, 1..4),
        l2: bool,
        completeness: bool,
        key in proptest::option::of(0..40usize),
    ) {
        let p = 2 * half + 1;
        let x = motion(seed, n, 4);
        let examples: Vec<Frames> = lengths
            .iter()
            .enumerate()
            .map(|(index, &frames)| motion(seed + 1 + index as u64, frames, 4))
            .collect();
        let pool = Pool::new(&examples, p);
        prop_assume!(pool.patches > 0);
        let distance = if l2 { Distance::L2 } else { Distance::MeanSquare };
        let alpha = completeness.then_some(0.01);
        let bent = key.map(|key| (0..n).map(|t| t.abs_diff(key) < 3).collect::<Vec<bool>>());
        let bent = bent.unwrap_or_default();
        let found = Search::new(&pool, distance).nearest(&x, alpha, &bent);
        let apart = |i: usize, j: usize| -> f64 {
            let (example, first) = pool.origin(j);
            let rows = (0..p).flat_map(|k| {
                let (a, b) = (x.frame(i + k), examples[example].frame(first + k));
                a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2))
            });
            match distance {
                Distance::MeanSquare => rows.sum::<f64>() / (4 * p) as f64,
                Distance::L2 => rows.sum::<f64>().sqrt(),
            }
        };
        let patches = n - p + 1;
        let free = |i: &usize| bent.is_empty() || !bent[*i..i + p].contains(&true);
        let all_bent = !(0..patches).any(|i| free(&i));
        let counting = || (0..patches).filter(|i| all_bent || free(i));
        let scale = |j: usize| match alpha {
            Some(alpha) => {
                alpha + counting().map(|i| apart(i, j)).fold(f64::INFINITY, f64::min)
            }
            None => 1.0,
        };
        let scales: Vec<f64> = (0..pool.patches).map(scale).collect();
        for i in 0..patches {
            let row: Vec<f64> = (0..pool.patches).map(|j| apart(i, j) / scales[j]).collect();
            let least = row.iter().copied().fold(f64::INFINITY, f64::min);
            prop_assert!(row[found.nearest[i]] <= least * (1.0 + 1e-4) + 1e-6);
            prop_assert!((f64::from(found.distances[i]) - least).abs() <= 1e-4 * (1.0 + least));
        }
    }
}

proptest! {
    #[test]
    fn a_search_does_not_depend_on_the_one_before(
        seed in 0..1000u64,
        half in 0..4usize,
        n in 40..120usize,
        changed in proptest::collection::vec(0..40usize, 0..6),
        still: bool,
    ) {
        let p = 2 * half + 1;
        let mut example = motion(seed + 1, 30, 4);
        if still {
            (0..30).for_each(|t| example.frame_mut(t)[2] = 0.5);
        }
        let pool = Pool::new(&[example], p);
        let mut search = Search::new(&pool, Distance::MeanSquare);
        let mut x = motion(seed, n, 4);
        search.nearest(&x, Some(0.01), &[]);
        for (index, &t) in changed.iter().enumerate() {
            x.frame_mut(t)[index % 4] += 0.25;
        }
        for x in [x, motion(seed, n - 3, 4)] {
            let fresh = Search::new(&pool, Distance::MeanSquare).nearest(&x, Some(0.01), &[]);
            prop_assert_eq!(search.nearest(&x, Some(0.01), &[]), fresh);
        }
    }
}

#[test]
fn the_first_of_equally_near_patches_is_taken() {
    let example = Frames::new(1, [0.0, 1.0, 2.0].repeat(6));
    let pool = Pool::new(std::slice::from_ref(&example), 3);
    let found = Search::new(&pool, Distance::MeanSquare).nearest(&example, None, &[]);
    assert!(found.nearest.iter().all(|&patch| patch < 3), "{found:?}");
}

#[test]
fn threads_change_no_bit() {
    let example = motion(3, 300, 17);
    let settings = settings(11);
    let request = Request {
        examples: &[example],
        frames: 611,
        settings: &settings,
        groups: &[],
        constraints: &[],
    };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build()
            .unwrap()
            .install(|| synthesize(&request, 5).unwrap())
    };
    let one = on(1);
    for threads in [2, 3, 7] {
        let more = on(threads);
        assert_eq!(one.frames, more.frames);
        assert_eq!(one.origins, more.origins);
    }
}

#[test]
fn a_loop_is_continuous_at_its_seam() {
    let step = |frames: &Frames, from: usize, to: usize| {
        let pairs = frames.frame(from).iter().zip(frames.frame(to));
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
    };
    for seed in 0..6 {
        let seams = [Looping::Even, Looping::Halves, Looping::Off].map(|looping| {
            let settings = Settings {
                looping,
                ..settings(11)
            };
            let request = Request {
                examples: &[motion(2, 200, 5)],
                frames: 150,
                settings: &settings,
                groups: &[],
                constraints: &[],
            };
            let frames = synthesize(&request, seed).unwrap().frames;
            let largest = (1..150)
                .map(|t| step(&frames, t - 1, t))
                .fold(0.0, f32::max);
            step(&frames, 149, 0) / largest
        });
        assert!(
            seams[..2].iter().all(|seam| *seam <= 1.0),
            "seed {seed}: {seams:?}"
        );
        assert!(seams[2] > seams[0].max(seams[1]), "seed {seed}: {seams:?}");
    }
}

#[test]
fn a_loop_begins_where_it_is_smoothest() {
    let settings = Settings {
        looping: Looping::Even,
        ..settings(11)
    };
    let request = Request {
        examples: &[motion(2, 200, 5)],
        frames: 150,
        settings: &settings,
        groups: &[],
        constraints: &[],
    };
    let before = synthesize(&request, 0).unwrap();
    let mut turned = before.clone();
    turned.rotate_to_smoothest_seam();
    let steps = |frames: &Frames| -> Vec<f32> {
        let step = |t: usize| {
            let pairs = frames.frame(t).iter().zip(frames.frame((t + 1) % 150));
            pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
        };
        (0..150).map(step).collect()
    };
    let (old, new) = (steps(&before.frames), steps(&turned.frames));
    let mut sorted = new.clone();
    sorted.sort_by(f32::total_cmp);
    assert!(new[149] < old[149] && new[149] < sorted[75]);
    // Only the beginning of the loop changes.
    let first = (0..150).find(|&t| before.frames.frame(t) == turned.frames.frame(0));
    let first = first.unwrap();
    for t in 0..150 {
        let from = (first + t) % 150;
        assert_eq!(turned.frames.frame(t), before.frames.frame(from));
        assert_eq!(turned.origins[0][t], before.origins[0][from]);
    }
}

#[test]
fn seeds_differ_and_repeat() {
    let settings = settings(7);
    let request = Request {
        examples: &[motion(1, 120, 6)],
        frames: 240,
        settings: &settings,
        groups: &[],
        constraints: &[],
    };
    let of = |seed| synthesize(&request, seed).unwrap().frames;
    assert_eq!(of(0), of(0));
    assert_ne!(of(0), of(1));
}

#[test]
fn groups_are_matched_apart_and_shared_channels_averaged() {
    let settings = settings(5);
    let group = |name: &str, channels: &[usize]| Channels {
        name: name.to_string(),
        channels: channels.to_vec(),
    };
    let groups = [group("one", &[0, 1, 2]), group("two", &[2, 3])];
    let request = Request {
        examples: &[motion(1, 80, 4)],
        frames: 120,
        settings: &settings,
        groups: &groups,
        constraints: &[],
    };
    let new = synthesize(&request, 3).unwrap();
    assert_eq!(new.origins.len(), 2);
    assert_ne!(new.origins[0], new.origins[1]);
    let voted = [(3, vec![1.0; 6]), (2, vec![3.0; 4])];
    let voted = voted.map(|(channels, values)| Frames::new(channels, values));
    assert_eq!(
        merged(&groups, voted.to_vec(), 4).values(),
        [1.0, 1.0, 2.0, 3.0, 1.0, 1.0, 2.0, 3.0]
    );
}

#[test]
fn constrained_channels_come_out_as_they_went_in() {
    let settings = settings(5);
    let walk = motion(9, 90, 4);
    let constraints = [
        Constraint::Channels {
            channels: vec![1, 3],
            motion: walk.clone(),
        },
        Constraint::Keyframe {
            at: 40.5 / 90.0,
            channels: vec![0],
            source: Frames::new(1, vec![0.25; 3]),
            from: 1,
            frames: 90,
            reach: 5,
        },
    ];
    let request = Request {
        examples: &[motion(1, 80, 4)],
        frames: 90,
        settings: &settings,
        groups: &[],
        constraints: &constraints,
    };
    let new = synthesize(&request, 3).unwrap().frames;
    assert_eq!(new.columns(&[1, 3]), walk.columns(&[1, 3]));
    assert_eq!(new.frame(40)[0], 0.25);
}

#[test]
fn what_is_too_short_is_refused() {
    let settings = settings(11);
    let refused = |examples: &[Frames], frames| {
        let request = Request {
            examples,
            frames,
            settings: &settings,
            groups: &[],
            constraints: &[],
        };
        synthesize(&request, 0).unwrap_err().to_string()
    };
    let long = motion(0, 60, 2);
    let message = refused(&[long.clone(), motion(0, 10, 2)], 60);
    assert_eq!(
        message,
        "`patch_size` is 11 with 10 frames in example 2, allowed: at most the frames of each example"
    );
    let message = refused(&[long], 10);
    assert_eq!(message, "`length` is 10, allowed: 11 or more");
    assert!(refused(&[], 60).contains("`examples` is empty"));
}

#[test]
fn a_ratio_of_one_has_one_level() {
    let settings = Settings {
        coarse_ratio: CoarseRatio::Ratio(1.0),
        ..settings(5)
    };
    let request = Request {
        examples: &[motion(1, 60, 2)],
        frames: 90,
        settings: &settings,
        groups: &[],
        constraints: &[],
    };
    assert_eq!(request.levels().unwrap().synthesis.len(), 1);
    synthesize(&request, 0).unwrap();
}
