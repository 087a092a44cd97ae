//! Paths on the ground: arc length, splines, features of frames, smoothing, warping, and foot
//! contacts.

use kinegrad_motion::feet::{StepRule, steps};
use kinegrad_motion::humanml::{Joints, Root, Skeleton};
use kinegrad_motion::path::{
    ArcLengthMode, CatmullRom, Course, Edges, HeadingMode, Parameterization, PathFeatures,
    PathLoss, PathLossConfig, Polyline, Warp, headings_of, placed, root_channels, savgol,
    savgol_weights, slide, unwrapped, wrapped,
};
use kinegrad_tests::golden::Golden;
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_arclength("paths/arclength.safetensors"),
        golden_catmull_rom("paths/catmull_rom.safetensors"),
        golden_path_features("paths/path_features.safetensors"),
        golden_savgol("paths/savgol.safetensors"),
        golden_warp("paths/warp.safetensors"),
        golden_override("paths/override.safetensors"),
        golden_path_guidance("paths/path_guidance.safetensors"),
        golden_foot_contact("paths/foot_contact.safetensors"),
    ]
}

/// For files in single precision.
const TOLERANCE: f64 = 1e-5;

fn points(golden: &Golden, name: &str) -> Vec<[f64; 2]> {
    let reference = golden.get(name);
    let (points, rest) = reference.values.as_chunks::<2>();
    assert!(rest.is_empty(), "`{name}` holds points");
    points.to_vec()
}

/// Names of the inputs `in.NAME.` + `what`.
fn cases(golden: &Golden, what: &str) -> Vec<String> {
    let ending = format!(".{what}");
    let names = golden.names_under("in.").into_iter();
    let names = names.filter_map(|name| name.strip_suffix(&ending).map(str::to_owned));
    let names: Vec<String> = names.collect();
    assert!(!names.is_empty(), "inputs `in.*.{what}`");
    names
}

fn golden_arclength(golden: Golden) {
    let shares = golden.get("in.u").values;
    for case in cases(&golden, "points") {
        let path = Polyline::new(points(&golden, &format!("in.{case}.points"))).expect("a path");
        let out = |what: &str| format!("out.{case}.{what}");
        golden.compare(&out("cumlen"), path.cumulative(), TOLERANCE);
        golden.compare(&out("total"), &[path.length()], TOLERANCE);
        let places = shares.iter().map(|share| path.at(*share));
        let places: Vec<_> = places.collect();
        let all = |of: fn(&kinegrad_motion::path::PathPoint) -> [f64; 2]| {
            places.iter().flat_map(of).collect::<Vec<f64>>()
        };
        golden.compare(&out("point_at_u"), &all(|place| place.point), TOLERANCE);
        golden.compare(&out("tangent_at_u"), &all(|place| place.tangent), TOLERANCE);
        let headings: Vec<f64> = places.iter().map(|place| place.heading()).collect();
        golden.compare(&out("heading_at_u"), &headings, TOLERANCE);
        golden.compare(
            &out("resampled_32"),
            path.resampled(32).as_flattened(),
            TOLERANCE,
        );
    }
}

fn golden_catmull_rom(golden: Golden) {
    let taus = golden.get("in.tau").values;
    for case in cases(&golden, "points") {
        let given = points(&golden, &format!("in.{case}.points"));
        for (name, parameterization) in [
            ("uniform", Parameterization::Uniform),
            ("centripetal", Parameterization::Centripetal),
            ("chordal", Parameterization::Chordal),
        ] {
            let spline = CatmullRom::new(&given, parameterization, false).expect("points");
            let out = |what: &str| format!("out.{case}.{name}.{what}");
            let places = (0..spline.segments())
                .flat_map(|segment| taus.iter().map(move |tau| (segment, *tau)));
            let (values, slopes): (Vec<[f64; 2]>, Vec<[f64; 2]>) =
                places.map(|(segment, tau)| spline.at(segment, tau)).unzip();
            golden.compare(&out("points"), values.as_flattened(), TOLERANCE);
            golden.compare(&out("dpoints_dtau"), slopes.as_flattened(), 1e-4);
            let line = spline.polyline();
            golden.compare(&out("length_64"), &[line.length()], TOLERANCE);
            golden.compare(
                &out("resampled_50"),
                line.resampled(50).as_flattened(),
                TOLERANCE,
            );
        }
    }
}

fn golden_path_features(golden: Golden) {
    for case in cases(&golden, "xz") {
        let track = points(&golden, &format!("in.{case}.xz"));
        let features = PathFeatures::of(&track);
        let out = |what: &str| format!("out.{case}.{what}");
        let columns = |from: usize, to: usize| -> Vec<f64> {
            let row = |frame: &PathFeatures| {
                let ([x, z], [dx, dz]) = (frame.position, frame.step);
                [x, z, dx, dz, frame.heading, frame.curvature]
            };
            features
                .iter()
                .flat_map(|frame| row(frame)[from..to].to_vec())
                .collect()
        };
        let expected = golden.get(&out("features")).values;
        let (first, last): (Vec<f64>, Vec<f64>) = (
            expected
                .chunks(6)
                .flat_map(|row| row[..5].to_vec())
                .collect(),
            expected.chunks(6).map(|row| row[5]).collect(),
        );
        golden.compare_lists(&out("features"), &columns(0, 5), &first, TOLERANCE);
        golden.compare_lists(&out("features"), &columns(5, 6), &last, 1e-4);
        // Undefined for a path that rests for a while.
        if !golden.has(&out("heading_unwrapped")) {
            continue;
        }
        let headings = headings_of(&track);
        golden.compare(&out("heading_unwrapped"), &unwrapped(&headings), TOLERANCE);
        let parts = headings.iter().flat_map(|heading| {
            let (sin, cos) = heading.sin_cos();
            [sin, cos]
        });
        golden.compare(
            &out("sincos_heading"),
            &parts.collect::<Vec<_>>(),
            TOLERANCE,
        );
    }
}

fn golden_savgol(golden: Golden) {
    let weights = savgol_weights(11, 3, 0.0, 0);
    golden.compare("out.coeffs_11_3", &weights, 1e-12);
    // Those of the reference are those of a convolution, which runs through them backwards.
    let mut slopes = savgol_weights(11, 3, 0.0, 1);
    slopes.reverse();
    golden.compare("out.coeffs_11_3_deriv1", &slopes, 1e-12);
    let heading = golden.get("in.heading_wrapped").values;
    let turning = unwrapped(&heading);
    golden.compare("out.heading_unwrapped", &turning, TOLERANCE);
    for (name, edges) in [
        ("interp", Edges::Fitted),
        ("nearest", Edges::Nearest),
        ("mirror", Edges::Mirror),
    ] {
        let smoothed = savgol(&turning, 11, 3, edges);
        golden.compare(&format!("out.smoothed_{name}"), &smoothed, TOLERANCE);
    }
    let smoothed = savgol(&turning, 11, 3, Edges::Fitted);
    let again: Vec<f64> = smoothed.iter().map(|heading| wrapped(*heading)).collect();
    golden.compare("out.smoothed_interp_rewrapped", &again, TOLERANCE);
    let bad = savgol(&heading, 11, 3, Edges::Fitted);
    golden.compare("out.filter_on_wrapped_bad", &bad, TOLERANCE);
    let short = golden.names_under("in.").into_iter();
    for name in short.filter(|name| name.starts_with("short") || name == "constant") {
        let values = golden.get(&format!("in.{name}")).values;
        let smoothed = savgol(&values, 11, 3, Edges::Fitted);
        golden.compare(&format!("out.{name}"), &smoothed, TOLERANCE);
    }
}

/// Joints from a tensor `[J, 3, frames]`.
fn joints(golden: &Golden, name: &str) -> Joints {
    let reference = golden.get(name);
    let [count, 3, frames] = reference.shape[..] else {
        panic!("`{name}` has the shape {:?}", reference.shape)
    };
    let value =
        |joint: usize, axis: usize, t: usize| reference.values[(joint * 3 + axis) * frames + t];
    let places = (0..frames).flat_map(|t| (0..count).map(move |joint| (t, joint)));
    let places = places.map(|(t, joint)| [0, 1, 2].map(|axis| value(joint, axis, t)));
    Joints::new(places.collect(), count).expect("finite joints")
}

/// As a tensor `[J, 3, frames]`.
fn tensor(joints: &Joints) -> Vec<f64> {
    let places = (0..joints.joints()).flat_map(|joint| {
        (0..3).flat_map(move |axis| (0..joints.frames()).map(move |t| (t, joint, axis)))
    });
    places
        .map(|(t, joint, axis)| joints.frame(t)[joint][axis])
        .collect()
}

fn golden_warp(golden: Golden) {
    let skeleton = Skeleton::humanml3d();
    let clip = joints(&golden, "in.joints");
    for case in cases(&golden, "points") {
        let path = Polyline::new(points(&golden, &format!("in.{case}.points"))).expect("a path");
        let out = |what: &str| format!("out.{case}.{what}");
        let track: Vec<[f64; 2]> = clip.track(0).iter().map(|[x, _, z]| [*x, *z]).collect();
        let course = Course::of_motion(&path, &track, ArcLengthMode::Stretch);
        golden.compare(&out("target"), course.points.as_flattened(), TOLERANCE);
        let length = path.length().max(f64::MIN_POSITIVE);
        let shares: Vec<f64> = course.metres.iter().map(|metres| metres / length).collect();
        if path.length() > 0.0 {
            golden.compare(&out("u"), &shares, TOLERANCE);
        }
        for (name, turning, smooth) in [
            ("face", HeadingMode::Face, false),
            ("relative", HeadingMode::Relative, false),
            ("relative_smooth", HeadingMode::Relative, true),
        ] {
            if !golden.has(&out(&format!("{name}.delta"))) {
                continue;
            }
            let warp = Warp {
                turning,
                smooth,
                ..Warp::default()
            };
            let warped = warp
                .apply(&clip, &skeleton, &path)
                .expect("a body of 22 joints");
            let expected = golden.get(&out(&format!("{name}.delta"))).values;
            // Whole turns are ignored.
            let turned = warped.turned.iter().zip(&expected);
            let turned = turned.map(|(found, expected)| expected + wrapped(found - expected));
            let turned: Vec<f64> = turned.collect();
            golden.compare(&out(&format!("{name}.delta")), &turned, 1e-4);
            let name = out(&format!("{name}.joints"));
            if golden.has(&name) {
                golden.compare(&name, &tensor(&warped.joints), 1e-4);
            }
            golden.compare(&out("speed_ratio"), &[warped.speed_ratio], TOLERANCE);
        }
    }
    let standing = joints(&golden, "in.standing.joints");
    let line = Polyline::new(points(&golden, "in.line.points")).expect("a path");
    // Its root does not move, so it has no heading of its own.
    let face = Warp {
        turning: HeadingMode::Face,
        ..Warp::default()
    };
    let warped = face.apply(&standing, &skeleton, &line).expect("a body");
    let shares = warped
        .course
        .metres
        .iter()
        .map(|metres| metres / line.length());
    golden.compare(
        "out.standing_on_line.u",
        &shares.collect::<Vec<_>>(),
        TOLERANCE,
    );
    let name = "out.standing_on_line.joints";
    golden.compare(name, &tensor(&warped.joints), 1e-4);
}

/// One sample of a tensor `[batch, channels, 1, frames]`, its channels one after the other.
struct Rows {
    values: Vec<f64>,
    frames: usize,
}

impl Rows {
    fn of(golden: &Golden, name: &str) -> Vec<Self> {
        let reference = golden.get(name);
        let [batch, channels, 1, frames] = reference.shape[..] else {
            panic!("`{name}` has the shape {:?}", reference.shape)
        };
        let samples = reference.values.chunks(channels * frames);
        assert_eq!(samples.len(), batch);
        samples
            .map(|values| Self {
                values: values.to_vec(),
                frames,
            })
            .collect()
    }

    fn channel(&mut self, index: usize) -> &mut [f64] {
        &mut self.values[index * self.frames..(index + 1) * self.frames]
    }

    fn concat(rows: Vec<Self>) -> Vec<f64> {
        rows.into_iter().flat_map(|rows| rows.values).collect()
    }
}

fn golden_override(golden: Golden) {
    let track = points(&golden, "in.path_xz");
    let headings = golden.get("in.path_heading").values;
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let normalized = |channel: usize, value: f64| (value - mean[channel]) / std[channel];
    // The complete skeleton, moved, as joints; each sample of `[batch, J, 3, frames]` separately.
    let sample = golden.get("in.joint_sample");
    let [batch, count, 3, frames] = sample.shape[..] else {
        panic!("{:?}", sample.shape)
    };
    let mut moved = Vec::new();
    for values in sample.values.chunks(sample.values.len() / batch) {
        let place =
            |t: usize, joint: usize| [0, 1, 2].map(|axis| values[(joint * 3 + axis) * frames + t]);
        let places = (0..frames).flat_map(|t| (0..count).map(move |joint| (t, joint)));
        let places = places.map(|(t, joint)| place(t, joint)).collect();
        let clip = Joints::new(places, count).expect("finite");
        let rigid = placed(&clip, &track, &vec![0.0; frames]).expect("a point a frame");
        moved.extend(tensor(&rigid));
    }
    golden.compare("out.joint_override_rigid", &moved, TOLERANCE);
    // Absolute roots, clean and noised.
    let absolute = root_channels(&track, &headings, Root::Absolute);
    let clean = |values: &mut Rows| {
        for channel in 1..3 {
            for (value, row) in values.channel(channel).iter_mut().zip(&absolute) {
                *value = normalized(channel, row[channel]);
            }
        }
    };
    let mut samples = Rows::of(&golden, "in.feature_sample");
    samples.iter_mut().for_each(clean);
    golden.compare("out.abs_override_clean", &Rows::concat(samples), TOLERANCE);
    // Relative roots; the path is moved to the origin of the features.
    let relative = root_channels(&track, &headings, Root::Relative);
    golden.compare("out.rel_root_features", relative.as_flattened(), TOLERANCE);
    let with_heights: Vec<[f64; 4]> = relative.iter().map(|[a, x, z]| [*a, *x, *z, 0.0]).collect();
    let positions = Root::Relative.positions(&with_heights);
    let ground: Vec<f64> = positions.iter().flat_map(|[x, _, z]| [*x, *z]).collect();
    golden.compare("out.rel_canonical_xz", &ground, TOLERANCE);
    let seen = Root::Relative.half_angles(&with_heights);
    let expected = golden.get("out.rel_canonical_heading").values;
    let seen = seen
        .iter()
        .zip(&expected)
        .map(|(a, expected)| expected + wrapped(-2.0 * a - expected));
    golden.compare(
        "out.rel_canonical_heading",
        &seen.collect::<Vec<_>>(),
        TOLERANCE,
    );
    let mut samples = Rows::of(&golden, "in.feature_sample");
    for sample in &mut samples {
        for channel in 0..3 {
            for (value, row) in sample.channel(channel).iter_mut().zip(&relative) {
                *value = normalized(channel, row[channel]);
            }
        }
    }
    golden.compare("out.rel_override_clean", &Rows::concat(samples), TOLERANCE);
}

fn golden_path_guidance(golden: Golden) {
    let track = points(&golden, "in.path_xz");
    let headings = golden.get("in.path_heading").values;
    let number = |name: &str| golden.get(name).values[0];
    let heading = number("in.lambda_heading");
    let tolerance = number("in.tolerance");
    for (prefix, root, eta) in [
        ("abs", Root::Absolute, number("in.eta")),
        ("rel", Root::Relative, number("in.eta_rel")),
    ] {
        let mean = golden.get(&format!("in.{prefix}_mean")).values;
        let std = golden.get(&format!("in.{prefix}_std")).values;
        for (name, config) in [
            ("mse", PathLossConfig::default()),
            (
                "heading",
                PathLossConfig {
                    heading,
                    ..PathLossConfig::default()
                },
            ),
            (
                "tol",
                PathLossConfig {
                    tolerance,
                    ..PathLossConfig::default()
                },
            ),
        ] {
            let loss = PathLoss {
                config,
                points: track.clone(),
                headings: headings.clone(),
            };
            // The gradient with respect to normalised channels.
            let evaluate = |sample: &mut Rows| -> (f64, Vec<f64>) {
                let channels: Vec<Vec<f64>> = (0..3)
                    .map(|c| {
                        sample
                            .channel(c)
                            .iter()
                            .map(|x| x * std[c] + mean[c])
                            .collect()
                    })
                    .collect();
                let rows: Vec<[f64; 3]> = (0..sample.frames)
                    .map(|t| [0, 1, 2].map(|c| channels[c][t]))
                    .collect();
                let (value, gradient) = loss.evaluate(root, &rows);
                let mut by_channel = vec![0.0; sample.values.len()];
                for (t, row) in gradient.iter().enumerate() {
                    for c in 0..3 {
                        by_channel[c * sample.frames + t] = row[c] * std[c];
                    }
                }
                (value, by_channel)
            };
            let mut samples = Rows::of(&golden, "in.x");
            let mut losses = Vec::new();
            for step in 0..4 {
                let (values, gradients): (Vec<f64>, Vec<Vec<f64>>) =
                    samples.iter_mut().map(evaluate).unzip();
                losses.extend(values);
                if step == 0 {
                    golden.compare_relative(
                        &format!("grad.{prefix}.{name}.x"),
                        &gradients.concat(),
                        1e-4,
                    );
                }
                for (sample, gradient) in samples.iter_mut().zip(gradients) {
                    for (x, g) in sample.values.iter_mut().zip(gradient) {
                        *x -= eta * g;
                    }
                }
                if step == 0 {
                    let x = samples.iter().flat_map(|sample| sample.values.clone());
                    let x: Vec<f64> = x.collect();
                    golden.compare_relative(&format!("out.{prefix}.{name}.x_step1"), &x, 1e-4);
                }
            }
            let after = if root == Root::Relative { 1e-3 } else { 1e-4 };
            golden.compare_relative(&format!("out.{prefix}.{name}.losses"), &losses, after);
            let x = Rows::concat(samples);
            golden.compare_relative(&format!("out.{prefix}.{name}.x_step4"), &x, after);
        }
    }
}

fn golden_foot_contact(golden: Golden) {
    let reference = golden.get("in.joints");
    let [frames, count, 3] = reference.shape[..] else {
        panic!("{:?}", reference.shape)
    };
    let (places, _) = reference.values.as_chunks::<3>();
    let clip = Joints::new(places.to_vec(), count).expect("finite joints");
    let floor = places
        .iter()
        .map(|place| place[1])
        .fold(f64::INFINITY, f64::min);
    // Ankle and toes of the left foot, then of the right.
    let feet = [7, 10, 8, 11];
    let by_frame = |columns: Vec<Vec<f64>>| -> Vec<f64> {
        let rows = (0..frames).flat_map(|t| (0..columns.len()).map(move |foot| (t, foot)));
        rows.map(|(t, foot)| columns[foot][t]).collect()
    };
    for (name, rule) in [
        ("height_speed", StepRule::LOW_AND_SLOW),
        (
            "vertical_horizontal",
            StepRule::VerticalAndHorizontal {
                vertical: 0.02,
                horizontal: 0.03,
            },
        ),
        ("squared_0p002", StepRule::SquaredStep(0.002)),
        ("speed_0p01", StepRule::Step(0.01)),
    ] {
        let flags = feet.map(|foot| {
            let flags = rule.contacts(&clip.track(foot), floor).into_iter();
            flags.map(|stands| f64::from(u8::from(stands))).collect()
        });
        golden.compare_exactly(&format!("out.contact_{name}"), &by_frame(flags.to_vec()));
    }
    let heights = feet.map(|foot| clip.track(foot).iter().map(|p| p[1] - floor).collect());
    golden.compare("out.height", &by_frame(heights.to_vec()), TOLERANCE);
    let speeds = feet.map(|foot| {
        let lengths = steps(&clip.track(foot)).into_iter();
        lengths.map(|[x, y, z]| x.hypot(y).hypot(z)).collect()
    });
    golden.compare("out.speed_per_frame", &by_frame(speeds.to_vec()), TOLERANCE);
    golden.compare("out.slide_per_frame", &[slide(&clip, &feet)], TOLERANCE);
}
