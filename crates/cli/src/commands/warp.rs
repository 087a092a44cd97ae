//! `kinegrad warp`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::Digest;
use kinegrad_data::file::read_text;
use kinegrad_motion::feet::{ContactRule, lock_joints};
use kinegrad_motion::humanml::{Extraction, Features, Joints, Skeleton};
use kinegrad_motion::metrics::{mean_jerk, skating_ratio};
use kinegrad_motion::path::{ArcLengthMode, PathPlan, PathReport, Warp};
use kinegrad_report::table;
use kinegrad_train::{Error, Systems};
use serde::Serialize;

use crate::args::WarpArguments;
use crate::io::{Content, MotionArray, bvh_file, must_be_new, stem, write_all};
use crate::output::unusable;
use crate::{folder, interrupt, output};

/// Speed ratios of a stretched motion that cause no warning.
const USUAL: std::ops::RangeInclusive<f64> = 0.67..=1.5;

/// Largest missing leg length that causes no warning, meters.
const LEGS_SHORT: f64 = 0.02;

/// The record of a warp.
#[derive(Serialize)]
struct Record {
    kinegrad: &'static str,
    motion: PathBuf,
    path: PathBuf,
    path_sha256: String,
    path_content: PathPlan,
    warp: Warp,
    /// `None` without `--lock-feet`.
    #[serde(skip_serializing_if = "Option::is_none")]
    feet: Option<Feet>,
    frames: usize,
    fps: f64,
    /// Length of the path, meters.
    path_length: f64,
    /// Ratio of the root's speed after and before; 0 for a motion that stood.
    speed_ratio: f64,
    before: Quality,
    after: PathReport,
}

/// Locked feet.
#[derive(Serialize)]
struct Feet {
    /// Share of the input's frames in which a foot stands.
    in_contact: f64,
    /// Mean speed of standing feet on the path before and after, meters per second.
    slid_before: f64,
    slide_after: f64,
    /// Largest distance of a foot from its contact position, meters.
    legs_short: f64,
}

/// Quality measures of a motion.
#[derive(Serialize)]
struct Quality {
    foot_skating: Option<f64>,
    jerk: Option<f64>,
}

/// Moves a motion onto a path.
pub fn run(systems: Systems<'_>, arguments: WarpArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let outputs = outputs(&arguments)?;
    let (text, plan) = read_path(&arguments)?;
    let (joints, skeleton) = read_motion(systems, &arguments.motion)?;
    let path = plan.polyline().map_err(unusable)?;
    let warp = Warp {
        along: arguments.along,
        turning: arguments.heading,
        smooth: !arguments.sharp,
        least_speed: match arguments.sharp {
            true => 0.0,
            false => Warp::STANDING,
        },
    };
    let warped = warp.apply(&joints, &skeleton, &path).map_err(unusable)?;
    let frames = warped.course.frames();
    if frames < 2 {
        let message = format!(
            "the path is {:.3} m long: the motion leaves it after its first frame",
            path.length()
        );
        let hint = "give a longer path, or `--along stretch`";
        return Err(Error::usage(message, hint));
    }
    let own = joints.as_slice()[..frames * joints.joints()].to_vec();
    let own = Joints::new(own, joints.joints())?;
    let lock = || {
        let (rule, floor) = (ContactRule::default(), floor_of(&own));
        lock_joints(&warped.joints, &own, &skeleton, &rule, floor)
    };
    let locked = arguments.lock_feet.then(lock).transpose()?;
    let feet = locked.as_ref().map(|locked| Feet {
        in_contact: locked.in_contact,
        slid_before: locked.before,
        slide_after: locked.after,
        legs_short: locked.missed,
    });
    let moved = locked.map_or(warped.joints, |locked| locked.joints);
    let extraction = Extraction {
        rescale: false,
        ..Extraction::default()
    };
    let features = extraction.features_of_all_frames(&skeleton, &moved)?;
    let record = Record {
        kinegrad: env!("CARGO_PKG_VERSION"),
        motion: arguments.motion.clone(),
        path: arguments.path.clone(),
        path_sha256: Digest::of(text.as_bytes()).to_string(),
        warp,
        feet,
        frames,
        fps: skeleton.description().fps,
        path_length: path.length(),
        speed_ratio: warped.speed_ratio,
        before: Quality::of(&own, &skeleton),
        after: PathReport::of(&moved, &skeleton, &path, &warped.course)?,
        path_content: plan,
    };
    for path in &outputs {
        folder::must_be_writable(path)?;
    }
    interrupt::not_during(|| write(&moved, &features, &skeleton, &record, &outputs))?;
    match arguments.json {
        true => output::json(&record),
        false => {
            for path in &outputs {
                say!("{}", path.display());
            }
            record.summarize();
        }
    }
    record.warn(joints.frames(), arguments.along);
    Ok(ExitCode::SUCCESS)
}

/// Output files: joints, features, BVH and record.
fn outputs(arguments: &WarpArguments) -> Result<[PathBuf; 4], Error> {
    let stem = stem(&arguments.out)?;
    let outputs = [".npy", ".features.npy", ".bvh", ".json"];
    let outputs = outputs.map(|ending| PathBuf::from(format!("{stem}{ending}")));
    let read = [arguments.motion.clone(), arguments.path.clone()];
    must_be_new(&outputs, &read, arguments.overwrite, "--out")?;
    Ok(outputs)
}

/// The text of the path's file, and the path.
fn read_path(arguments: &WarpArguments) -> Result<(String, PathPlan), Error> {
    let file = arguments.path.display().to_string();
    let hint = "docs/paths.md describes paths";
    let refused = |message: String| Error::usage(message, hint);
    let text = read_text(&arguments.path).map_err(|error| refused(format!("{file}: {error}")))?;
    let plan = PathPlan::read(&text, &file, arguments.metres_per_unit);
    let plan = plan.map_err(|error| refused(error.to_string()))?;
    if plan.speed.is_some() {
        tell!(
            "note: {file}: `speed` is ignored: it is for generated motion, and here `--along` sets the \
             speed"
        );
    }
    Ok((text, plan))
}

/// The joints of a motion and their skeleton.
fn read_motion(systems: Systems<'_>, path: &Path) -> Result<(Joints, Skeleton), Error> {
    let (joints, skeleton) = MotionArray::read(systems, path)?.body()?;
    if joints.frames() < 2 {
        let message = format!("{} has a single frame", path.display());
        return Err(Error::usage(message, "give a motion of two frames or more"));
    }
    Ok((joints, skeleton))
}

fn write(
    joints: &Joints,
    features: &Features,
    skeleton: &Skeleton,
    record: &Record,
    outputs: &[PathBuf; 4],
) -> Result<(), Error> {
    let bvh = bvh_file(&outputs[2], joints, skeleton, false)?;
    let record = serde_json::to_string_pretty(record).expect("plain data") + "\n";
    let contents = [
        Content::Array {
            shape: vec![joints.frames(), joints.joints(), 3],
            values: &joints.to_f32(),
        },
        Content::features(features),
        Content::Text(bvh.to_text()),
        Content::Text(record),
    ];
    let files: Vec<_> = outputs.iter().cloned().zip(contents).collect();
    write_all(&files)
}

impl Quality {
    fn of(joints: &Joints, skeleton: &Skeleton) -> Self {
        let feet = skeleton.contact_joints();
        let fps = skeleton.description().fps;
        Self {
            foot_skating: skating_ratio(joints, fps, &[feet[1], feet[3]]),
            jerk: mean_jerk(joints, fps),
        }
    }
}

/// The floor of a motion: y = 0, or the lowest joint if all joints are higher.
fn floor_of(joints: &Joints) -> f64 {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    heights.fold(f64::INFINITY, f64::min).max(0.0)
}

impl Record {
    fn summarize(&self) {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let row = |name: &str, before: String, after: Option<f64>, digits| {
            [name.to_owned(), before, number(after, digits)]
        };
        let (before, after) = (&self.before, &self.after);
        let skating = number(before.foot_skating, 3);
        let (heading, distance) = (after.heading_error, Some(after.largest_distance));
        let rows = [
            row("foot skating", skating, after.foot_skating, 3),
            row("jerk, m/s^3", number(before.jerk, 0), after.jerk, 0),
            row("heading from the path, degrees", "".into(), heading, 1),
            row("root from the path, m", "".into(), distance, 6),
        ];
        tell!("{}", table(["", "before", "after"], rows));
    }

    /// Prints notes and warnings.
    fn warn(&self, frames: usize, along: ArcLengthMode) {
        if self.frames < frames {
            tell!(
                "note: the path ends after {} of {frames} frames, at {:.2} m",
                self.frames,
                self.path_length
            );
        }
        match self.speed_ratio {
            0.0 if along == ArcLengthMode::Own => {}
            0.0 => tell!("warning: the motion stands still, so it slides along the path"),
            ratio if !USUAL.contains(&ratio) => tell!(
                "warning: the root is {ratio:.2} times as fast as before, so feet slide: give a path of \
                 the motion's length ({:.2} m), or `--along own`",
                self.path_length / ratio
            ),
            _ => {}
        }
        let Some(feet) = &self.feet else { return };
        if feet.in_contact == 0.0 {
            tell!("warning: `--lock-feet` had no effect: no foot stands in this motion");
        }
        if feet.legs_short > LEGS_SHORT {
            tell!(
                "warning: legs are up to {:.2} m too short to keep their contacts",
                feet.legs_short
            );
        }
    }
}
