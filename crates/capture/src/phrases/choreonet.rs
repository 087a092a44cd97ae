//! The ChoreoNet data as takes. Each dance is a list of captured units, placed end to end on even
//! beats between two moments of a song.

use std::collections::HashMap;
use std::path::Path;

use kinegrad_data::file::{MAX_TEXT_BYTES, read_file};
use serde::Deserialize;

use crate::plan::{ChoreonetPlan, Plan, SegmentPlan, TakePlan};
use crate::{BeatGrid, Error};

/// Frames per second of `start_pos` and `end_pos`.
const POSITIONS_PER_SECOND: f64 = 25.0;

/// A dance, as its JSON states it.
#[derive(Debug, Deserialize)]
struct Dance {
    dance_type: String,
    dance_id: u64,
    start_pos: f64,
    end_pos: f64,
    movements: Vec<String>,
    durations: Vec<f64>,
}

/// A row of the table of intervals.
#[derive(Debug, Deserialize)]
struct Interval {
    c3d_file: String,
    movement_tag: String,
    start_frame: f64,
    end_frame: f64,
}

/// The takes of a plan's choreographies. A unit without an interval (START, HOLD) is a gap.
pub(super) fn takes(plan: &Plan, choreonet: &ChoreonetPlan) -> Result<Vec<TakePlan>, Error> {
    let dances = plan.resolve(&choreonet.choreography);
    let bytes = read_file(&dances, MAX_TEXT_BYTES).map_err(|e| Error::plan(&dances, e))?;
    let all = serde_json::from_slice::<Vec<Dance>>(&bytes);
    let all = all.map_err(|problem| Error::plan(&dances, problem))?;
    let intervals = intervals(&plan.resolve(&choreonet.intervals))?;
    let take = |dance| take(choreonet, &intervals, dance);
    all.into_iter().map(take).collect()
}

/// The first interval of each movement.
fn intervals(path: &Path) -> Result<HashMap<String, Interval>, Error> {
    let bytes = read_file(path, MAX_TEXT_BYTES).map_err(|problem| Error::plan(path, problem))?;
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let mut intervals = HashMap::new();
    for row in reader.deserialize::<Interval>() {
        let row = row.map_err(|problem| Error::plan(path, problem))?;
        intervals.entry(row.movement_tag.clone()).or_insert(row);
    }
    Ok(intervals)
}

fn take(
    choreonet: &ChoreonetPlan,
    intervals: &HashMap<String, Interval>,
    dance: Dance,
) -> Result<TakePlan, Error> {
    let name = format!("{}_{}", dance.dance_type, dance.dance_id);
    let beats: f64 = dance.durations.iter().sum();
    let seconds = (dance.end_pos - dance.start_pos) / POSITIONS_PER_SECOND;
    let positive = dance.durations.iter().all(|&beats| beats > 0.0) && seconds > 0.0;
    let (movements, durations) = (dance.movements.len(), dance.durations.len());
    if !positive || movements != durations {
        let problem = format!(
            "dance {name}: as many positive durations as movements and an end after its start \
             allowed; {movements} movements, {durations} durations, {seconds} s found"
        );
        return Err(Error::plan(Path::new(&choreonet.choreography), problem));
    }
    let units = dance.movements.iter().zip(&dance.durations);
    let segments = units.map(|(tag, &beats)| match intervals.get(tag) {
        Some(interval) => SegmentPlan {
            motion: format!("{}/{}.c3d", choreonet.captures, interval.c3d_file),
            frames: [interval.start_frame, interval.end_frame],
            beats,
        },
        None => SegmentPlan {
            motion: format!("{tag} (no interval)"),
            frames: [0.0, 1.0],
            beats,
        },
    });
    let waltz = choreonet.three_beats_per_bar.contains(&dance.dance_type);
    let audio = choreonet.music.replace("{type}", &dance.dance_type);
    Ok(TakePlan {
        segments: segments.collect(),
        audio: audio.replace("{id}", &dance.dance_id.to_string()),
        beats: Some(BeatGrid {
            start_seconds: dance.start_pos / POSITIONS_PER_SECOND,
            seconds_per_beat: seconds / beats,
            beats_per_bar: if waltz { 3 } else { 4 },
            beats: Some(beats),
        }),
        markers: Some(choreonet.markers.clone()),
        name: Some(name),
        grid: choreonet.grid,
        label: choreonet.labels.get(&dance.dance_type).cloned(),
        ..TakePlan::default()
    })
}
