//! One take: from its file to clips.

use std::ops::Range;
use std::path::PathBuf;

use kinegrad_data::Digest;
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_settings::counted;

use super::body::Body;
use super::captions::{Labels, mirrored};
use super::clip::Grounded;
use super::cut::cut;
use super::dataset::ClipRow;
use super::labels::CaptionTable;
use super::map::JointMap;
use super::report::ClipTakeReport;
use crate::plan::{CapturePlan, Plan};
use crate::prepare::Rejection;
use crate::prepare::files::bytes;
use crate::prepare::output::Output;
use crate::{Bvh, C3d, Error};

/// Version of the algorithm. A new version makes all takes again.
const MAKER: &str = "kinegrad clips 4";

/// Name of the map of captures of markers.
const MARKERS: &str = "markers";

/// A take with its file.
#[derive(Clone, Debug)]
pub(super) struct Take {
    pub name: String,
    /// The take's part of the plan, with the file that matched a pattern.
    pub capture: CapturePlan,
    pub motion: PathBuf,
    /// `None` if the names of the joints decide.
    pub map: Option<JointMap>,
}

pub(super) struct TakeInput {
    labels: Labels,
    number: Option<u64>,
    captions: Vec<String>,
    bytes: Vec<u8>,
    /// A checksum of the file and the take's part of the plan.
    pub key: Digest,
}

impl Take {
    /// Reads the file, labels and captions; an error names the missing ones.
    pub fn input(&self, plan: &Plan, table: Option<&CaptionTable>) -> Result<TakeInput, String> {
        let stem = self.motion.file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy();
        let in_file = |problem: String| format!("{}: {problem}", self.motion.display());
        let labels = &self.capture.labels;
        let found = labels.of(&stem, plan, table).map_err(in_file)?;
        let mut captions = found.captions.clone();
        for caption in plan.captions().of(&found.labels).map_err(in_file)? {
            if !captions.contains(&caption) {
                captions.push(caption);
            }
        }
        let bytes = bytes(&self.motion)?;
        let map = self.map.as_ref().map(|map| (&map.name, map.fingerprint()));
        let wanted = (&self.name, &self.capture, plan.clips(), map);
        let derived = (&found.labels, found.take, &captions);
        let text = serde_json::to_string(&(wanted, derived)).expect("plain data");
        let key = Digest::of_parts([MAKER.as_bytes(), text.as_bytes(), &bytes]);
        Ok(TakeInput {
            labels: found.labels,
            number: found.take,
            captions,
            bytes,
            key,
        })
    }

    /// Writes the clips of the take. The report of an unusable take contains the reason.
    pub fn make(
        &self,
        plan: &Plan,
        input: &TakeInput,
        output: &Output,
    ) -> Result<(Vec<ClipRow>, ClipTakeReport), Error> {
        let skeleton = Skeleton::humanml3d();
        let mut report = ClipTakeReport {
            name: self.name.clone(),
            labels: input.labels.clone(),
            number: input.number,
            ..ClipTakeReport::default()
        };
        let clips = plan.clips();
        let failed = |mut report: ClipTakeReport, problem: String| {
            report.failure = Some(format!("{}: {problem}", self.motion.display()));
            Ok((Vec::new(), report))
        };
        let ready = self.body(input, &skeleton).and_then(|(map, body)| {
            let fps = match clips.resample {
                true => skeleton.description().fps,
                false => body.rate,
            };
            let joints = self.within(&body, fps)?;
            let grounded = Grounded::new(&skeleton, &joints, clips.retarget);
            Ok((map, body, fps, grounded.map_err(|e| e.to_string())?))
        });
        let (map, body, fps, grounded) = match ready {
            Ok(ready) => ready,
            Err(problem) => return failed(report, problem),
        };
        let frames = grounded.frames();
        report.seconds = frames as f64 / fps;
        report.map.clone_from(&map);
        (report.metres_per_unit, report.up) = (body.metres_per_unit, body.up);
        report.notes = body.notes;
        let (ranges, rest) = cut(frames, clips.min_frames, clips.max_frames);
        if let Some(rest) = rest {
            let (frames, least) = (rest.len(), clips.min_frames);
            let seconds = frames as f64 / fps;
            let left = format!("{} ({seconds:.2} s) left over", counted(frames, "frame"));
            report.skipped.push(Rejection {
                first_frame: rest.start,
                frames,
                reason: format!("{left}; a clip has at least {least}"),
            });
        }
        // All clips are made before writing: a take gives all of its clips or none.
        let clip = |range: &Range<usize>| grounded.clip(&skeleton, range.clone());
        let made = ranges.iter().map(clip);
        let features = match made.collect::<Result<Vec<_>, _>>() {
            Ok(features) => features,
            Err(problem) => return failed(report, problem.to_string()),
        };
        let mut rows = Vec::new();
        for (range, features) in ranges.into_iter().zip(features) {
            let row = ClipRow {
                id: format!("{}_{:05}", self.name, range.start),
                take: self.name.clone(),
                file: self.capture.motion.clone(),
                map: map.clone(),
                labels: input.labels.clone(),
                captions: input.captions.clone(),
                first_frame: range.start,
                frames: range.len(),
                fps,
                mirrored: false,
                features_bytes: 0,
                features_sha256: input.key,
                texts_bytes: 0,
                texts_sha256: input.key,
            };
            if clips.mirror {
                let labels = row.labels.iter();
                let image = ClipRow {
                    id: format!("M{}", row.id),
                    labels: labels.map(|(k, v)| (k.clone(), mirrored(v))).collect(),
                    captions: row.captions.iter().map(|text| mirrored(text)).collect(),
                    mirrored: true,
                    ..row.clone()
                };
                rows.push(image.write(&features.mirror(&skeleton)?, output)?);
            }
            rows.push(row.write(&features, output)?);
        }
        report.clips = rows.len();
        Ok((rows, report))
    }

    /// The body in the file, and the name of its joint map.
    fn body(&self, input: &TakeInput, skeleton: &Skeleton) -> Result<(String, Body), String> {
        let file = self.motion.display().to_string();
        let CapturePlan { units, up, fps, .. } = self.capture;
        let ending = self.motion.extension().unwrap_or_default();
        if ending.eq_ignore_ascii_case("c3d") {
            let c3d = C3d::parse(&input.bytes, &file).map_err(|e| e.with_hint())?;
            let rate = fps.unwrap_or(c3d.rate);
            let used = self.frames_used(rate, c3d.frames());
            let body = Body::of_markers(&c3d, used, skeleton, rate, up)?;
            return Ok((MARKERS.to_owned(), body));
        }
        let bvh = Bvh::parse(&input.bytes, &file).map_err(|e| e.with_hint())?;
        let map = match &self.map {
            Some(map) => map.clone(),
            None => JointMap::fitting(&bvh)?,
        };
        let rate = fps.unwrap_or(1.0 / bvh.frame_time());
        let mut body = Body::of_places(map.joints_of(&bvh)?, skeleton, rate, units, up)?;
        body.notes.extend(bvh.notes());
        Ok((map.name.clone(), body))
    }

    /// The frames that the plan uses of a file with `rate` frames per second.
    fn frames_used(&self, rate: f64, frames: usize) -> Range<usize> {
        let start = (self.capture.motion_start_seconds * rate).floor() as usize;
        let end = self.capture.motion_end_seconds.unwrap_or(f64::INFINITY);
        let end = ((end * rate).ceil() as usize).saturating_add(1).min(frames);
        start.min(end.saturating_sub(1))..end
    }

    /// The joints, at `fps` frames per second, that the plan uses of a file.
    fn within(&self, body: &Body, fps: f64) -> Result<Joints, String> {
        let joints = body.at_rate(fps);
        let start = (self.capture.motion_start_seconds * fps).round() as usize;
        let end = self.capture.motion_end_seconds.unwrap_or(f64::INFINITY);
        let end = ((end * fps).round() as usize).saturating_add(1);
        let end = end.min(joints.frames());
        if start.saturating_add(1) >= end {
            let (frames, from) = (end.saturating_sub(start), self.capture.motion_start_seconds);
            return Err(format!(
                "{} of it from second {from}: at least 2 are needed",
                counted(frames, "frame")
            ));
        }
        let count = joints.joints();
        let part = joints.as_slice()[start * count..end * count].to_vec();
        Joints::new(part, count).map_err(|e| e.to_string())
    }
}
