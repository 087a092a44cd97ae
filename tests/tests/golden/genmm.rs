//! Generative motion matching (GenMM): its parts, every step of seven runs, and the complete runs.

use std::path::PathBuf;

use kinegrad_matching::rotation6d;
use kinegrad_matching::{
    Axis, CoarseRatio, Distance, Frames, Looping, Matches, Pool, Preset, Request, Search, Settings,
    Start, displacements, pad_loop, places, pyramid_lengths, start, step, synthesize_from,
    unpad_loop, vote,
};
use kinegrad_motion::Quaternion;
use kinegrad_tests::golden::{Golden, compared};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// Absolute, for values in single precision. Distances divided by completeness are as large as 5,
/// and the stored ones are up to 2.9e-5 from float64: for them it is relative too.
const TOLERANCE: f64 = 1e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_pyramid_lengths("genmm/pyramid_lengths.json"),
        golden_resampling("genmm/pieces.safetensors"),
        golden_patch_distances("genmm/pieces.safetensors"),
        golden_voting("genmm/pieces.safetensors"),
        golden_wrapped_noise("genmm/pieces.safetensors"),
        golden_root_displacements("genmm/pieces.safetensors"),
        golden_rotations_of_six_numbers("genmm/pieces.safetensors"),
        golden_basic("genmm/basic.safetensors") => run,
        golden_sigma10("genmm/sigma10.safetensors") => run,
        golden_no_noise("genmm/no_noise.safetensors") => run,
        golden_no_alpha("genmm/no_alpha.safetensors") => run,
        golden_loop("genmm/loop.safetensors") => run,
        golden_two_examples("genmm/two_examples.safetensors") => run,
        golden_patch11("genmm/patch11.safetensors") => run,
    ]
}

/// A tensor `[1, channels, frames]` as frames.
fn frames(golden: &Golden, name: &str) -> Frames {
    let reference = golden.get(name);
    let [1, channels, n] = reference.shape[..] else {
        panic!("`{name}` has the shape {:?}", reference.shape)
    };
    let values = reference.f32s();
    let transposed = (0..n).flat_map(|t| (0..channels).map(move |c| (c, t)));
    let transposed = transposed.map(|(c, t)| values[c * n + t]);
    Frames::new(channels, transposed.collect())
}

/// Frames as the values of a tensor `[1, channels, frames]`.
fn tensor(frames: &Frames) -> Vec<f64> {
    let (n, channels) = (frames.frames(), frames.channels());
    let places = (0..channels).flat_map(|c| (0..n).map(move |t| (t, c)));
    places.map(|(t, c)| f64::from(frames.frame(t)[c])).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

fn indices_match(golden: &Golden, name: &str, matches: &Matches) {
    let found: Vec<f64> = matches.nearest.iter().map(|&patch| patch as f64).collect();
    golden.compare_exactly(name, &found);
}

fn golden_pyramid_lengths(path: PathBuf) {
    let text = std::fs::read_to_string(path).expect("readable");
    let cases: Vec<serde_json::Value> = serde_json::from_str(&text).expect("JSON");
    for case in &cases {
        let number = |key: &str| case[key].as_f64().expect("a number");
        let found = pyramid_lengths(
            number("final_len") as usize,
            number("coarse_ratio"),
            number("factor"),
        );
        assert_eq!(serde_json::json!(found), case["lengths"], "{case}");
        compared(found.len());
    }
}

fn golden_resampling(golden: Golden) {
    let x = frames(&golden, "x");
    for kind in ["half_pixel", "align_corners"] {
        let prefix = format!("interp_{kind}_");
        for length in golden.names_under(&prefix) {
            let to = length.parse().expect("a length");
            let found = match kind {
                "half_pixel" => x.resampled(to),
                _ => x.resampled_aligned(to),
            };
            golden.compare(&format!("{prefix}{length}"), &tensor(&found), TOLERANCE);
        }
    }
}

/// Patch length of the parts.
const P: usize = 5;

fn golden_patch_distances(golden: Golden) {
    let (x, y) = (frames(&golden, "x"), frames(&golden, "y"));
    let pool = Pool::new(std::slice::from_ref(&y), P);
    let mut search = Search::new(&pool, Distance::MeanSquare);
    let dist = golden.get("dist");
    let [rows, patches] = dist.shape[..] else {
        panic!("{:?}", dist.shape)
    };
    let row = |i: usize| &dist.values[i * patches..(i + 1) * patches];
    let plain = search.nearest(&x, None, &[]);
    indices_match(&golden, "nn_no_alpha", &plain);
    let least: Vec<f64> = (0..rows)
        .map(|i| row(i).iter().copied().fold(f64::INFINITY, f64::min))
        .collect();
    golden.compare_lists("dist", &wide(&plain.distances), &least, TOLERANCE);
    for alpha in golden.names_under("nn_alpha_") {
        let found = search.nearest(&x, Some(alpha.parse().expect("a number")), &[]);
        indices_match(&golden, &format!("nn_alpha_{alpha}"), &found);
        golden.compare(
            &format!("mindist_alpha_{alpha}"),
            &wide(&found.distances),
            TOLERANCE,
        );
        let smallest: Vec<f64> = (0..patches)
            .map(|j| (0..rows).map(|i| row(i)[j]).fold(f64::INFINITY, f64::min))
            .collect();
        golden.compare_lists("smallest", &wide(&found.smallest), &smallest, TOLERANCE);
    }
    let looped = search.nearest(&pad_loop(&x, P), Some(0.01), &[]);
    indices_match(&golden, "nn_loop_alpha_0.01", &looped);
}

fn golden_voting(golden: Golden) {
    let pool = Pool::new(&[frames(&golden, "y")], P);
    let plain = vote(&pool, &golden.get("nn_no_alpha").indices());
    golden.compare("blend", &tensor(&plain), TOLERANCE);
    let looped = vote(&pool, &golden.get("nn_loop_alpha_0.01").indices());
    golden.compare("blend_loop", &tensor(&unpad_loop(&looped, P)), TOLERANCE);
}

fn golden_wrapped_noise(golden: Golden) {
    let noise = Frames::new(1, golden.get("fmod_in").f32s());
    let still = Frames::zeros(noise.frames(), 1);
    let started = start(&[still], &noise, 1.0, Start::Examples);
    golden.compare("fmod_out", &wide(started.values()), TOLERANCE);
}

fn golden_root_displacements(golden: Golden) {
    let motion = frames(&golden, "velo_in");
    let columns = |frames: &Frames| -> Vec<[f64; 3]> {
        let last = frames.channels() - 3;
        let frame = |t| [0, 1, 2].map(|axis| f64::from(frames.frame(t)[last + axis]));
        (0..frames.frames()).map(frame).collect()
    };
    let path = columns(&motion);
    let flat = |vectors: &[[f64; 3]]| vectors.as_flattened().to_vec();
    for (kept, name) in [
        (Some(Axis::X), "velo_keep_x"),
        (Some(Axis::Y), "velo_keep_y"),
        (Some(Axis::Z), "velo_keep_z"),
        (None, "velo_all"),
    ] {
        let expected = columns(&frames(&golden, name));
        let found = displacements(&path, kept);
        golden.compare_lists(name, &flat(&found), &flat(&expected), TOLERANCE);
        let back = columns(&frames(&golden, &format!("{name}_back")));
        let found = places(&expected, path[0], kept);
        golden.compare_lists(name, &flat(&found), &flat(&back), TOLERANCE);
    }
}

fn golden_rotations_of_six_numbers(golden: Golden) {
    let quaternions = golden.get("quat_wxyz").vectors::<4>();
    let to = |[w, x, y, z]: [f64; 4]| Quaternion::new(w, x, y, z);
    let six: Vec<f64> = quaternions
        .iter()
        .flat_map(|&quaternion| rotation6d::from_quaternion(to(quaternion)))
        .collect();
    golden.compare("repr6d", &six, TOLERANCE);
    let noisy = golden.get("repr6d_noisy").vectors::<6>();
    let back = golden.get("repr6d_noisy_quat").vectors::<4>();
    let apart: Vec<f64> = noisy
        .iter()
        .zip(&back)
        .map(|(&six, &quaternion)| {
            rotation6d::to_quaternion(six)
                .dot(to(quaternion).normalised())
                .abs()
        })
        .collect();
    golden.compare_lists(
        "repr6d_noisy_quat",
        &apart,
        &vec![1.0; back.len()],
        TOLERANCE,
    );
}

/// A run: each step from its stored input, then the complete run from the stored noise.
fn run(golden: Golden) {
    let params = golden.get("params").values;
    let [p, alpha, sigma, pyr_factor, num_steps, looping] = params[..] else {
        panic!("{} parameters", params.len())
    };
    let alpha = (alpha >= 0.0).then_some(alpha);
    let examples: Vec<Frames> = (0..)
        .map(|index| format!("example_{index}"))
        .take_while(|name| golden.has(name))
        .map(|name| frames(&golden, &name))
        .collect();
    let lengths = golden.get("synth_lengths").indices();
    let coarsest = golden.get("example_lengths");
    let longest = examples.iter().map(Frames::frames).max().expect("one");
    let of_longest = examples
        .iter()
        .position(|example| example.frames() == longest)
        .expect("one");
    let coarse = coarsest.part(of_longest).values[0];
    let settings = Settings {
        patch_size: p as usize,
        alpha,
        sigma,
        pyr_factor,
        num_steps: num_steps as usize,
        coarse_ratio: CoarseRatio::Patches((coarse / p).round()),
        looping: match looping > 0.0 {
            true => Looping::Halves,
            false => Looping::Off,
        },
        ..Settings::of(Preset::Published)
    };
    let request = Request {
        examples: &examples,
        frames: *lengths.last().expect("a level"),
        settings: &settings,
        groups: &[],
        constraints: &[],
    };
    let levels = request.levels().expect("valid");
    assert_eq!(levels.synthesis, lengths);
    assert_eq!(levels.examples.concat(), coarsest.indices());

    let noise = match golden.has("noise") {
        true => frames(&golden, "noise"),
        false => Frames::zeros(lengths[0], examples[0].channels()),
    };
    for level in 0..levels.synthesis.len() {
        let at = |name: &str| format!("level_{level}_{name}");
        let own: Vec<Frames> = (0..examples.len())
            .map(|index| examples[index].resampled(levels.examples[index][level]))
            .collect();
        for (index, example) in own.iter().enumerate() {
            golden.compare(
                &at(&format!("example_{index}")),
                &tensor(example),
                TOLERANCE,
            );
        }
        if level == 0 {
            let started = start(&own, &noise, sigma, Start::Examples);
            golden.compare(&at("input"), &tensor(&started), TOLERANCE);
        }
        let pool = Pool::new(&own, settings.patch_size);
        let mut search = Search::new(&pool, Distance::MeanSquare);
        let mut current = frames(&golden, &at("input"));
        for number in 0..settings.num_steps {
            let of = |name: &str| at(&format!("step_{number}_{name}"));
            let (next, matches) = step(&current, &pool, &mut search, alpha, settings.looping, &[]);
            indices_match(&golden, &of("nn"), &matches);
            let distances = golden.get(&of("mindist"));
            distances.assert_within_f32(&of("mindist"), &matches.distances, TOLERANCE, TOLERANCE);
            if alpha.is_some() {
                golden.compare(&of("colmin"), &wide(&matches.smallest), TOLERANCE);
            }
            golden.compare(&of("output"), &tensor(&next), TOLERANCE);
            current = frames(&golden, &of("output"));
        }
    }
    let whole = synthesize_from(&request, &noise).expect("valid");
    golden.compare("final", &tensor(&whole.frames), TOLERANCE);
}
