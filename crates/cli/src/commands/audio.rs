//! `kinegrad audio`

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_audio::Features;
use kinegrad_data::{AudioFeatures, AudioLayout, check_id, write_song_features};
use kinegrad_report::{Panel, table};
use kinegrad_train::Error;
use kinegrad_train::song::song_features;
use rayon::prelude::*;

use crate::args::FeaturesArguments;
use crate::io::{file_stem, must_be_new};
use crate::output::{self, draw};

/// Output files of a song.
const FEATURES: &str = "features.npz";
const PICTURE: &str = "features.png";

/// A song and its output folder.
struct Song {
    path: PathBuf,
    folder: PathBuf,
}

/// Writes the features of each song. After all songs, the exit code is 2 if a song cannot be used.
pub fn features(arguments: FeaturesArguments) -> Result<ExitCode, Error> {
    let songs = songs(&arguments)?;
    for (option, seconds, allowed) in [
        ("--start", Some(arguments.start), "0 seconds or more"),
        ("--duration", arguments.duration, "more than 0 seconds"),
    ] {
        let is_least = |seconds: &f64| *seconds > 0.0 || (*seconds == 0.0 && option == "--start");
        if let Some(seconds) = seconds.filter(|seconds| !(seconds.is_finite() && is_least(seconds)))
        {
            let message = format!("`{option}` is {seconds}, allowed: {allowed}");
            let hint = "for example `--start 30 --duration 10`";
            return Err(Error::usage(message, hint));
        }
    }
    let names = [Some(FEATURES), arguments.plot.then_some(PICTURE)];
    let names = || names.into_iter().flatten();
    let files = songs
        .iter()
        .flat_map(|song| names().map(move |name| song.folder.join(name)));
    let files: Vec<PathBuf> = files.collect();
    must_be_new(&files, &[], arguments.overwrite, "--out")?;
    let each = songs.par_iter().map(|song| one(song, &arguments));
    let mut code = 0;
    let mut rows = Vec::new();
    for row in each.collect::<Vec<_>>() {
        match row {
            Ok(row) => rows.push(row),
            Err(error) => {
                output::failure(&error);
                code = error.exit_code();
            }
        }
    }
    if !rows.is_empty() {
        let header = ["song", "seconds", "frames", "tempo", "beats", "file"];
        show!("{}", table(header, rows));
    }
    Ok(ExitCode::from(code))
}

/// The songs with their output folders.
fn songs(arguments: &FeaturesArguments) -> Result<Vec<Song>, Error> {
    let mut songs: Vec<Song> = Vec::new();
    for path in &arguments.songs {
        let name = file_stem(path);
        if let Err(error) = check_id(&name) {
            let path = path.display();
            let message = format!("{path}: the name cannot be that of a folder: {error}");
            return Err(Error::usage(message, "rename the song"));
        }
        let folder = arguments.out.join(name);
        if songs.iter().any(|song| song.folder == folder) {
            let message = format!("two songs would be written to {}", folder.display());
            let hint = "rename one of them, or give each its own `--out`";
            return Err(Error::usage(message, hint));
        }
        songs.push(Song {
            path: path.clone(),
            folder,
        });
    }
    Ok(songs)
}

fn one(song: &Song, arguments: &FeaturesArguments) -> Result<[String; 6], Error> {
    let known = arguments.beats.known();
    let (waveform, features) = song_features(&song.path, &known)?;
    if let Some(damage) = waveform.damage() {
        tell!("warning: {}: {damage}", song.path.display());
    }
    if let Some(note) = waveform.note() {
        tell!("{}: {note}", song.path.display());
    }
    let layout = AudioLayout {
        beats: arguments.with_beats,
    };
    let pulse = known.pulse(&features);
    let frames = cut(features.frames(), song, arguments)?;
    let stacked = AudioFeatures::of_song(&features, layout, pulse.as_ref()).slice(frames.clone());
    let features = features.slice(frames);
    let target = song.folder.join(FEATURES);
    let beats = features.beats();
    write_song_features(&target, &features, &stacked)?;
    if arguments.plot {
        picture(&features, &song.folder.join(PICTURE))?;
    }
    let seconds = match (arguments.start, arguments.duration) {
        (0.0, None) => waveform.samples.len() as f64 / f64::from(kinegrad_audio::SAMPLE_RATE),
        _ => features.frames() as f64 / kinegrad_audio::FPS,
    };
    Ok([
        song.path.display().to_string(),
        format!("{seconds:.2}"),
        features.frames().to_string(),
        format!("{:.1}", beats.tempo),
        beats.frames.len().to_string(),
        target.display().to_string(),
    ])
}

/// The frames of `--start` and `--duration`.
fn cut(frames: usize, song: &Song, arguments: &FeaturesArguments) -> Result<Range<usize>, Error> {
    let start = arguments.start * kinegrad_audio::FPS;
    if frames as f64 - start < 1.0 {
        let seconds = frames as f64 / kinegrad_audio::FPS;
        let (start, path) = (arguments.start, song.path.display());
        let message = format!("`--start` is {start}, the song {path} has {seconds:.1} seconds");
        return Err(Error::usage(message, "start earlier"));
    }
    let start = start.round() as usize;
    // At least one frame.
    let length = |seconds: f64| ((seconds * kinegrad_audio::FPS).round() as usize).max(1);
    let length = arguments.duration.map_or(frames, length);
    Ok(start..frames.min(start.saturating_add(length)))
}

/// All features over time, with the beats.
fn picture(features: &Features, out: &Path) -> Result<(), Error> {
    use kinegrad_audio::features::{CENTROID, CHROMA, MEL, MFCC, ONSET, RMS};
    let seconds = features.frames() as f64 / kinegrad_audio::FPS;
    let beats = features.beats().times();
    let row = |row: usize| -> Vec<f64> {
        let values = features.rows(row..row + 1).iter();
        values.map(|&value| f64::from(value)).collect()
    };
    let heat = |title, rows: Range<usize>| Panel::heat(title, rows.map(row).collect(), seconds);
    let curves = |title, tracks: &[(&'static str, usize)]| {
        let tracks = tracks.iter().map(|&(name, index)| (name, row(index)));
        Panel::over_time(title, kinegrad_audio::FPS, tracks)
    };
    let panels = [
        heat("mel", MEL),
        heat("chroma (C at the bottom), with beats", CHROMA).with_marks(&beats),
        heat("mfcc", MFCC),
        curves(
            "rms and spectral centroid",
            &[("rms", RMS), ("centroid", CENTROID)],
        ),
        curves("onset strength and beats", &[("onset", ONSET)]).with_marks(&beats),
    ];
    let panels = panels.map(|panel| panel.spanning(0.0..seconds));
    draw(&panels, 1, (1100, 200), out)
}
