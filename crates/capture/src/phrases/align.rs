//! Aligning the motion of a take with the timeline of its music.

use std::ops::Range;
use std::path::Path;

use kinegrad_data::MAX_FRAMES;
use kinegrad_motion::FPS;
use kinegrad_settings::counted;

use super::grid::Timeline;
use super::resolve::Take;
use super::root_source;
use super::song::Song;
use crate::plan::Plan;
use crate::prepare::Rejection;
use crate::{MarkerGaps, RootSource, RootTrack, Segment, assemble, join};

/// Usual median heights of a root, metres. Other heights suggest wrong units.
const HEIGHTS: std::ops::RangeInclusive<f64> = 0.2..=3.0;

/// The root track of a take on the timeline of its music.
pub(super) struct AlignedTrack {
    pub track: RootTrack,
    /// Frames that begin after a border between segments.
    pub borders: Vec<usize>,
    pub filled_gaps: bool,
    /// The frames in the plan; the track may end earlier.
    pub span: Range<usize>,
    pub notes: Vec<String>,
    /// Index of each frame's capture file in `files`.
    sources: Vec<Option<usize>>,
    files: Vec<String>,
    /// Frames without a capture, and the file that is missing.
    missing: Vec<(Range<usize>, String)>,
}

impl AlignedTrack {
    /// The reason why frame `t` is in no phrase; `alone`: the take has no phrase at all.
    pub fn reason(&self, t: usize, alone: bool, length: usize) -> String {
        if t >= self.track.frames() {
            return "the song has ended".to_owned();
        }
        if let Some((_, file)) = self.missing.iter().find(|(frames, _)| frames.contains(&t)) {
            return format!("no capture: {file}");
        }
        match (self.track.valid[t], alone) {
            (true, true) => format!("too short for a phrase of {length} frames"),
            (true, false) => format!("left over: phrases have {length} frames"),
            (false, _) => "the root is missing in the capture".to_owned(),
        }
    }

    /// The frames in no phrase; neighbouring frames with the same reason are merged.
    pub fn rejections(&self, phrases: &[usize], length: usize) -> Vec<Rejection> {
        let mut used = vec![false; self.span.end];
        for &first in phrases {
            used[first..first + length].fill(true);
        }
        let mut rejections: Vec<Rejection> = Vec::new();
        for t in self.span.clone().filter(|&t| !used[t]) {
            let reason = self.reason(t, phrases.is_empty(), length);
            match rejections.last_mut() {
                Some(last) if last.first_frame + last.frames == t && last.reason == reason => {
                    last.frames += 1;
                }
                _ => rejections.push(Rejection {
                    first_frame: t,
                    frames: 1,
                    reason,
                }),
            }
        }
        rejections
    }

    /// The capture files of some frames, in their order.
    pub fn sources_of(&self, frames: &Range<usize>) -> String {
        let sources = self.sources[frames.clone()].iter().flatten();
        let mut names: Vec<&str> = sources.map(|&file| self.files[file].as_str()).collect();
        names.dedup();
        names.join(", ")
    }

    /// The part of a capture file that the plan names, at its time in the song.
    pub fn recording(take: &Take, path: &Path, song: Option<&Song>) -> Result<Self, String> {
        let source = root_source::read(path, &take.plan)?;
        let rate = source.rate();
        let last_frame = (source.frames() - 1) as f64;
        let from = take.plan.motion_start_seconds;
        let ends = last_frame / rate;
        let to = take.plan.motion_end_seconds.unwrap_or(ends);
        let mut notes = gap_notes(&take.name, &*source);
        // The last frame of a recording lasts as long as the others.
        if to > ends + 1.0 / rate {
            let file = take.plan.motion.as_deref().unwrap_or_default();
            notes.push(format!(
                "motion_end_seconds is {to}, but {file} ends at {ends:.3} s"
            ));
        }
        let to = to.min(ends);
        if from > to {
            let file = path.display();
            return Err(format!(
                "{file}: it ends at {ends:.3} s, motion_start_seconds is {from}"
            ));
        }
        let start = take.plan.audio_start_seconds;
        // Rounding may put the last moment just beyond the end.
        let last = ((start + to - from) * FPS + 1e-6).floor() as usize;
        let wanted = last.saturating_add(1);
        let frames = frames_until(wanted, song)?;
        let poses = (0..frames).map(|t| {
            let moment = t as f64 / FPS - start + from;
            let inside = (from - 1e-9..=to + 1e-6 / FPS).contains(&moment);
            let frame = (moment * rate).clamp(0.0, last_frame);
            inside.then(|| source.sample(frame)).flatten()
        });
        let track = RootTrack::from_poses(poses.collect(), FPS).map_err(|e| e.with_hint())?;
        notes.extend(height_note(&track));
        Ok(Self {
            track,
            borders: Vec::new(),
            sources: vec![Some(0); frames],
            files: vec![take.plan.motion.clone().unwrap_or_default()],
            filled_gaps: filled(&*source),
            span: ((start * FPS).ceil() as usize).min(wanted)..wanted,
            missing: Vec::new(),
            notes,
        })
    }

    /// The plan's segments, end to end on the beats of `timeline`.
    pub fn segments(
        take: &Take,
        plan: &Plan,
        song: Option<&Song>,
        timeline: &Timeline,
    ) -> Result<Self, String> {
        let segment_beats = timeline.segment_beats.as_ref();
        let segment_beats = segment_beats.ok_or("segments without beats")?;
        let (mut files, mut captures) = (Vec::new(), Vec::new());
        let (mut segments, mut missing) = (Vec::new(), Vec::new());
        let mut begins = 0.0;
        for segment in &take.plan.segments {
            let ends = begins + segment.beats;
            let mut capture = files.iter().position(|file| *file == segment.motion);
            let path = plan.resolve(&segment.motion);
            if capture.is_none() && path.exists() {
                captures.push(root_source::read(&path, &take.plan)?);
                files.push(segment.motion.clone());
                capture = Some(files.len() - 1);
            }
            match capture {
                Some(take) => {
                    let [first, last] = segment.frames;
                    let part = |beat: f64| (beat - begins) / segment.beats;
                    let frame = |beat: f64| first + part(beat) * (last - first);
                    // Between two beats, motion keeps its speed.
                    for pair in timeline.knots(begins, ends).windows(2) {
                        let [from, to] = [pair[0], pair[1]].map(|beat| segment_beats.moment(beat));
                        segments.push(Segment {
                            take,
                            capture_frames: frame(pair[0])..frame(pair[1]),
                            start_seconds: from,
                            seconds: to - from,
                        });
                    }
                }
                None => {
                    let frame = |beat: f64| frame_at(segment_beats.moment(beat));
                    missing.push((frame(begins)..frame(ends), segment.motion.clone()));
                }
            }
            begins = ends;
        }
        let wanted = frame_at(segment_beats.moment(begins)).max(1);
        let frames = frames_until(wanted, song)?;
        let sources: Vec<&dyn RootSource> = captures.iter().map(Box::as_ref).collect();
        let assembly = assemble(&sources, &segments, frames).map_err(|e| e.with_hint())?;
        let (track, borders) = join(&assembly, &plan.joining).map_err(|e| e.with_hint())?;
        let named = files.iter().zip(&sources);
        let mut notes: Vec<String> = named.flat_map(|(f, s)| gap_notes(f, *s)).collect();
        notes.extend(height_note(&track));
        Ok(Self {
            track,
            borders,
            sources: assembly.moments.iter().map(|m| m.map(|m| m.take)).collect(),
            files,
            filled_gaps: sources.iter().any(|source| filled(*source)),
            span: frame_at(segment_beats.moment(0.0)).min(wanted)..wanted,
            missing,
            notes,
        })
    }
}

/// The first frame at or after a moment of the song.
fn frame_at(seconds: f64) -> usize {
    (seconds * FPS - 1e-6).ceil().max(0.0) as usize
}

/// A note if the root's height suggests wrong units or axes.
fn height_note(track: &RootTrack) -> Option<String> {
    let poses = (0..track.frames()).filter_map(|t| track.pose(t));
    let mut heights: Vec<f64> = poses.map(|pose| pose.position[1]).collect();
    heights.sort_by(f64::total_cmp);
    let median = heights.get(heights.len() / 2)?;
    let right = "are its units and the axis that points up right?";
    let note = || format!("the root is {median:.3} m high (median): {right}");
    (!HEIGHTS.contains(median)).then(note)
}

/// The number of frames, at most those of the song.
fn frames_until(wanted: usize, song: Option<&Song>) -> Result<usize, String> {
    match wanted {
        0..=MAX_FRAMES => Ok(song.map_or(wanted, |song| wanted.min(song.features.frames()))),
        _ => Err(format!("{wanted} frames found, {MAX_FRAMES} allowed")),
    }
}

/// True if any marker was interpolated.
fn filled(source: &dyn RootSource) -> bool {
    source.gaps().iter().any(|gap| gap.filled_frames > 0)
}

fn gap_notes(file: &str, source: &dyn RootSource) -> Vec<String> {
    let note = |gap: &MarkerGaps| {
        format!(
            "{file}: marker {} missing in {}, {} of them filled, longest gap {}",
            gap.marker,
            counted(gap.missing_frames, "frame"),
            gap.filled_frames,
            gap.longest_gap_frames
        )
    };
    source.gaps().iter().map(note).collect()
}
