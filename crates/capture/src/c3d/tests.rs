pub mod writer;

use proptest::prelude::*;

use super::*;
use crate::Error;
use writer::Example;

const PROCESSORS: [Processor; 3] = [Processor::Intel, Processor::Dec, Processor::Mips];

fn parse(example: &Example) -> Result<C3d, Error> {
    C3d::parse(&example.bytes(), "take.c3d")
}

/// Three frames of two points, one of them missing once.
fn example() -> Example {
    let point = |x: i16| Some([x, -x, 3 * x].map(|v| f32::from(v) / 4.0));
    let frames = vec![
        vec![point(1), point(-20)],
        vec![point(2), None],
        vec![point(300), point(40)],
    ];
    Example::new(&["walker:LFWT", "walker:RFWT"], frames)
}

#[test]
fn every_processor_and_storage_gives_the_same_points() {
    for processor in PROCESSORS {
        for scale in [-0.1, 0.25] {
            for analog in [0, 7] {
                let mut example = example();
                (example.processor, example.scale, example.analog) = (processor, scale, analog);
                example.first_frame = 283;
                let c3d = parse(&example).unwrap();
                assert_eq!((c3d.processor, c3d.frames()), (processor, 3));
                assert_eq!((c3d.first_frame, c3d.rate), (283, 80.0));
                assert_eq!(c3d.metres_per_unit, 0.001);
                assert_eq!(c3d.labels, ["walker:LFWT", "walker:RFWT"]);
                for (t, frame) in example.frames.iter().enumerate() {
                    for (point, place) in frame.iter().enumerate() {
                        let expected = place.map(|place| place.map(f64::from));
                        assert_eq!(c3d.point(t, point), expected, "{processor:?} {scale}");
                    }
                }
            }
        }
    }
}

#[test]
fn nan_counts_as_missing() {
    let mut example = example();
    example.frames[0][0] = Some([1.0, f32::NAN, 2.0]);
    assert_eq!(parse(&example).unwrap().point(0, 0), None);
}

/// The frames in which the first point is missing.
fn missing(c3d: &C3d) -> Vec<bool> {
    c3d.track(0).iter().map(Option::is_none).collect()
}

#[test]
fn a_point_at_the_origin_is_missing_there() {
    let mut example = example();
    example.frames[1][0] = Some([0.0; 3]);
    let c3d = parse(&example).unwrap();
    assert_eq!(missing(&c3d), [false, true, false]);
    example
        .frames
        .iter_mut()
        .for_each(|frame| frame[0] = Some([0.0; 3]));
    let c3d = parse(&example).unwrap();
    assert_eq!(missing(&c3d), [true; 3]);
}

#[test]
fn names_are_found_in_lower_case() {
    let mut example = example();
    example.labels = vec!["walker:lfwt".to_string(), "LFWT_2".to_string()];
    let c3d = parse(&example).unwrap();
    assert_eq!(c3d.find("LFWT"), [0]);
}

#[test]
fn names_are_found_with_and_without_prefix() {
    let mut example = example();
    let c3d = parse(&example).unwrap();
    assert_eq!(c3d.find("RFWT"), [1]);
    assert_eq!(c3d.find("walker:RFWT"), [1]);
    assert!(c3d.find("LBWT").is_empty());
    example.labels = vec!["a:HEAD".to_string(), "b:HEAD".to_string()];
    let c3d = parse(&example).unwrap();
    assert_eq!(c3d.find("HEAD"), [0, 1]);
    assert_eq!(c3d.find("b:HEAD"), [1]);
}

#[test]
fn more_labels_than_one_parameter_holds_are_read() {
    let names: Vec<String> = (0..700).map(|i| format!("M{i}")).collect();
    let labels: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut example = Example::new(&labels, vec![vec![Some([1.0; 3]); 650]]);
    example.labels_per_parameter = 255;
    let c3d = parse(&example).unwrap();
    // Labels beyond the points are dropped.
    assert_eq!(c3d.labels, &names[..650]);
    assert_eq!(c3d.find("M600"), [600]);
}

#[test]
fn more_frames_than_the_header_can_count_are_read() {
    let mut example = example();
    example.scale = 1.0;
    example.first_frame = 70_000;
    example.frames = (0..70_000)
        .map(|t| vec![Some([(t % 1000) as f32, 0.0, 0.0])])
        .collect();
    let c3d = parse(&example).unwrap();
    assert_eq!((c3d.frames(), c3d.first_frame), (70_000, 70_000));
    assert_eq!(c3d.point(69_999, 0), Some([999.0, 0.0, 0.0]));
}

#[test]
fn units_are_lengths() {
    let cases = [
        (None, 0.001),
        (Some("mm"), 0.001),
        (Some("cm "), 0.01),
        (Some("m"), 1.0),
        (Some("IN"), 0.0254),
    ];
    for (units, metres) in cases {
        let example = Example { units, ..example() };
        assert_eq!(parse(&example).unwrap().metres_per_unit, metres);
    }
    let example = Example {
        units: Some("furlong"),
        ..example()
    };
    let Error::Format { place, found, .. } = parse(&example).unwrap_err() else {
        panic!("furlongs are no unit");
    };
    assert!(place.starts_with("POINT:UNITS at byte "), "{place}");
    assert_eq!(found, "`furlong`");
}

#[test]
fn of_two_starts_of_the_data_the_one_that_fits_counts() {
    let example = example();
    let bytes = example.bytes();
    let expected = parse(&example).unwrap();
    let data = bytes[16];
    let name = b"DATA_START";
    let place = bytes
        .windows(name.len())
        .position(|window| window == name)
        .unwrap();
    // The name, the link, the type and the number of dimensions.
    let parameter = place + name.len() + 4;
    assert_eq!(bytes[parameter], data);
    for (place, wrong) in [16, parameter]
        .into_iter()
        .flat_map(|place| [0, 1, 2, data - 1, data + 1, 200].map(|wrong| (place, wrong)))
    {
        let mut bytes = bytes.clone();
        bytes[place] = wrong;
        let found = C3d::parse(&bytes, "take.c3d").unwrap();
        assert_eq!(
            format!("{found:?}"),
            format!("{expected:?}"),
            "{place} {wrong}"
        );
    }
}

#[test]
fn damage_is_named_with_its_section() {
    let whole = example().bytes();
    let damaged = |place: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[place] = byte;
        bytes
    };
    let bad_rate = Example {
        rate: 0.0,
        ..example()
    }
    .bytes();
    let bad_scale = Example {
        scale: 0.0,
        ..example()
    }
    .bytes();
    let cases = [
        (Vec::new(), "header"),
        (b"HIERARCHY ROOT".repeat(100), "header"),
        (damaged(1, 0), "header"),
        (damaged(0, 0), "header"),
        (damaged(0, 200), "parameter section"),
        (damaged(515, 83), "parameter section"),
        (damaged(8, 200), "POINT:DATA_START"),
        (whole[..whole.len() - 1].to_vec(), "POINT:DATA_START"),
        (bad_rate, "POINT:RATE"),
        (bad_scale, "POINT:SCALE"),
    ];
    for (bytes, expected) in cases {
        let Error::Format { file, place, .. } = C3d::parse(&bytes, "take.c3d").unwrap_err() else {
            panic!("{expected}");
        };
        assert_eq!(file, "take.c3d");
        assert!(
            place.starts_with(&format!("{expected} at byte ")),
            "{place}"
        );
    }
}

fn any_example() -> impl Strategy<Value = Example> {
    let point = prop::option::weighted(0.9, prop::array::uniform3(-30_000i16..30_000));
    let frames = (1usize..5).prop_flat_map(move |points| {
        let frame = prop::collection::vec(point.clone(), points);
        prop::collection::vec(frame, 1..6)
    });
    let settings = (
        prop::sample::select(PROCESSORS.to_vec()),
        any::<bool>(),
        0usize..4,
        1u32..60_000,
    );
    (frames, settings).prop_map(|(frames, (processor, integers, analog, first_frame))| {
        let point = |point: Option<[i16; 3]>| point.map(|place| place.map(|v| f32::from(v) / 8.0));
        let frames = frames
            .into_iter()
            .map(|frame| frame.into_iter().map(point).collect());
        Example {
            processor,
            scale: if integers { 0.125 } else { -1.0 },
            analog,
            first_frame,
            ..Example::new(&["A", "B"], frames.collect())
        }
    })
}

proptest! {
    #[test]
    fn what_is_written_is_read(example in any_example()) {
        let c3d = parse(&example).unwrap();
        prop_assert_eq!(c3d.frames(), example.frames.len());
        for (t, frame) in example.frames.iter().enumerate() {
            for (point, place) in frame.iter().enumerate() {
                prop_assert_eq!(c3d.point(t, point), place.map(|place| place.map(f64::from)));
            }
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 1024..2048)) {
        let _ = C3d::parse(&bytes, "bytes");
        // Passes the first checks, to test the parameters.
        (bytes[0], bytes[1], bytes[515]) = (2, 0x50, 84 + bytes[515] % 3);
        let _ = C3d::parse(&bytes, "bytes");
    }

    #[test]
    fn damaged_files_never_panic(
        example in any_example(),
        changes in prop::collection::vec((0usize..1536, any::<u8>()), 1..12),
        end in 0usize..3000,
    ) {
        let mut bytes = example.bytes();
        for (place, byte) in changes {
            let place = place % bytes.len();
            bytes[place] = byte;
        }
        bytes.truncate(end.max(1024));
        if let Ok(c3d) = C3d::parse(&bytes, "damaged") {
            prop_assert!(c3d.frames() * c3d.points_per_frame * 8 <= bytes.len());
        }
    }
}
