//! `.npy` arrays: reading with every promise of the header checked, and writing.
//!
//! A file is read whole, but never more of it than an array of [`MAX_FRAMES`] could fill, and
//! nothing is allocated on the word of a header.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use kinegrad_motion::{Motion, phrase::CHANNELS};

use crate::{Error, FileError, atomic};

mod header;

use header::{Header, MAX_HEADER_BYTES};

/// Most frames a phrase or song may have: two hours at 30 frames per second. A longer array is
/// refused before it is read.
pub const MAX_FRAMES: usize = 216_000;

/// The hint for a file that is not whole.
pub(crate) const CUT_OFF: &str = "the file is damaged or was cut off: copy or export it again";

/// An array in C order.
#[derive(Debug, PartialEq)]
pub struct Array {
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<f32>,
}

/// Reads the array of float32 or float64 numbers in the `.npy` file at `path`.
///
/// # Errors
/// [`FileError`] for a file that cannot be read or is no such array.
pub fn read_array(path: &Path) -> Result<Array, FileError> {
    let bytes = read_bounded(path, MAX_ARRAY_BYTES)?;
    parse(&bytes, &path.display().to_string())
}

/// Writes an array of this shape as little-endian float32, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_values(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), Error> {
    atomic::write(path, |writer| {
        write_array(&mut *writer, shape, values)?;
        writer.flush()
    })
}

/// The longest file of an array that is no motion: 4096 numbers squared, and a header.
const MAX_ARRAY_BYTES: u64 = 8 * 4096 * 4096 + MAX_HEADER_BYTES as u64;

/// The longest motion file.
pub(crate) const MAX_MOTION_BYTES: u64 = max_bytes(CHANNELS);

/// Most bytes that an array with `rows` values per frame may have in its file.
pub(crate) const fn max_bytes(rows: usize) -> u64 {
    (rows * MAX_FRAMES * 8 + MAX_HEADER_BYTES + 12) as u64
}

/// Reads a motion: `[frames, 25]`, at least two frames, as the dataset stores it.
///
/// # Errors
/// [`FileError`] for a file that cannot be read, another dtype or shape, a cut-off file. Numbers
/// that are not finite pass: they are refused where a phrase is read.
pub fn read_motion(path: &Path) -> Result<Motion, FileError> {
    let bytes = read_bounded(path, MAX_MOTION_BYTES)?;
    parse_motion(&bytes, &path.display().to_string())
}

/// The bytes of the file at `path`, at most one more than `limit`.
pub(crate) fn read_bounded(path: &Path, limit: u64) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(limit + 1).read_to_end(&mut bytes))
        .map_err(FileError::read(path))?;
    Ok(bytes)
}

/// Parses the bytes of a motion's `.npy` file; `file` names it in errors.
///
/// # Errors
/// As [`read_motion`].
pub fn parse_motion(bytes: &[u8], file: &str) -> Result<Motion, FileError> {
    let array = parse(bytes, file)?;
    let shape = array.shape;
    let refused = || FileError::Shape {
        file: file.to_owned(),
        found: format!("{shape:?}"),
        allowed: format!("[frames, {CHANNELS}] with 2 to {MAX_FRAMES} frames"),
    };
    match shape[..] {
        [frames, CHANNELS] if (2..=MAX_FRAMES).contains(&frames) => {
            Motion::new(array.values).map_err(|_| refused())
        }
        _ => Err(refused()),
    }
}

/// Writes `motion` as `[frames, 25]` little-endian float32 in C order, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_motion(path: &Path, motion: &Motion) -> Result<(), Error> {
    atomic::write(path, |writer| writer.write_all(&motion_bytes(motion)))
}

/// The bytes of the `.npy` file that holds `motion`.
pub fn motion_bytes(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_array(&mut bytes, &[motion.frames(), CHANNELS], motion.as_slice())
        .expect("memory takes every byte");
    bytes
}

/// Writes `values` as a `.npy` stream of this `shape`.
pub(crate) fn write_array(
    mut writer: impl Write,
    shape: &[usize],
    values: &[f32],
) -> std::io::Result<()> {
    writer.write_all(&header::write(shape))?;
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    writer.write_all(&bytes)
}

/// Parses the bytes of a `.npy` file; `file` names it in errors.
///
/// # Errors
/// [`FileError`] for bytes that are no array of float32 or float64 numbers.
pub fn parse(bytes: &[u8], file: &str) -> Result<Array, FileError> {
    let mut values = Vec::new();
    let shape = parse_onto(&mut values, bytes, file)?;
    Ok(Array { shape, values })
}

/// Parses the bytes of a `.npy` file and appends its values to `values`; its shape.
pub(crate) fn parse_onto(
    values: &mut Vec<f32>,
    bytes: &[u8],
    file: &str,
) -> Result<Vec<usize>, FileError> {
    let Header {
        double,
        fortran_order,
        shape,
        length,
        data_start,
    } = header::read(bytes, file)?;
    let data = &bytes[data_start..];
    let needed = length.saturating_mul(if double { 8 } else { 4 });
    if data.len() as u64 != needed {
        let found = data.len();
        let problem =
            format!("{found} bytes of data found, {needed} needed for its shape and dtype");
        return Err(FileError::damaged(file, problem, CUT_OFF));
    }
    match (fortran_order, &shape[..]) {
        (true, &[rows, columns]) if length > 0 => {
            let mut stored = Vec::new();
            decode(&mut stored, data, double);
            values.extend((0..rows * columns).map(|i| stored[i % columns * rows + i / columns]));
        }
        (true, [_, _, _, ..]) => {
            return Err(FileError::Shape {
                file: file.to_owned(),
                found: format!("{shape:?}"),
                allowed: "one or two axes".to_owned(),
            });
        }
        _ => decode(values, data, double),
    }
    Ok(shape)
}

/// Appends the little-endian numbers of `data`.
fn decode(values: &mut Vec<f32>, data: &[u8], double: bool) {
    if double {
        let (numbers, _) = data.as_chunks();
        values.extend(
            numbers
                .iter()
                .map(|&number| f64::from_le_bytes(number) as f32),
        );
    } else {
        let (numbers, _) = data.as_chunks();
        values.extend(numbers.iter().map(|&number| f32::from_le_bytes(number)));
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A `.npy` file with any header, for broken files on purpose.
    pub(crate) fn raw(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let text = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }

    #[test]
    fn c_and_fortran_order_and_float64_give_the_same_array() {
        let expected = Array {
            shape: vec![2, 3],
            values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        };
        let c = raw(
            "'<f4'",
            false,
            "(2, 3)",
            &floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        );
        let fortran = raw(
            "'<f4'",
            true,
            "(2, 3)",
            &floats(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]),
        );
        let doubles: Vec<u8> = (1..=6)
            .flat_map(|value| f64::from(value).to_le_bytes())
            .collect();
        assert_eq!(parse(&c, "c").unwrap(), expected);
        assert_eq!(parse(&fortran, "f").unwrap(), expected);
        assert_eq!(
            parse(&raw("'<f8'", false, "(2, 3)", &doubles), "d").unwrap(),
            expected
        );
    }

    #[test]
    fn broken_files_are_named_with_what_was_found() {
        let four = floats(&[0.0; 4]);
        let deep = format!("{}{}", "(".repeat(2000), ")".repeat(2000));
        for (bytes, expected) in [
            (b"no array".to_vec(), "does not begin as one"),
            (
                b"\x93NUMPY\x02\x00\xff\xff\xff".to_vec(),
                "header is cut off",
            ),
            (b"\x93NUMPY\x01\x00\x09\x00{".to_vec(), "header is cut off"),
            (
                b"\x93NUMPY\x02\x00\xff\xff\xff\xff\0\0\0\0".to_vec(),
                "10000 allowed",
            ),
            (
                b"\x93NUMPY\x09\x00\x05\x00\0\0\0\0\0".to_vec(),
                "version 9 found",
            ),
            (
                raw("'<f4'", false, "(4,)", &four[..7]),
                "7 bytes of data found, 16 needed",
            ),
            (
                raw("'<f4'", false, "(3,)", &four),
                "16 bytes of data found, 12 needed",
            ),
            (raw("'>f4'", false, "(4,)", &four), "dtype '>f4' found"),
            (raw("'<i4'", false, "(4,)", &four), "dtype '<i4' found"),
            (
                raw("[('a', '<f4')]", false, "(4,)", &four),
                "dtype [('a', '<f4')",
            ),
            (raw("'|O'", false, "(4,)", &four), "dtype '|O' found"),
            (
                raw("'<f4'", false, "(9999999999, 9999999999)", &four),
                "too large",
            ),
            (
                raw("'<f4'", false, "(999999999, 999999999)", &four),
                "16 bytes of data found",
            ),
            (raw("'<f4'", false, "(-4,)", &four), "negative"),
            (raw("'<f4'", false, &deep, &four), "no whole number"),
        ] {
            let message = parse(&bytes, "file.npy").unwrap_err().to_string();
            assert!(message.starts_with("file.npy: "), "{message}");
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
    }

    #[test]
    fn every_spelling_of_a_header_that_python_reads_is_read() {
        let read = |dictionary: &str| {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((dictionary.len() as u16).to_le_bytes());
            bytes.extend(dictionary.bytes());
            header::read(&bytes, "x")
        };
        for (dictionary, double, fortran_order, shape) in [
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 25), }\n",
                false,
                false,
                &[3, 25][..],
            ),
            (
                "{\"shape\":(3,25),\"fortran_order\":True,\"descr\":\"<f8\"}",
                true,
                true,
                &[3, 25],
            ),
            (
                " { 'descr' : '<f4' , 'shape': ( 3 , ) ,'fortran_order': False } \n",
                false,
                false,
                &[3],
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3L, 25L), }",
                false,
                false,
                &[3, 25],
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': ()}",
                false,
                false,
                &[],
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2, 3,)}",
                false,
                false,
                &[1, 2, 3],
            ),
        ] {
            let header = read(dictionary).unwrap();
            assert_eq!(header.double, double, "{dictionary}");
            assert_eq!(header.fortran_order, fortran_order, "{dictionary}");
            assert_eq!(header.shape, shape, "{dictionary}");
            assert_eq!(header.length, shape.iter().product::<usize>() as u64);
        }
        for (dictionary, expected) in [
            ("", "no dictionary"),
            (
                "{'descr': '<f4', 'fortran_order': False}",
                "no entry 'shape'",
            ),
            (
                "{'descr': '<f4',, 'fortran_order': False, 'shape': (3,)}",
                "no dictionary",
            ),
            (
                "{'descr': '<f4', 'fortran_order': 0, 'shape': (3,)}",
                "fortran_order 0 found",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3)}",
                "shape (3) found",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': [3]}",
                "shape [3] found",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3,,)}",
                "no whole number",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (,)}",
                "no whole number",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (03,)}",
                "no whole number",
            ),
            (
                "{'descr': <f4, 'fortran_order': False, 'shape': (3,)}",
                "dtype <f4 found",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (+3,)}",
                "no whole number",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3,), 'a': 1}",
                "unknown entry 'a'",
            ),
            (
                "{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (3,)}",
                "twice",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (3,}",
                "open",
            ),
            (
                "{'descr': '<f4, 'fortran_order': False, 'shape': (3,)}",
                "open",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': 3,)}",
                "not open",
            ),
        ] {
            let message = read(dictionary).unwrap_err().to_string();
            assert!(
                message.contains(expected),
                "{dictionary}: {message} lacks {expected}"
            );
        }
    }

    #[test]
    fn written_headers_are_those_of_numpy() {
        for (shape, text) in [(&[][..], "()"), (&[7], "(7,)"), (&[3, 25], "(3, 25)")] {
            let bytes = header::write(shape);
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b" \n"));
            let start = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {text}, }}");
            assert!(bytes[10..].starts_with(start.as_bytes()));
            let header = header::read(&bytes, "x").unwrap();
            assert_eq!((&header.shape[..], header.data_start), (shape, bytes.len()));
        }
    }

    #[test]
    fn a_motion_is_written_as_the_dataset_stores_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/trajectory.npy");
        let values: Vec<f32> = (0..75).map(|i| i as f32 / 7.0).collect();
        let written = Motion::new(values.clone()).unwrap();
        write_motion(&path, &written).unwrap();
        assert_eq!(read_motion(&path).unwrap().as_slice(), &values[..]);
        let bytes = std::fs::read(&path).unwrap();
        let header = String::from_utf8_lossy(&bytes[10..80]).into_owned();
        assert!(header.contains("'<f4'") && header.contains("False") && header.contains("(3, 25"));
        assert!(bytes.ends_with(&floats(&values[74..])));
    }

    #[test]
    fn a_motion_of_another_shape_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for (shape, values) in [
            ("(4, 24)", 96),
            ("(100,)", 100),
            ("(1, 25)", 25),
            ("(0, 25)", 0),
        ] {
            let path = folder.path().join("trajectory.npy");
            std::fs::write(
                &path,
                raw("'<f4'", false, shape, &floats(&vec![0.0; values])),
            )
            .unwrap();
            match read_motion(&path) {
                Err(FileError::Shape { allowed, .. }) => assert!(allowed.contains("25")),
                other => panic!("{shape}: {other:?}"),
            }
        }
    }

    proptest! {
        #[test]
        fn any_array_survives_a_round_trip(rows in 0usize..6, columns in 0usize..6, seed: u32) {
            let values: Vec<f32> = (0..rows * columns)
                .map(|i| f32::from_bits(seed.wrapping_mul(2 * i as u32 + 1) >> 2))
                .collect();
            let mut bytes = Vec::new();
            write_array(&mut bytes, &[rows, columns], &values).unwrap();
            prop_assert_eq!(parse(&bytes, "x").unwrap(), Array { shape: vec![rows, columns], values });
        }

        #[test]
        fn damaged_bytes_never_panic(
            place in 0usize..200, byte: u8, cut in 0usize..220, fortran: bool,
        ) {
            let mut bytes = raw("'<f4'", fortran, "(3, 5)", &[7; 60]);
            if let Some(target) = bytes.get_mut(place) {
                *target = byte;
            }
            bytes.truncate(cut);
            if let Ok(array) = parse(&bytes, "x") {
                prop_assert_eq!(array.shape.iter().product::<usize>(), array.values.len());
            }
        }

        #[test]
        fn any_header_text_never_panics(text in "[-{}()\\[\\]',:a-z0-9<>|_ \\\\]{0,120}") {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text.as_bytes());
            let _ = parse(&bytes, "x");
        }
    }
}
