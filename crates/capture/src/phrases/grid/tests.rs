use kinegrad_audio::beats;
use kinegrad_data::{AudioFeatures, AudioLayout};
use kinegrad_motion::FPS;

use super::*;

/// A song whose onsets are at these seconds with these strengths.
fn song(onsets: &[(f64, f32)], seconds: f64) -> Song {
    let frames = (seconds * FPS) as usize;
    let mut onset = vec![0.0; frames];
    for (at, strength) in onsets {
        onset[(at * FPS).round() as usize] = *strength;
    }
    Song {
        features: AudioFeatures::silence(AudioLayout::CCMOTION, frames),
        beats: beats::track(&onset),
        onset,
        damage: None,
    }
}

/// `count` beats from `start` on, the first `first` seconds long, the last `last`.
fn drifting(count: usize, start: f64, first: f64, last: f64) -> Vec<f64> {
    let length = |k: usize| first + (last - first) * k as f64 / count as f64;
    (0..count)
        .scan(start, |now, k| {
            let beat = *now;
            *now += length(k);
            Some(beat)
        })
        .collect()
}

fn beats_of(seconds: &[f64]) -> Vec<(f64, f32)> {
    seconds.iter().map(|s| (*s, 1.0)).collect()
}

/// `count` even beats in bars of four from `start` to `end`.
fn stated(count: f64, start: f64, end: f64) -> BeatGrid {
    BeatGrid {
        start_seconds: start,
        seconds_per_beat: (end - start) / count,
        beats_per_bar: 4,
        beats: Some(count),
    }
}

/// A song of 72 beats that slows down; 64 beats are danced from the fourth on. Returns the times of
/// the danced beats and of the next beat.
fn slowing() -> (Song, Vec<f64>) {
    let beats = drifting(72, 0.7, 0.46, 0.56);
    (song(&beats_of(&beats), 40.0), beats[3..=67].to_vec())
}

fn laid(stated: BeatGrid, count: f64, song: &Song) -> Timeline {
    Timeline::of_segments(stated, count, Some(song), None).expect("a timeline")
}

#[test]
fn segments_lie_on_the_beats_of_a_song_that_slows_down() {
    let (song, danced) = slowing();
    let timeline = laid(stated(64.0, danced[0], danced[64]), 64.0, &song);
    let report = timeline.report.clone().expect("a report");
    assert_eq!((report.grid, report.tracked_beats), (Grid::Tracked, 64));
    assert!(
        report.stated_beats > 63.99 && report.drift_beats > 1.0,
        "{report:?}"
    );
    assert!(report.uniform_concentration < 0.8, "{report:?}");
    assert!(report.concentration > 0.9999, "{report:?}");
    assert!(timeline.notes.is_empty());
    let segment_beats = timeline.segment_beats.as_ref().expect("beats");
    for (k, moment) in danced.iter().enumerate() {
        let off = segment_beats.moment(k as f64) - moment;
        assert!(off.abs() < 1.5 / FPS, "beat {k}: {off} s");
    }
    // The phase and the features are of the same beats.
    let frames = (danced[0] * FPS).ceil() as usize..(danced[64] * FPS) as usize;
    let phase = timeline
        .beats
        .as_ref()
        .unwrap()
        .phase(frames.end, FPS)
        .unwrap();
    let features = timeline.pulse.as_ref().unwrap().features(frames.end);
    for t in frames.clone() {
        let angle = std::f64::consts::TAU * phase[t];
        let row = |row: usize| f64::from(features[row * frames.end + t]);
        assert!((row(0) - (4.0 * angle).sin()).abs() < 1e-4, "{t}");
        assert!((row(1) - (4.0 * angle).cos()).abs() < 1e-4, "{t}");
        assert!((row(2) - angle.sin()).abs() < 1e-4, "{t}");
        assert!((row(3) - angle.cos()).abs() < 1e-4 && row(4) == 1.0, "{t}");
    }
}

#[test]
fn the_stated_count_settles_the_octave() {
    // Off-beats nearly as strong as the beats, at 69 beats a minute.
    let length = 26.0 / FPS;
    let beats: Vec<f64> = (0..80).map(|k| 0.4 + length * f64::from(k)).collect();
    let off_beats = beats.iter().map(|s| (s + length / 2.0, 0.9));
    let song = song(&[beats_of(&beats), off_beats.collect()].concat(), 71.0);
    assert!(
        song.beats.frames.len() > 150,
        "{} beats",
        song.beats.frames.len()
    );
    let timeline = laid(stated(64.0, beats[2], beats[66]), 64.0, &song);
    let report = timeline.report.as_ref().expect("a report");
    assert_eq!((report.grid, report.tracked_beats), (Grid::Tracked, 64));
    assert!((report.tracked_tempo - 69.2).abs() < 0.5, "{report:?}");
    assert!(
        timeline.notes[0].contains("beats were tracked at 138.5"),
        "{:?}",
        timeline.notes
    );
    let segment_beats = timeline.segment_beats.as_ref().expect("beats");
    assert!((segment_beats.moment(50.0) - beats[52]).abs() < 1.5 / FPS);
}

#[test]
fn a_count_off_by_one_is_laid_and_one_off_by_five_percent_is_not() {
    let (song, danced) = slowing();
    let one_less = laid(stated(63.0, danced[0], danced[64]), 63.0, &song);
    assert_eq!(one_less.report.as_ref().unwrap().grid, Grid::Tracked);
    let segment_beats = one_less.segment_beats.as_ref().expect("beats");
    // Counted from the start: the last unit ends a beat early.
    assert!((segment_beats.moment(63.0) - danced[63]).abs() < 1.5 / FPS);

    let grid = stated(61.0, danced[0], danced[64]);
    let even = laid(grid, 61.0, &song);
    let report = even.report.as_ref().expect("a report");
    assert_eq!(report.grid, Grid::Uniform);
    assert_eq!(report.concentration, report.uniform_concentration);
    let note = &even.notes[0];
    assert!(
        note.starts_with("64 beats are tracked where 61.0 are stated"),
        "{note}"
    );
    assert!(note.ends_with("aligned with even beats"), "{note}");
    let segment_beats = even.segment_beats.as_ref().expect("beats");
    assert!((segment_beats.moment(61.0) - danced[64]).abs() < 1e-9);
    // The stated beats are still a feature, with unknown bars.
    assert_eq!(even.pulse.as_ref().expect("beats").bars(), None);

    let wanted = Timeline::of_segments(grid, 61.0, Some(&song), Some(Grid::Tracked));
    let problem = wanted.err().expect("a refusal");
    assert!(problem.contains("grid = \"uniform\""), "{problem}");
    let grid = stated(64.0, danced[0], danced[64]);
    let uniform = Timeline::of_segments(grid, 64.0, Some(&song), Some(Grid::Uniform));
    let uniform = uniform.expect("a timeline");
    assert!(uniform.notes.is_empty() && matches!(uniform.beats, Some(Beats::Grid(_))));
}

#[test]
fn a_song_that_ends_early_is_held_against_what_it_plays() {
    let (_, danced) = slowing();
    let song = song(&beats_of(&danced[..64]), danced[64]);
    // Twice the number of the song's beats, at the tempo of the song.
    let end = danced[0] + 2.0 * (danced[64] - danced[0]);
    let timeline = laid(stated(128.0, danced[0], end), 128.0, &song);
    let report = timeline.report.as_ref().expect("a report");
    assert!((report.stated_beats - 64.0).abs() < 0.1, "{report:?}");
    assert_eq!(report.grid, Grid::Tracked, "{report:?}");
    let segment_beats = timeline.segment_beats.as_ref().expect("beats");
    assert!((segment_beats.moment(60.0) - danced[60]).abs() < 1.5 / FPS);
}

#[test]
fn without_a_song_or_its_beats_there_are_even_beats() {
    let grid = stated(16.0, 1.0, 9.0);
    let alone = Timeline::of_segments(grid, 16.0, None, None).expect("a timeline");
    assert!(alone.report.is_none() && alone.notes.is_empty() && alone.pulse.is_none());
    assert_eq!(alone.segment_beats.as_ref().unwrap().moment(4.0), 3.0);
    let silent = laid(grid, 16.0, &song(&[], 12.0));
    assert!(
        silent.notes[0].starts_with("no beats are tracked"),
        "{:?}",
        silent.notes
    );
    for song in [None, Some(&song(&[], 12.0))] {
        assert!(Timeline::of_segments(grid, 16.0, song, Some(Grid::Tracked)).is_err());
    }
}

#[test]
fn motion_bends_at_tracked_beats_alone() {
    let (song, danced) = slowing();
    let tracked = laid(stated(64.0, danced[0], danced[64]), 64.0, &song);
    assert_eq!(tracked.knots(2.0, 4.0), [2.0, 3.0, 4.0]);
    assert_eq!(tracked.knots(2.5, 4.25), [2.5, 3.0, 4.0, 4.25]);
    assert_eq!(tracked.knots(2.25, 2.5), [2.25, 2.5]);
    let even = Timeline::of_segments(stated(4.0, 0.0, 2.0), 4.0, None, None).unwrap();
    assert_eq!(even.knots(0.0, 4.0), [0.0, 4.0]);
}

#[test]
fn a_downbeat_turns_the_bars_of_a_recording() {
    let beats: Vec<f64> = (0..40).map(|k| 0.5 + 0.5 * f64::from(k)).collect();
    let song = song(&beats_of(&beats), 24.0);
    let phase = |downbeat| {
        let plan = TakePlan {
            beats_per_bar: Some(3),
            downbeat_seconds: downbeat,
            ..TakePlan::default()
        };
        let timeline = Timeline::of_recording(&plan, Some(&song));
        let bars = timeline.pulse.as_ref().unwrap().bars();
        (timeline.beats.unwrap().phase(600, FPS).unwrap(), bars)
    };
    let (unknown, bars) = phase(None);
    assert_eq!(bars, None);
    let (known, bars) = phase(Some(beats[10] + 0.1));
    assert_eq!(bars.expect("bars").beats_per_bar, 3);
    let at = |phase: &[f64], beat: usize| phase[(beats[beat] * FPS).round() as usize + 1];
    // A frame after its beat: a 45th of the bar.
    assert!((at(&known, 10) - 1.0 / 45.0).abs() < 0.01);
    assert!((at(&unknown, 9) - 1.0 / 45.0).abs() < 0.01);
    assert!((at(&unknown, 10) - 1.0 / 45.0 - 1.0 / 3.0).abs() < 0.01);
}
