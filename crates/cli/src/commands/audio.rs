//! `kinegrad audio`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_audio::{Features, decode, extract};
use kinegrad_data::{check_id, write_song_features};
use rayon::prelude::*;

use crate::args::FeaturesArguments;
use crate::failure::{Failure, UsageError};
use crate::output::table;
use crate::picture::{Panel, draw};

/// A song on its way to features.
struct Song {
    path: PathBuf,
    folder: PathBuf,
}

/// Computes the features of each song and writes them; exit code 2 if a song cannot be used, after
/// the others have been done.
pub fn features(arguments: FeaturesArguments) -> Result<ExitCode, Failure> {
    let songs = songs(&arguments)?;
    let rows: Vec<Result<Vec<String>, Failure>> = songs
        .par_iter()
        .map(|song| one(song, arguments.plot))
        .collect();
    let mut printed = vec![
        ["song", "seconds", "frames", "tempo", "beats", "file"]
            .map(String::from)
            .to_vec(),
    ];
    let mut code = 0;
    for row in rows {
        match row {
            Ok(row) => printed.push(row),
            Err(failure) => {
                tell!("{failure}");
                code = failure.exit_code;
            }
        }
    }
    if printed.len() > 1 {
        say!("{}", table(printed));
    }
    Ok(ExitCode::from(code))
}

/// The songs and where each one's features go.
fn songs(arguments: &FeaturesArguments) -> Result<Vec<Song>, UsageError> {
    let mut songs: Vec<Song> = Vec::new();
    for path in &arguments.songs {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        if let Err(error) = check_id(&name) {
            let message = format!(
                "{}: its folder would be no plain name: {error}",
                path.display()
            );
            return Err(UsageError::new(message, "rename the song"));
        }
        let folder = arguments.out.join(&*name);
        if songs.iter().any(|song| song.folder == folder) {
            let message = format!("two songs would be written to {}", folder.display());
            return Err(UsageError::new(
                message,
                "rename one of them, or give each its own --out",
            ));
        }
        songs.push(Song {
            path: path.clone(),
            folder,
        });
    }
    Ok(songs)
}

fn one(song: &Song, plot: bool) -> Result<Vec<String>, Failure> {
    let waveform = decode(&song.path)?;
    if let Some(damage) = waveform.damage() {
        tell!("warning: {}: {damage}", song.path.display());
    }
    let features = extract(&waveform.samples).map_err(|error| unusable(&song.path, &error))?;
    let target = song.folder.join("features.npz");
    let beats = features.beats();
    write_song_features(&target, &features)?;
    if plot {
        picture(&features, &song.folder.join("features.png"))?;
    }
    let seconds = waveform.samples.len() as f64 / f64::from(kinegrad_audio::SAMPLE_RATE);
    Ok(vec![
        song.path.display().to_string(),
        format!("{seconds:.2}"),
        features.frames().to_string(),
        format!("{:.1}", beats.tempo),
        beats.frames.len().to_string(),
        target.display().to_string(),
    ])
}

/// An error about a song's samples, with its name.
pub fn unusable(song: &Path, error: &kinegrad_audio::Error) -> UsageError {
    let message = format!("{}: {error}", song.display());
    UsageError::new(message, "write the song again from its source")
}

/// All features over time, with the beats.
fn picture(features: &Features, out: &Path) -> Result<(), Failure> {
    use kinegrad_audio::features::{CENTROID, CHROMA, MEL, MFCC, ONSET, RMS};
    let seconds = features.frames() as f64 / kinegrad_audio::FPS;
    let beats = features.beats().times();
    let rows = |range: std::ops::Range<usize>| -> Vec<Vec<f64>> {
        let row = |row: usize| {
            features
                .rows(row..row + 1)
                .iter()
                .map(|&v| f64::from(v))
                .collect()
        };
        range.map(row).collect()
    };
    let curve = |name: &str, row: usize| {
        let values = features.rows(row..row + 1).iter().enumerate();
        let points = values.map(|(t, &v)| (t as f64 / kinegrad_audio::FPS, f64::from(v)));
        (name.to_owned(), points.collect())
    };
    let panels = [
        Panel::heat("mel", rows(MEL), seconds),
        Panel::heat("chroma (C at the bottom)", rows(CHROMA), seconds).with_marks(&beats),
        Panel::heat("mfcc", rows(MFCC), seconds),
        Panel::lines(
            "rms and spectral centroid",
            "s",
            vec![curve("rms", RMS), curve("centroid", CENTROID)],
        ),
        Panel::lines("onset strength and beats", "s", vec![curve("onset", ONSET)])
            .with_marks(&beats),
    ];
    let panels = panels.map(|panel| panel.spanning(0.0..seconds));
    draw(&panels, 1, (1100, 200), out)
}
