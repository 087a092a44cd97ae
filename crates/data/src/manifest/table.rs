//! Rows of a manifest as a table, and a table as rows.

use std::collections::HashSet;

use polars::df;
use polars::prelude::{DataFrame, DataType, PolarsError};

use super::row::{Flag, ManifestRow};
use crate::layout::check_id;
use crate::{Digest, Side};

/// The columns of `rows`.
pub(super) fn table(rows: &[ManifestRow]) -> Result<DataFrame, PolarsError> {
    let texts = |value: &dyn Fn(&ManifestRow) -> String| rows.iter().map(value).collect::<Vec<_>>();
    let some_texts =
        |value: &dyn Fn(&ManifestRow) -> Option<String>| rows.iter().map(value).collect::<Vec<_>>();
    let integers = |value: &dyn Fn(&ManifestRow) -> i64| rows.iter().map(value).collect::<Vec<_>>();
    let numbers =
        |value: &dyn Fn(&ManifestRow) -> Option<f64>| rows.iter().map(value).collect::<Vec<_>>();
    df!(
        "id" => texts(&|row| row.id.clone()),
        "motion_source" => texts(&|row| row.motion_source.clone()),
        "audio_source" => some_texts(&|row| row.audio_source.clone()),
        "first_frame" => integers(&|row| row.first_frame),
        "frames" => integers(&|row| row.frames),
        "fps" => numbers(&|row| Some(row.fps)),
        "beats" => numbers(&|row| row.beats),
        "tempo" => numbers(&|row| row.tempo),
        "split" => some_texts(&|row| row.split.map(|side| side.to_string())),
        "motion_bytes" => integers(&|row| row.motion_bytes),
        "motion_sha256" => texts(&|row| row.motion_sha256.to_string()),
        "audio_bytes" => integers(&|row| row.audio_bytes),
        "audio_sha256" => texts(&|row| row.audio_sha256.to_string()),
        "flags" => texts(&|row| {
            row.flags.iter().map(Flag::to_string).collect::<Vec<_>>().join(",")
        }),
    )
}

/// The rows of a table; in an error, what is wrong with it. Only ids and checksums must be there:
/// a manifest written by hand need not know the rest.
pub(super) fn rows(frame: &DataFrame) -> Result<Vec<ManifestRow>, String> {
    for name in ["id", "motion_sha256", "audio_sha256"] {
        let missing = |_| format!("column `{name}` is missing");
        frame.column(name).map_err(missing)?;
    }
    let (texts, numbers) = (|name| texts(frame, name), |name| numbers(frame, name));
    let ids = texts("id")?;
    let motion_sha256 = texts("motion_sha256")?;
    let audio_sha256 = texts("audio_sha256")?;
    let motion_source = texts("motion_source")?;
    let audio_source = texts("audio_source")?;
    let split = texts("split")?;
    let flags = texts("flags")?;
    let first_frame = numbers("first_frame")?;
    let frames = numbers("frames")?;
    let fps = numbers("fps")?;
    let beats = numbers("beats")?;
    let tempo = numbers("tempo")?;
    let motion_bytes = numbers("motion_bytes")?;
    let audio_bytes = numbers("audio_bytes")?;
    let whole = |number: Option<f64>| number.unwrap_or_default() as i64;
    let mut seen = HashSet::new();
    (0..frame.height())
        .map(|row| {
            let id = ids[row].clone().ok_or(format!("row {row}: no id"))?;
            check_id(&id).map_err(|error| format!("row {row}: {error}"))?;
            if !seen.insert(id.clone()) {
                return Err(format!("row {row}: id `{id}` occurs twice"));
            }
            let digest = |column: &str, text: &Option<String>| {
                let text = text.as_deref().unwrap_or_default();
                Digest::parse(text).ok_or_else(|| {
                    format!("phrase `{id}`: {column} `{text}` found, 64 hexadecimal digits allowed")
                })
            };
            let split = match split[row].as_deref() {
                None | Some("") => None,
                Some("train") => Some(Side::Train),
                Some("validation") => Some(Side::Validation),
                Some(other) => {
                    return Err(format!(
                        "phrase `{id}`: split `{other}` found; train, validation or nothing allowed"
                    ));
                }
            };
            let flags = flags[row].as_deref().unwrap_or_default().split(',');
            let flags =
                flags.filter_map(|text| Flag::ALL.into_iter().find(|f| f.to_string() == text));
            Ok(ManifestRow {
                motion_source: motion_source[row].clone().unwrap_or_default(),
                audio_source: audio_source[row].clone(),
                first_frame: whole(first_frame[row]),
                frames: whole(frames[row]),
                fps: fps[row].unwrap_or(kinegrad_motion::FPS),
                beats: beats[row],
                tempo: tempo[row],
                split,
                motion_bytes: whole(motion_bytes[row]),
                motion_sha256: digest("motion_sha256", &motion_sha256[row])?,
                audio_bytes: whole(audio_bytes[row]),
                audio_sha256: digest("audio_sha256", &audio_sha256[row])?,
                flags: flags.collect(),
                id,
            })
        })
        .collect()
}

/// The values of a column of text; all missing where there is no such column.
pub(super) fn texts(frame: &DataFrame, name: &str) -> Result<Vec<Option<String>>, String> {
    let broken = |error: PolarsError| format!("column `{name}`: {error}");
    let Ok(column) = frame.column(name) else {
        return Ok(vec![None; frame.height()]);
    };
    let texts = column.cast(&DataType::String).map_err(broken)?;
    let texts = texts.str().map_err(broken)?;
    Ok(texts.iter().map(|text| text.map(str::to_owned)).collect())
}

/// The values of a column of numbers; all missing where there is no such column.
pub(super) fn numbers(frame: &DataFrame, name: &str) -> Result<Vec<Option<f64>>, String> {
    let broken = |error: PolarsError| format!("column `{name}`: {error}");
    let Ok(column) = frame.column(name) else {
        return Ok(vec![None; frame.height()]);
    };
    let numbers = column.cast(&DataType::Float64).map_err(broken)?;
    Ok(numbers.f64().map_err(broken)?.iter().collect())
}
