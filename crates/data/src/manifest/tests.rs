use super::*;
use crate::{AudioGroup, Digest, Side, StoreConfig};
use polars::df;
use polars::prelude::{Column, ParquetWriter};
use proptest::prelude::*;

pub(in crate::manifest) fn row(id: &str) -> ManifestRow {
    ManifestRow {
        id: id.to_owned(),
        motion_source: "dance.bvh".to_owned(),
        audio_source: Some("song.mp3".to_owned()),
        first_frame: -30,
        frames: 120,
        fps: 30.0,
        beats: Some(8.5),
        tempo: Some(126.3),
        split: Some(Side::Validation),
        motion_bytes: 12_128,
        motion_sha256: Digest::of(b"motion"),
        audio_bytes: 40_000,
        audio_sha256: Digest::of(b"audio"),
        audio_features: Some(vec![AudioGroup::Ccmotion, AudioGroup::Beats]),
        label: Some("cha-cha".to_owned()),
        flags: vec![Flag::JoinedUnits, Flag::FilledGaps],
    }
}

fn reread(bytes: &[u8]) -> Result<Option<Vec<ManifestRow>>, Error> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(MANIFEST), bytes).unwrap();
    let source = folder.path().display().to_string();
    read(&Store::open(&source, &StoreConfig::default()).unwrap())
}

#[test]
fn what_is_written_is_read_and_equal_rows_make_equal_bytes() {
    let alone = ManifestRow {
        audio_source: None,
        beats: None,
        tempo: None,
        split: None,
        audio_features: None,
        label: None,
        flags: vec![Flag::NoAudio, Flag::NoBeats],
        ..row("a")
    };
    let rows = vec![row("b"), alone];
    let bytes = table::encode(rows.clone()).unwrap();
    let read = reread(&bytes).unwrap().unwrap();
    assert_eq!(read, [rows[1].clone(), rows[0].clone()]);
    assert_eq!(bytes, table::encode(rows).unwrap());
    assert_eq!(read[0].id, "a");
}

#[test]
fn a_manifest_without_labels_has_no_column_of_them() {
    let unlabelled = |id| ManifestRow {
        label: None,
        ..row(id)
    };
    let columns = |rows| {
        let bytes = table::encode(rows).unwrap();
        table::decode(bytes, None).unwrap().width()
    };
    let without = columns(vec![unlabelled("a"), unlabelled("b")]);
    assert_eq!(columns(vec![unlabelled("a"), row("b")]), without + 1);
}

#[test]
fn ids_that_lead_elsewhere_and_broken_columns_are_refused() {
    for (id, expected) in [
        ("../a", "no slash"),
        ("", "empty part"),
        ("/etc", "no slash"),
    ] {
        let bytes = table::encode(vec![row(id)]).unwrap();
        let message = reread(&bytes).unwrap_err().to_string();
        assert!(message.contains(expected), "{id}: {message}");
    }
    let twice = table::encode(vec![row("a"), row("a")]).unwrap();
    let message = reread(&twice).unwrap_err().to_string();
    assert!(message.contains("occurs twice"), "{message}");
    let mut bytes = Vec::new();
    let mut frame = df!("id" => ["a"], "motion_sha256" => ["12"]).unwrap();
    ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
    let message = reread(&bytes).unwrap_err().to_string();
    assert!(
        message.contains("column `audio_sha256` is missing"),
        "{message}"
    );
    assert!(reread(b"PAR1").is_err());
}

/// Counts are zigzag numbers, whose lowest bit is the sign. A page of -2 values requested more
/// memory than the machine has.
#[test]
fn no_flipped_sign_in_the_first_columns_is_fatal() {
    let whole = table::encode(vec![row("a"), row("b")]).unwrap();
    let mut refused = 0;
    for place in 0..whole.len() / 4 {
        let mut bytes = whole.clone();
        bytes[place] ^= 1;
        if let Err(error) = parse(bytes, "flipped") {
            refused += usize::from(error.to_string().contains("negative size or count"));
        }
    }
    assert!(refused > 0);
}

/// 2000 cells share one dictionary text.
#[test]
fn shared_texts_are_bounded() {
    let mut frame = df!("id" => vec!["long".repeat(5000); 2000]).unwrap();
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
    assert!(bytes.len() < 30_000);
    let message = parse(bytes, "long").unwrap_err().to_string();
    assert!(message.contains("40000000 bytes of text"), "{message}");
}

#[test]
fn a_selection_keeps_columns_that_others_added() {
    let mut frame = table::table(&[row("a"), row("b")]).unwrap();
    frame
        .with_column(Column::new("dancer".into(), ["kim", "lou"]))
        .unwrap();
    let selection = Selection { frame };
    let chosen = selection.filter("dancer = lou").unwrap();
    assert_eq!(chosen.texts("id").unwrap(), ["b"]);
    assert_eq!(chosen.numbers("tempo").unwrap(), [Some(126.3)]);
    assert!(chosen.texts("nobody").is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn damaged_manifests_are_refused_not_fatal(place in 0usize..3000, byte: u8, keep in 0.0..1.0f64) {
        let mut bytes = table::encode(vec![row("a"), row("b")]).unwrap();
        let length = bytes.len();
        bytes[place % length] = byte;
        let _ = parse(bytes.clone(), "damaged");
        bytes.truncate((length as f64 * keep) as usize);
        let _ = parse(bytes, "damaged");
    }
}

#[test]
fn columns_of_any_kind_are_written_and_selected() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().display().to_string();
    let store = Store::open(&source, &StoreConfig::default()).unwrap();
    let texts =
        |values: [Option<&str>; 3]| Cells::Texts(values.map(|v| v.map(str::to_owned)).into());
    let columns = vec![
        ("id".to_owned(), texts([Some("a"), Some("b"), Some("c")])),
        (
            "style".to_owned(),
            texts([Some("happy"), None, Some("sad")]),
        ),
        ("frames".to_owned(), Cells::Integers(vec![40, 196, 80])),
        ("seconds".to_owned(), Cells::Numbers(vec![2.0, 9.8, 4.0])),
        ("mirrored".to_owned(), Cells::Flags(vec![false, true, true])),
    ];
    write_columns(&store, columns.clone()).unwrap();
    let all = Selection::read(&store).unwrap().unwrap();
    assert_eq!(all.len(), 3);
    assert_eq!(all.texts("style").unwrap(), ["happy", "", "sad"]);
    assert_eq!(
        all.numbers("seconds").unwrap(),
        [Some(2.0), Some(9.8), Some(4.0)]
    );
    let chosen = all.filter("mirrored = true and frames < 100").unwrap();
    assert_eq!(chosen.texts("id").unwrap(), ["c"]);
    let mut uneven = columns.clone();
    uneven.push(("odd".to_owned(), Cells::Integers(vec![1])));
    assert!(write_columns(&store, uneven).is_err());
    let twice = vec![columns[2].clone(), columns[2].clone()];
    assert!(write_columns(&store, twice).is_err());
}
