//! `kinegrad warp`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::Digest;
use kinegrad_data::file::read_text;
use kinegrad_motion::feet::{ContactRule, lock_joints_above};
use kinegrad_motion::humanml::{Extraction, Features, Joints, Skeleton};
use kinegrad_motion::metrics::{mean_jerk, skating_ratio};
use kinegrad_motion::path::{ArcLengthMode, PathPlan, PathReport, Warp};
use kinegrad_report::table;
use kinegrad_train::Error;
use kinegrad_train::systems::Systems;
use serde::Serialize;

use crate::args::WarpArguments;
use crate::io::{Content, MotionArray, bvh_file, must_be_new, stem, write_all};
use crate::output::unusable;
use crate::{folder, interrupt, output};

/// Times its own speed beyond which a motion that is stretched is doubted.
const USUAL: std::ops::RangeInclusive<f64> = 0.67..=1.5;

/// What a leg may be too short by without a word, metres.
const LEGS_SHORT: f64 = 0.02;

/// How a motion was moved onto a path.
#[derive(Serialize)]
struct Record {
    kinegrad: &'static str,
    motion: PathBuf,
    path: PathBuf,
    path_sha256: String,
    path_content: PathPlan,
    warp: Warp,
    /// None where feet are not held.
    #[serde(skip_serializing_if = "Option::is_none")]
    feet: Option<Feet>,
    frames: usize,
    fps: f64,
    /// Metres of the path.
    path_length: f64,
    /// The root's speed on the path by that before; 0 of a motion that stood.
    speed_ratio: f64,
    before: Quality,
    after: PathReport,
}

/// Feet that are held.
#[derive(Serialize)]
struct Feet {
    /// Part of the frames in which a foot stands, in the motion as it was given.
    in_contact: f64,
    /// Mean speed of standing feet on the path before and after, metres per second.
    slid_before: f64,
    slide_after: f64,
    /// How far a foot is from where it should stand, at most, metres.
    legs_short: f64,
}

/// How a motion looks.
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
    let own = Joints::new(
        joints.as_slice()[..frames * joints.joints()].to_vec(),
        joints.joints(),
    )?;
    let held = match arguments.lock_feet {
        true => Some(lock_joints_above(
            &warped.joints,
            &own,
            &skeleton,
            &ContactRule::default(),
            floor_of(&own),
        )?),
        false => None,
    };
    let feet = held.as_ref().map(|held| Feet {
        in_contact: held.in_contact,
        slid_before: held.before,
        slide_after: held.after,
        legs_short: held.missed,
    });
    let moved = held.map_or(warped.joints, |held| held.joints);
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
        folder::must_take(path)?;
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
    record.doubt(joints.frames(), arguments.along);
    Ok(ExitCode::SUCCESS)
}

/// Where the results go: joints, features, BVH and record.
fn outputs(arguments: &WarpArguments) -> Result<[PathBuf; 4], Error> {
    let stem = stem(&arguments.out)?;
    let outputs = [".npy", ".features.npy", ".bvh", ".json"];
    let outputs = outputs.map(|ending| PathBuf::from(format!("{stem}{ending}")));
    let read = [arguments.motion.clone(), arguments.path.clone()];
    must_be_new(&outputs, &read, arguments.overwrite, "--out")?;
    Ok(outputs)
}

/// The path's file and what it says.
fn read_path(arguments: &WarpArguments) -> Result<(String, PathPlan), Error> {
    let file = arguments.path.display().to_string();
    let refused = |reason: String| {
        let hint = "docs/paths.md describes paths";
        Error::usage(format!("{file}: {reason}"), hint)
    };
    let text = read_text(&arguments.path).map_err(|error| refused(error.to_string()))?;
    let plan = PathPlan::read(&text, &file, arguments.metres_per_unit).map_err(refused)?;
    if plan.speed.is_some() {
        tell!(
            "note: {file}: `speed` is for motion that is generated; this one is as fast as `--along` \
             says"
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

/// The floor of a motion: y = 0, or its lowest joint if that is higher.
fn floor_of(joints: &Joints) -> f64 {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    heights.fold(f64::INFINITY, f64::min).max(0.0)
}

impl Record {
    fn summarize(&self) {
        let number = |value: Option<f64>, digits: usize| match value {
            Some(value) => format!("{value:.digits$}"),
            None => "-".to_owned(),
        };
        let (before, after) = (&self.before, &self.after);
        let rows = [
            [
                "foot skating",
                &number(before.foot_skating, 3),
                &number(after.foot_skating, 3),
            ],
            [
                "jerk, m/s^3",
                &number(before.jerk, 0),
                &number(after.jerk, 0),
            ],
            [
                "heading from the path, degrees",
                "",
                &number(after.heading_error, 1),
            ],
            [
                "root from the path, m",
                "",
                &number(Some(after.largest_distance), 6),
            ],
        ];
        let rows = rows.map(|row| row.map(str::to_owned));
        tell!("{}", table(["", "before", "after"], rows));
    }

    /// Says what is doubtful.
    fn doubt(&self, given: usize, along: ArcLengthMode) {
        if self.frames < given {
            tell!(
                "note: the path ends after {} of {given} frames, at {:.2} m",
                self.frames,
                self.path_length
            );
        }
        match self.speed_ratio {
            0.0 if along == ArcLengthMode::Own => {}
            0.0 => tell!("warning: the motion stands, and glides along the path"),
            ratio if !USUAL.contains(&ratio) => tell!(
                "warning: the root is {ratio:.2} times as fast as it was, and feet slide in proportion: \
                 give a path as long as the motion's own way ({:.2} m), or `--along own`",
                self.path_length / ratio
            ),
            _ => {}
        }
        let Some(feet) = &self.feet else { return };
        if feet.in_contact == 0.0 {
            tell!("warning: no foot stands in this motion: `--lock-feet` held none");
        }
        if feet.legs_short > LEGS_SHORT {
            tell!(
                "warning: legs are up to {:.2} m too short to stand where they stood",
                feet.legs_short
            );
        }
    }
}
