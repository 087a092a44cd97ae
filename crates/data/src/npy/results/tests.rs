use proptest::prelude::*;

use super::*;
use crate::npy::tests::raw;

const FILES: [(&str, &[u8]); 3] = [
    ("protocol3.npy", include_bytes!("protocol3.npy")),
    ("protocol4.npy", include_bytes!("protocol4.npy")),
    ("protocol5.npy", include_bytes!("protocol5.npy")),
];

#[test]
fn pickled_results_of_any_protocol_are_read() {
    let mut values = Vec::new();
    for n in 0..2 {
        for j in 0..2 {
            for c in 0..3 {
                values.extend((0..5).map(|t| (100 * n + 10 * j + c) as f32 + t as f32 / 8.0));
            }
        }
    }
    for (file, bytes) in FILES {
        let found = MotionFile::parse(bytes, file).unwrap();
        let expected = Results {
            motion: Array {
                shape: vec![2, 2, 3, 5],
                values: values.clone(),
            },
            lengths: Some(vec![5, 3]),
        };
        assert_eq!(found, MotionFile::Results(expected), "{file}");
        // Elsewhere, where a dictionary is of no use, it is refused.
        let refused = parse(bytes, file).unwrap_err().to_string();
        assert!(refused.contains("Python objects"), "{refused}");
    }
}

/// A `.npy` file of an object array with this pickle.
fn pickled(pickle: &[u8]) -> Vec<u8> {
    raw("'|O'", false, "()", pickle)
}

fn refusal(pickle: &[u8]) -> String {
    let bytes = pickled(pickle);
    MotionFile::parse(&bytes, "r.npy").unwrap_err().to_string()
}

#[test]
fn other_pickles_are_refused_and_not_run() {
    let marker = std::env::temp_dir().join("kinegrad-was-here");
    let command = format!("touch {}", marker.display());
    let mut system = b"cos\nsystem\nX".to_vec();
    system.extend((command.len() as u32).to_le_bytes());
    system.extend(command.as_bytes());
    system.extend(b"\x85R.");
    let cases: [(&[u8], &str); 9] = [
        (&system, "not an array of NumPy"),
        (b"\x80\x04}.", "not an array of NumPy"),
        (b"\x80\x04", "cut off"),
        (b"\x80\x04X\xff\xff\xff\xffabc", "cut off"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\xff", "cut off"),
        (b"\x80\x04.", "an empty stack"),
        (b"(0.", "an empty stack"),
        (b"h\x05.", "not stored"),
        (b"Pfile\n.", "opcode 0x50"),
    ];
    for (pickle, expected) in cases {
        let found = refusal(pickle);
        assert!(found.contains(expected), "{expected}: {found}");
    }
    assert!(!marker.exists());
    // Lists of lists of lists double at each level: the values are shared, not copied.
    let mut bomb = b"\x80\x04]q\x00".to_vec();
    for level in 1..200u8 {
        bomb.extend([
            b']',
            b'q',
            level,
            b'(',
            b'h',
            level - 1,
            b'h',
            level - 1,
            b'e',
        ]);
    }
    bomb.push(b'.');
    assert!(refusal(&bomb).contains("not an array"));
    assert!(refusal(&vec![b'N'; (1 << 20) + 1]).contains("opcodes"));
}

/// A file with one part replaced by another of the same length.
fn edited(file: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = file
        .windows(from.len())
        .position(|part| part == from)
        .unwrap();
    let mut edited = file.to_vec();
    edited[at..at + to.len()].copy_from_slice(to);
    edited
}

#[test]
fn dictionaries_with_other_contents_are_refused_by_their_entry() {
    let (_, file) = FILES[0];
    // Shape (2, 2, 3, 5), as one-byte numbers of a tuple.
    let shape = b"K\x02K\x02K\x03K\x05";
    let cases: [(&[u8], &[u8], &str); 8] = [
        (
            b"motion",
            b"notion",
            "no `motion`, but: notion, text, lengths",
        ),
        (
            shape,
            b"K\x02K\x03K\x02K\x05",
            "`motion` has shape [2, 3, 2, 5]",
        ),
        (
            shape,
            b"K\x02K\x02K\x03K\x09",
            "`motion`: 240 bytes of data do not fit",
        ),
        (
            shape,
            b"K\xffK\xffK\x03K\xff",
            "`motion`: 240 bytes of data do not fit",
        ),
        (b"f4", b"i4", "`motion`: dtype i4 found, f4 or f8 needed"),
        (b"i8", b"f8", "`lengths`: dtype f8 found"),
        (
            b"\x05\0\0\0\0\0\0\0\x03",
            b"\x06",
            "`lengths` are not 2 lengths of 1 to 5 frames",
        ),
        (
            b"\x05\0\0\0\0\0\0\0\x03",
            b"\x05\0\0\0\0\0\0\xff",
            "`lengths`: not whole numbers",
        ),
    ];
    for (from, to, expected) in cases {
        let found = MotionFile::parse(&edited(file, from, to), "r.npy").unwrap_err();
        let found = found.to_string();
        assert!(found.contains(expected), "{expected}: {found}");
    }
}

proptest! {
    #[test]
    fn damaged_pickles_do_not_panic(
        which in 0..FILES.len(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = FILES[which].1.to_vec();
        for (place, value) in edits {
            let place = place.index(bytes.len() - 128);
            bytes[128 + place] = value;
        }
        let _ = MotionFile::parse(&bytes, "r.npy");
        bytes.truncate(128 + cut.index(bytes.len() - 128));
        let _ = MotionFile::parse(&bytes, "r.npy");
    }

    #[test]
    fn arbitrary_pickles_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = MotionFile::parse(&pickled(&bytes), "r.npy");
    }
}
