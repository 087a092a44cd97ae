//! `kinegrad warp`

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::Digest;
use kinegrad_data::file::read_text;
use kinegrad_motion::Statistics;
use kinegrad_motion::feet::{ContactRule, Planted, lock_joints};
use kinegrad_motion::humanml::{Extraction, Features, Joints, Skeleton};
use kinegrad_motion::metrics::BodyQuality;
use kinegrad_motion::path::{ArcLengthMode, PathPlan, PathReport, Warp, Warped};
use kinegrad_output::path_text;
use kinegrad_report::table;
use kinegrad_train::sampling::MeasuresRecord;
use kinegrad_train::{Error, Systems};
use serde::Serialize;

use crate::args::WarpArguments;
use crate::io::{
    BvhReading, Content, LEGS_SHORT, MotionArray, bvh_file, exit_code, is_bvh, must_be_new,
    read_body, stem, unusable_stem, with_ending, write_all,
};
use crate::output::unusable;
use crate::{folder, interrupt, output};

/// Increase of the foot skating that causes no warning.
const MORE_SKATING: f64 = 0.1;

/// Largest speed ratio of a stretched motion: steps that are longer leave the legs' reach.
const LONGEST_STRIDE: f64 = 1.5;

/// Advice about a motion that is not usable.
const ADVICE: &str = "leave out `--sharp`, give a path with wider turns, or a motion without jumps";

/// The record of a warp.
#[derive(Serialize)]
struct Record {
    kinegrad: &'static str,
    #[serde(serialize_with = "path_text")]
    motion: PathBuf,
    #[serde(serialize_with = "path_text")]
    path: PathBuf,
    path_sha256: String,
    path_content: PathPlan,
    warp: Warp,
    /// `None` without `--lock-feet`.
    #[serde(skip_serializing_if = "Option::is_none")]
    feet: Option<Feet>,
    frames: usize,
    fps: f64,
    /// First frame in which the motion stands at the end of the path.
    #[serde(skip_serializing_if = "Option::is_none")]
    stands_from: Option<usize>,
    /// Length of the path, meters.
    path_length: f64,
    /// Ratio of the root's speed after and before; 0 for a motion that stood.
    speed_ratio: f64,
    before: BodyQuality,
    after: PathReport,
    /// The moved body beside captured people.
    body: MeasuresRecord,
}

/// Locked feet.
#[derive(Serialize)]
struct Feet {
    /// Share of the input's frames in which a foot stands.
    in_contact: f64,
    /// Mean speed of standing feet on the path before and after, meters per second.
    slid_before: f64,
    slide_after: f64,
    /// Largest distance of a foot from its contact position, out of the leg's reach, metres.
    legs_short: f64,
}

/// Moves a motion onto a path.
pub fn run(systems: Systems<'_>, arguments: WarpArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let stem = stem(&arguments.out)?;
    must_be_free(&arguments, &stem)?;
    let (text, plan) = read_path(&arguments)?;
    let reading = BvhReading::of(&arguments.bvh);
    let (joints, skeleton) = read_motion(systems, &arguments.motion, &reading)?;
    let path = plan.polyline().map_err(unusable)?;
    let warp = Warp {
        along: arguments.along,
        speed: plan
            .speed
            .filter(|_| arguments.along == ArcLengthMode::Stretch),
        turning: arguments.heading,
        smooth: !arguments.sharp,
        least_speed: match arguments.sharp {
            true => 0.0,
            false => Warp::STANDING,
        },
    };
    let warped = warp.apply(&joints, &skeleton, &path).map_err(unusable)?;
    if arguments.along == ArcLengthMode::Stretch {
        must_be_in_reach(&warped, path.length(), warp.speed)?;
    }
    let floor = floor_of(&joints);
    let lock = || {
        let rule = ContactRule::default();
        lock_joints(
            &warped.joints,
            &warped.own,
            &skeleton,
            &rule,
            Planted::AsSeen,
            floor,
        )
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
        frames: moved.frames(),
        fps: skeleton.description().fps,
        stands_from: warped.stands_from,
        path_length: path.length(),
        speed_ratio: warped.speed_ratio,
        before: BodyQuality::of(&joints, &skeleton, floor),
        after: PathReport::of(&moved, &skeleton, &path, &warped.course, floor)?,
        body: MeasuresRecord::of(&moved, &skeleton, &Statistics::default()),
        path_content: plan,
    };
    let is_unusable = record.body.far && !arguments.allow_unusable;
    let outputs = outputs(&match is_unusable {
        true => unusable_stem(&stem),
        false => stem,
    });
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
    record.warn(arguments.along);
    if !arguments.json {
        output::how_to_view(&outputs[..1], None);
    }
    Ok(exit_code(is_unusable.into(), "motion", ADVICE))
}

/// Refuses a path, or a `speed` along it, that the motion would only reach by sliding.
fn must_be_in_reach(warped: &Warped, length: f64, speed: Option<f64>) -> Result<(), Error> {
    let (ratio, frames) = (warped.speed_ratio, warped.joints.frames());
    if ratio > 0.0 && ratio <= LONGEST_STRIDE {
        return Ok(());
    }
    let end = warped.course.metres.last().copied().unwrap_or(0.0);
    let walked = if ratio > 0.0 { end / ratio } else { 0.0 };
    if let Some(speed) = speed.filter(|_| walked > 0.0) {
        let own = speed / ratio;
        let message = format!(
            "the path's `speed` is {speed:.2} m/s and the motion walks {own:.2} m/s: its legs reach \
             {LONGEST_STRIDE} times as far at most"
        );
        let hint = format!(
            "set `speed` to at most {:.2}, or keep the motion's own with `--along own`",
            LONGEST_STRIDE * own
        );
        return Err(Error::usage(message, hint));
    }
    let message = format!(
        "the path is {length:.2} m long and the motion walks {walked:.2} m in {frames} frames: its legs \
         reach {LONGEST_STRIDE} times as far at most"
    );
    let hint = format!(
        "give a path of at most {:.2} m or a longer motion, or walk the beginning of the path with \
         `--along own`, or at the path's `speed`",
        LONGEST_STRIDE * walked
    );
    Err(Error::usage(message, hint))
}

/// Output files: joints, features, BVH and record.
fn outputs(stem: &OsStr) -> [PathBuf; 4] {
    [".npy", ".features.npy", ".bvh", ".json"].map(|ending| with_ending(stem, ending))
}

/// Refuses outputs that exist or are also inputs.
fn must_be_free(arguments: &WarpArguments, stem: &OsStr) -> Result<(), Error> {
    let all = [outputs(stem), outputs(&unusable_stem(stem))].concat();
    let read = [arguments.motion.clone(), arguments.path.clone()];
    must_be_new(&all, &read, arguments.overwrite, "--out")
}

/// The text of the path's file, and the path.
fn read_path(arguments: &WarpArguments) -> Result<(String, PathPlan), Error> {
    let file = arguments.path.display().to_string();
    let hint = "docs/paths.md describes paths";
    let refused = |message: String| Error::usage(message, hint);
    let text = read_text(&arguments.path).map_err(|error| refused(format!("{file}: {error}")))?;
    let plan = PathPlan::read(&text, &file, arguments.metres_per_unit);
    let plan = plan.map_err(|error| refused(error.to_string()))?;
    if plan.speed.is_some() && arguments.along == ArcLengthMode::Own {
        tell!("note: {file}: `speed` is ignored: `--along own` keeps the motion's speed");
    }
    Ok((text, plan))
}

/// The joints of a motion and their skeleton.
fn read_motion(
    systems: Systems<'_>,
    path: &Path,
    reading: &BvhReading,
) -> Result<(Joints, Skeleton), Error> {
    let (joints, skeleton) = match is_bvh(path) {
        true => {
            reading.must_suit_bvh(path)?;
            (read_body(path, reading, false)?, Skeleton::humanml3d())
        }
        false => MotionArray::read(systems, path, reading)?.body()?,
    };
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

/// The floor of a motion: y = 0, or its lowest joint if that is higher.
fn floor_of(joints: &Joints) -> f64 {
    let heights = joints.as_slice().iter().map(|place| place[1]);
    heights.fold(f64::INFINITY, f64::min).max(0.0)
}

impl Record {
    fn summarize(&self) {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let after = &self.after;
        let body = self.before.rows().into_iter().zip(after.body.rows());
        let body = body.map(|((name, before, digits), (_, after, _))| {
            [
                name.to_owned(),
                number(before, digits),
                number(after, digits),
            ]
        });
        let row = |name: &str, value: String| [name.to_owned(), String::new(), value];
        let travelled = format!("{:.2} of {:.2}", after.travelled, self.path_length);
        let path = [
            row("travelled along the path, m", travelled),
            row(
                "root from the path, m",
                number(Some(after.largest_distance), 6),
            ),
            row(
                "heading from the path, degrees",
                number(after.heading_error, 1),
            ),
        ];
        for line in table(["", "before", "after"], body.chain(path)).lines() {
            tell!("{line}");
        }
    }

    /// Prints notes and warnings.
    fn warn(&self, along: ArcLengthMode) {
        if let Some(frame) = self.stands_from {
            tell!(
                "note: the motion reaches the end of the path, {:.2} m, and stands there from frame \
                 {frame} of {}",
                self.path_length,
                self.frames
            );
        }
        let skating = |body: &BodyQuality| body.foot_skating.unwrap_or(0.0);
        let (before, after) = (skating(&self.before), skating(&self.after.body));
        if after > before + MORE_SKATING {
            let ratio = self.speed_ratio;
            let other = match along {
                ArcLengthMode::Stretch if self.warp.speed.is_none() => format!(
                    "; the root is {ratio:.2} times as fast: give a path of the motion's length \
                     ({:.2} m), or `--along own`",
                    self.path_length / ratio
                ),
                _ => String::new(),
            };
            tell!(
                "warning: feet slide in {:.0} % of the frames, {:.0} % before{other}",
                100.0 * after,
                100.0 * before
            );
        }
        if let Some(warning) = self.body.warning("the moved motion") {
            tell!("warning: {warning}");
        }
        let Some(feet) = &self.feet else { return };
        if feet.in_contact == 0.0 {
            tell!("warning: `--lock-feet` had no effect: no foot stands in this motion");
        }
        if feet.legs_short > LEGS_SHORT {
            tell!(
                "warning: feet in contact slide by up to {:.2} m, because the legs do not reach",
                feet.legs_short
            );
        }
    }
}
