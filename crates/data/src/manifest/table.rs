//! Conversion between manifest rows and Parquet tables.

use std::collections::HashSet;
use std::env;
use std::io::Cursor;
use std::thread::available_parallelism;

use kinegrad_audio::guard::guarded;
use polars::df;
use polars::prelude::{
    BooleanChunked, Column, DataType, NewChunkedArray, ParquetReader, ParquetWriter, PolarsError,
    SerReader,
};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{self, StrDeserializer};

pub(super) use polars::prelude::DataFrame;

use super::row::{Flag, ManifestRow};
use super::{Cells, filter, footer};
use crate::layout::check_id;
use crate::{AudioGroup, Digest, Side};

/// The environment variable of polars' threads.
const THREADS: &str = "POLARS_MAX_THREADS";

/// The optional column of labels.
const LABEL_COLUMN: &str = "label";

/// The Parquet file of `rows`, sorted by id.
pub(super) fn encode(mut rows: Vec<ManifestRow>) -> Result<Vec<u8>, String> {
    rows.sort_unstable_by(|a, b| a.id.cmp(&b.id));
    written(table(&rows))
}

fn written(frame: Result<DataFrame, PolarsError>) -> Result<Vec<u8>, String> {
    must_be_few_threads(env::var(THREADS).ok())?;
    let mut bytes = Vec::new();
    frame
        .and_then(|mut frame| ParquetWriter::new(&mut bytes).finish(&mut frame))
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// The Parquet file of these columns.
pub(super) fn encode_columns(columns: Vec<(String, Cells)>) -> Result<Vec<u8>, String> {
    let columns = columns.into_iter().map(|(name, cells)| {
        let name = name.into();
        match cells {
            Cells::Texts(values) => Column::new(name, values),
            Cells::Integers(values) => Column::new(name, values),
            Cells::Numbers(values) => Column::new(name, values),
            Cells::Flags(values) => Column::new(name, values),
        }
    });
    written(DataFrame::new_infer_height(columns.collect()))
}

/// The `wanted` columns of a Parquet file, or all; or the file's error.
pub(super) fn decode(bytes: Vec<u8>, wanted: Option<&[&str]>) -> Result<DataFrame, String> {
    must_be_few_threads(env::var(THREADS).ok())?;
    let most_text = footer::most_unpacked(bytes.len());
    // polars panics on some damaged pages.
    let decoded = guarded(|| {
        let file = footer::rewritten(bytes, wanted)?;
        let reader = ParquetReader::new(Cursor::new(file));
        let frame = reader.finish().map_err(|e| e.to_string())?;
        // polars does not compare the lengths of columns.
        let height = frame.height();
        if let Some(column) = frame.columns().iter().find(|c| c.len() != height) {
            return Err(format!("column `{}` is cut off", column.name()));
        }
        // Cells share the text of a dictionary until rows copy the text.
        let text: usize = frame.columns().iter().map(text_bytes).sum();
        if text > most_text {
            return Err(format!("{text} bytes of text, {most_text} allowed"));
        }
        Ok(frame)
    });
    decoded
        .unwrap_or_else(|| Err("its parts contradict each other".to_owned()))
        .map_err(|reason| format!("not a readable Parquet file: {reason}"))
}

/// Rejects more threads than this process has cores: polars starts all of them.
fn must_be_few_threads(asked: Option<String>) -> Result<(), String> {
    let cores = available_parallelism().map_or(1, usize::from);
    match asked.and_then(|number| number.parse::<u64>().ok()) {
        Some(threads) if threads > cores as u64 => Err(format!(
            "{THREADS} is {threads}, allowed: 1 to {cores}, the cores of this process"
        )),
        _ => Ok(()),
    }
}

/// Total bytes of a text column's cells.
fn text_bytes(column: &Column) -> usize {
    match (column.str(), column.binary()) {
        (Ok(texts), _) => texts.iter().flatten().map(str::len).sum(),
        (_, Ok(bytes)) => bytes.iter().flatten().map(<[u8]>::len).sum(),
        _ => 0,
    }
}

/// The columns of `rows`.
pub(super) fn table(rows: &[ManifestRow]) -> Result<DataFrame, PolarsError> {
    let texts = |value: &dyn Fn(&ManifestRow) -> String| rows.iter().map(value).collect::<Vec<_>>();
    let some_texts =
        |value: &dyn Fn(&ManifestRow) -> Option<String>| rows.iter().map(value).collect::<Vec<_>>();
    let integers = |value: &dyn Fn(&ManifestRow) -> i64| rows.iter().map(value).collect::<Vec<_>>();
    let numbers =
        |value: &dyn Fn(&ManifestRow) -> Option<f64>| rows.iter().map(value).collect::<Vec<_>>();
    let mut frame = df!(
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
        "audio_features" => some_texts(&|row| row.audio_features.as_deref().map(listed)),
        "flags" => texts(&|row| {
            row.flags.iter().map(Flag::to_string).collect::<Vec<_>>().join(",")
        }),
    )?;
    // The column exists only if a phrase has a label.
    if rows.iter().any(|row| row.label.is_some()) {
        let labels = some_texts(&|row| row.label.clone());
        frame.with_column(Column::new(LABEL_COLUMN.into(), labels))?;
    }
    Ok(frame)
}

/// The rows of a Parquet file, or the file's error. Only ids and checksums are required, so
/// manifests can be written by hand.
pub(super) fn rows(bytes: Vec<u8>) -> Result<Vec<ManifestRow>, String> {
    let written = table(&[]).map_err(|error| error.to_string())?;
    let columns = written.columns().iter().map(|c| c.name().as_str());
    let columns: Vec<&str> = columns.chain([LABEL_COLUMN]).collect();
    let frame = &decode(bytes, Some(&columns))?;
    for name in ["id", "motion_sha256", "audio_sha256"] {
        let missing = |_| format!("column `{name}` is missing");
        frame.column(name).map_err(missing)?;
    }
    let height = frame.height();
    let texts = |name| {
        frame
            .column(name)
            .map_or_else(|_| Ok(vec![None; height]), texts)
    };
    let numbers = |name| {
        frame
            .column(name)
            .map_or_else(|_| Ok(vec![None; height]), numbers)
    };
    let ids = texts("id")?;
    let motion_sha256 = texts("motion_sha256")?;
    let audio_sha256 = texts("audio_sha256")?;
    let motion_source = texts("motion_source")?;
    let audio_source = texts("audio_source")?;
    let split = texts("split")?;
    let flags = texts("flags")?;
    let audio_features = texts("audio_features")?;
    let label = texts(LABEL_COLUMN)?;
    let first_frame = numbers("first_frame")?;
    let frames = numbers("frames")?;
    let fps = numbers("fps")?;
    let beats = numbers("beats")?;
    let tempo = numbers("tempo")?;
    let motion_bytes = numbers("motion_bytes")?;
    let audio_bytes = numbers("audio_bytes")?;
    let integer = |number: Option<f64>| number.unwrap_or_default() as i64;
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
            let split = split[row].as_deref().filter(|split| !split.is_empty());
            let split = split.map(|split| {
                let wrong = "found; train, validation or nothing allowed";
                named::<Side>(split).ok_or(format!("phrase `{id}`: split `{split}` {wrong}"))
            });
            let groups = audio_features[row].as_deref().map(|listed| {
                let named = |group: &str| {
                    let wrong = "found; ccmotion and beats allowed, comma-separated";
                    let problem = || format!("phrase `{id}`: audio_features `{listed}` {wrong}");
                    named::<AudioGroup>(group).ok_or_else(problem)
                };
                listed.split(',').map(named).collect::<Result<_, String>>()
            });
            let flags = flags[row].as_deref().unwrap_or_default().split(',');
            Ok(ManifestRow {
                motion_source: motion_source[row].clone().unwrap_or_default(),
                audio_source: audio_source[row].clone(),
                first_frame: integer(first_frame[row]),
                frames: integer(frames[row]),
                fps: fps[row].unwrap_or(kinegrad_motion::FPS),
                beats: beats[row],
                tempo: tempo[row],
                split: split.transpose()?,
                motion_bytes: integer(motion_bytes[row]),
                motion_sha256: digest("motion_sha256", &motion_sha256[row])?,
                audio_bytes: integer(audio_bytes[row]),
                audio_sha256: digest("audio_sha256", &audio_sha256[row])?,
                audio_features: groups.transpose()?,
                label: label[row].clone().filter(|label| !label.is_empty()),
                flags: flags.filter_map(named).collect(),
                id,
            })
        })
        .collect()
}

/// The rows of a table that match a condition, or the condition's error.
pub(super) fn filter(frame: &DataFrame, condition: &str) -> Result<DataFrame, String> {
    let rows = filter::rows(condition, frame)?;
    let mask = BooleanChunked::from_slice("chosen".into(), &rows);
    frame.filter(&mask).map_err(|error| error.to_string())
}

/// Groups of audio features as a cell.
fn listed(groups: &[AudioGroup]) -> String {
    let names = groups.iter().map(|group| match group {
        AudioGroup::Ccmotion => "ccmotion",
        AudioGroup::Beats => "beats",
    });
    names.collect::<Vec<_>>().join(",")
}

/// The value that serializes as `name`.
fn named<'a, T: Deserialize<'a>>(name: &'a str) -> Option<T> {
    let name: StrDeserializer<value::Error> = name.into_deserializer();
    T::deserialize(name).ok()
}

/// The values of a column of text.
pub(super) fn texts(column: &Column) -> Result<Vec<Option<String>>, String> {
    let column = cast(column, &DataType::String)?;
    let texts = column.str().map_err(|error| error.to_string())?;
    Ok(texts.iter().map(|text| text.map(str::to_owned)).collect())
}

/// The values of a column of numbers.
pub(super) fn numbers(column: &Column) -> Result<Vec<Option<f64>>, String> {
    let column = cast(column, &DataType::Float64)?;
    let numbers = column.f64().map_err(|error| error.to_string())?;
    Ok(numbers.iter().collect())
}

/// A column cast to the type `to`.
pub(super) fn cast(column: &Column, to: &DataType) -> Result<Column, String> {
    let broken = |error| format!("column `{}`: {error}", column.name());
    column.cast(to).map_err(broken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_those_of_the_machine_at_most() {
        let error = must_be_few_threads(Some("100000".into())).unwrap_err();
        assert!(
            error.starts_with("POLARS_MAX_THREADS is 100000, allowed: 1 to "),
            "{error}"
        );
        for asked in [None, Some("1"), Some("many")] {
            must_be_few_threads(asked.map(String::from)).unwrap();
        }
    }
}
