use super::*;
use proptest::prelude::*;

/// A `.npy` file with an arbitrary, possibly invalid, header.
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
fn three_axes_in_fortran_order_are_read_as_in_c_order() {
    let (shape, at) = ([2, 3, 4], |[a, b, c]: [usize; 3]| {
        (100 * a + 10 * b + c) as f32
    });
    let mut c_order = Vec::new();
    let mut fortran = Vec::new();
    for first in 0..shape[0] {
        for second in 0..shape[1] {
            c_order.extend((0..shape[2]).map(|third| at([first, second, third])));
        }
    }
    for third in 0..shape[2] {
        for second in 0..shape[1] {
            fortran.extend((0..shape[0]).map(|first| at([first, second, third])));
        }
    }
    let array = parse(&raw("'<f4'", true, "(2, 3, 4)", &floats(&fortran)), "f").unwrap();
    assert_eq!((array.shape, array.values), (shape.to_vec(), c_order));
}

#[test]
fn many_axes_are_refused_or_take_no_more_work_than_their_numbers() {
    let ones = |count: usize| format!("({})", "1, ".repeat(count));
    let bytes = raw("'<f4'", true, &ones(65), &floats(&[1.0]));
    let message = parse(&bytes, "f").unwrap_err().to_string();
    assert!(message.contains("65 axes found, 64 allowed"), "{message}");
    // With work for each number and axis, this would take minutes.
    let shape = format!("(2048, 2048, {})", "1, ".repeat(62));
    let numbers: Vec<f32> = (0..1 << 22).map(|number| number as f32).collect();
    let array = parse(&raw("'<f4'", true, &shape, &floats(&numbers)), "f").unwrap();
    assert_eq!(array.shape.len(), 64);
    let at = |row: usize, column: usize| array.values[2048 * row + column];
    assert_eq!(
        [at(0, 1), at(1, 0), at(2047, 2047)],
        [2048.0, 1.0, 4_194_303.0]
    );
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
        (b"no array".to_vec(), "it lacks the magic string"),
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
        (raw("'<f4'", false, &deep, &four), "not a whole number"),
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
        let is_double = matches!(header.dtype, header::Dtype::Double);
        assert_eq!(is_double, double, "{dictionary}");
        assert_eq!(header.fortran_order, fortran_order, "{dictionary}");
        assert_eq!(header.shape, shape, "{dictionary}");
        assert_eq!(header.length, shape.iter().product::<usize>() as u64);
    }
    for (dictionary, expected) in [
        ("", "not a dictionary"),
        (
            "{'descr': '<f4', 'fortran_order': False}",
            "no entry 'shape'",
        ),
        (
            "{'descr': '<f4',, 'fortran_order': False, 'shape': (3,)}",
            "not a dictionary",
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
            "not a whole number",
        ),
        (
            "{'descr': '<f4', 'fortran_order': False, 'shape': (,)}",
            "not a whole number",
        ),
        (
            "{'descr': '<f4', 'fortran_order': False, 'shape': (03,)}",
            "not a whole number",
        ),
        (
            "{'descr': <f4, 'fortran_order': False, 'shape': (3,)}",
            "dtype <f4 found",
        ),
        (
            "{'descr': '<f4', 'fortran_order': False, 'shape': (+3,)}",
            "not a whole number",
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
    let written = Phrase::new(values.clone()).unwrap();
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
        let message = read_motion(&path).unwrap_err().to_string();
        assert!(message.contains("found, [frames, 25]"), "{message}");
    }
}

proptest! {
    #[test]
    fn any_array_survives_a_round_trip(rows in 0usize..6, columns in 0usize..6, seed: u32) {
        let values: Vec<f32> = (0..rows * columns)
            .map(|i| f32::from_bits(seed.wrapping_mul(2 * i as u32 + 1) >> 2))
            .collect();
        let bytes = array_bytes(&[rows, columns], &values);
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
