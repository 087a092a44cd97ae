use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

use proptest::prelude::*;

use super::*;
use crate::{Error, RootSource, UpAxis};

/// A hip with rotations before positions, a chest that is moved, an arm that only turns, a hand
/// without channels; names with colon and space, Windows line ends, exponents, joints without End
/// Sites.
const FIGURE: &str = "HIERARCHY\r
ROOT mixamorig7:Hips {\r
  OFFSET 7 7 7\r
\tCHANNELS 6 Zrotation Xrotation Yrotation Yposition Xposition Zposition\r
\tJOINT Upper Chest\r
\t{\r
\t\tOFFSET 0 1 0\r
\t\tCHANNELS 2 Yposition Yrotation\r
\t\tJOINT Arm\r
\t\t{\r
\t\t\tCHANNELS 3 Xrotation Yrotation Zrotation OFFSET 0 0 2\r
\t\t\tJOINT Hand { OFFSET 1e0 0 0 End Site { OFFSET 0.5 0 0 } }\r
\t\t}\r
\t}\r
}\r
MOTION\r
Frames: 2\r
Frame Time: 0.0416666666666667\r
0 0 0  20 10 30  1.5 0  0 0 0\r
90 0 0  2.0E1 10 30  1 90  360 0 450\r
";

fn parse(text: &str) -> Result<Bvh, Error> {
    Bvh::parse(text.as_bytes(), "figure.bvh")
}

fn near(a: [f64; 3], b: [f64; 3]) -> bool {
    (0..3).all(|i| (a[i] - b[i]).abs() < 1e-9)
}

#[test]
fn a_figure_with_every_oddity_is_read() {
    let bvh = parse(FIGURE).unwrap();
    let names: Vec<&str> = bvh.joints().iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["mixamorig7:Hips", "Upper Chest", "Arm", "Hand"]);
    assert_eq!(bvh.joint("Hips"), Some(0));
    assert_eq!(bvh.joint("mixamorig7:Hips"), Some(0));
    assert_eq!(bvh.joint("Foot"), None);
    let channels: Vec<usize> = bvh.joints().iter().map(|j| j.channels.len()).collect();
    assert_eq!(channels, [6, 2, 3, 0]);
    assert_eq!(bvh.joints()[3].end_sites, [[0.5, 0.0, 0.0]]);
    assert!(bvh.joints()[..3].iter().all(|j| j.end_sites.is_empty()));
    assert_eq!((bvh.frames(), bvh.frame_time()), (2, 0.0416666666666667));
    assert_eq!(bvh.frame(1)[3..6], [20.0, 10.0, 30.0]);
}

#[test]
fn position_channels_replace_the_offset() {
    let world = parse(FIGURE).unwrap().world(0);
    assert!(near(world[0].position, [10.0, 20.0, 30.0]));
    // Only y of the chest's offset is replaced.
    assert!(near(world[1].position, [10.0, 21.5, 30.0]));
    assert!(near(world[2].position, [10.0, 21.5, 32.0]));
    assert!(near(world[3].position, [11.0, 21.5, 32.0]));
}

#[test]
fn rotations_apply_in_the_order_of_their_channels() {
    let world = parse(FIGURE).unwrap().world(1);
    // The hip turns by a quarter about z: up becomes left.
    assert!(near(world[1].position, [9.0, 20.0, 30.0]));
    // The chest turns by a quarter about its own y: its +z becomes its +x, which is the world's +y.
    assert!(near(world[2].position, [9.0, 22.0, 30.0]));
    // The arm's 450 degrees are a quarter turn about z: its +x becomes its +y, the world's -x.
    assert!(near(world[3].position, [8.0, 22.0, 30.0]));
    let order = "HIERARCHY ROOT a\n{ OFFSET 0 0 0 CHANNELS 2 Yrotation Xrotation }\nMOTION\n\
                 Frames: 1\nFrame Time: 1\n90 90";
    let turned = parse(order).unwrap().world(0)[0].orientation;
    // First about x, then about y: +z goes down and stays there.
    assert!(near(turned.rotate([0.0, 0.0, 1.0]), [0.0, -1.0, 0.0]));
}

#[test]
fn tracks_are_in_metres_and_y_up() {
    let bvh = parse(FIGURE).unwrap();
    let track = bvh.root_track(0.01, UpAxis::Y).unwrap();
    assert!(near(track.positions[0], [0.1, 0.2, 0.3]));
    assert_eq!(track.rate(), 1.0 / 0.0416666666666667);
    let track = bvh.root_track(0.01, UpAxis::Z).unwrap();
    assert!(near(track.positions[0], [0.1, 0.3, -0.2]));
    // A turn about the file's up axis is a yaw, and an upright body stays upright.
    assert!((track.orientations[1].yaw() - FRAC_PI_2).abs() < 1e-12);
    assert!(near(
        track.orientations[1].rotate([0.0, 1.0, 0.0]),
        [0.0, 1.0, 0.0]
    ));
    let hand = bvh.joint_track(3, 1.0, UpAxis::Y).unwrap();
    for t in 0..2 {
        assert!(near(hand.positions[t], bvh.world(t)[3].position));
    }
    assert!(bvh.root_track(0.0, UpAxis::Y).is_err());
    assert!(bvh.joint_track(4, 1.0, UpAxis::Y).is_err());
}

const SMALL: &str = "HIERARCHY\nROOT a\n{ OFFSET 0 0 0\nCHANNELS 1 Xposition\n\
                     JOINT b { OFFSET 0 1 0 CHANNELS 1 Yrotation } }\n\
                     MOTION\nFrames: 2\nFrame Time: 0.1\n0 1\n2 3\n";

#[test]
fn lines_may_end_in_any_way_and_text_may_be_utf_16() {
    let expected = parse(SMALL).unwrap();
    for ends in ["\r", "\r\n"] {
        assert_eq!(parse(&SMALL.replace('\n', ends)).unwrap(), expected);
    }
    for text in [format!("\u{feff}{SMALL}"), SMALL.to_owned()] {
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for bytes in [little, big] {
            assert_eq!(Bvh::parse(&bytes, "take.bvh").unwrap(), expected);
        }
    }
}

#[test]
fn one_frame_more_than_declared_is_read() {
    let bvh = parse(&(SMALL.to_owned() + "4 5\n")).unwrap();
    assert_eq!(bvh.frames(), 3);
    assert_eq!(
        bvh.notes(),
        ["`Frames:` declares 2, and 3 follow: all are read"]
    );
    let error = parse(&(SMALL.to_owned() + "4 5\n6 7\n")).unwrap_err();
    assert!(error.with_hint().contains("after `Frames:`"), "{error}");
}

#[test]
fn undefined_numbers_are_named_with_frame_and_joint() {
    for word in [
        "nan",
        "-nan(ind)",
        "1.#INF",
        "-inf",
        "1.#QNAN",
        "-1.#IND",
        "-1.#J",
    ] {
        let error = parse(&SMALL.replace("2 3", &format!("2 {word}"))).unwrap_err();
        let said = error.with_hint();
        assert!(said.contains("in frame 2, joint `b`"), "{said}");
        assert!(said.contains("undefined number"), "{said}");
    }
    let error = parse(&SMALL.replace("2 3", "2,5 3")).unwrap_err();
    assert!(
        error.with_hint().contains("decimals take a point"),
        "{error}"
    );
}

#[test]
fn a_file_that_was_cut_off_says_so() {
    for last in ["2", "2 -", "2 1e", "2 .", "2 3.5e-"] {
        let text = SMALL.replace("2 3\n", last);
        let said = parse(&text).unwrap_err().with_hint();
        assert!(
            said.contains("the file ends here, before its last"),
            "{said}"
        );
    }
    let said = parse(&SMALL.replace("0 1\n", "0 -\n"))
        .unwrap_err()
        .with_hint();
    assert!(said.contains("separated by spaces"), "{said}");
}

#[test]
fn ends_of_text_are_no_frames() {
    let expected = parse(SMALL).unwrap();
    for end in ["\u{1a}", "\r\n\u{1a}\u{1a}", "\0", "\0\0\0\n \0", "\n\n"] {
        assert_eq!(
            parse(&(SMALL.to_owned() + end)).unwrap(),
            expected,
            "{end:?}"
        );
    }
}

#[test]
fn frame_times_may_be_milliseconds() {
    for (time, seconds) in [("33.3333", 0.0333333), ("8.33", 0.00833), ("4", 0.004)] {
        let bvh = parse(&SMALL.replace("Time: 0.1", &format!("Time: {time}"))).unwrap();
        assert!((bvh.frame_time() - seconds).abs() < 1e-12, "{time}");
        assert!(
            bvh.notes()[0].contains("read as milliseconds"),
            "{:?}",
            bvh.notes()
        );
        let text = bvh.to_text();
        assert!(parse(&text).unwrap().notes().is_empty(), "{text}");
    }
    let said = parse(&SMALL.replace("Time: 0.1", "Time: 1e6"))
        .unwrap_err()
        .with_hint();
    assert!(said.contains("at most 1000 milliseconds"), "{said}");
}

#[test]
fn several_figures_are_named() {
    let figure = "ROOT b { OFFSET 0 0 0 CHANNELS 1 Xposition }\nMOTION";
    let said = parse(&SMALL.replace("MOTION", figure))
        .unwrap_err()
        .with_hint();
    assert!(
        said.contains("found a second ROOT") && said.contains("one figure a file"),
        "{said}"
    );
}

#[test]
fn the_figures_of_a_file_are_read_and_written_back() {
    let [one, two] = ["a", "b"].map(|name| FIGURE.replace("Hips", name));
    let [first, second] = [&one, &two].map(|text| parse(text).unwrap());
    let (hierarchy, frames) = (second.to_text(), first.frames());
    let (hierarchy, _) = hierarchy.split_once("MOTION").unwrap();
    let text = Bvh::figures_to_text(&[first.clone(), second.clone()]);
    assert!(text.contains(hierarchy.strip_prefix("HIERARCHY\n").unwrap()));
    let read = Bvh::parse_figures(text.as_bytes(), "two.bvh").unwrap();
    assert_eq!(read.len(), 2);
    for (read, known) in read.iter().zip([&first, &second]) {
        assert_eq!(read.joints(), known.joints());
        for t in 0..frames {
            assert_eq!(read.world(t), known.world(t));
        }
    }
    assert_eq!(Bvh::figures_to_text(&read), text);
    // A figure alone, and a number that is missing in the second figure.
    assert_eq!(
        Bvh::parse_figures(one.as_bytes(), "one.bvh").unwrap(),
        [first]
    );
    let short = text.trim_end().rsplit_once(' ').unwrap().0;
    let said = Bvh::parse_figures(short.as_bytes(), "two.bvh").unwrap_err();
    assert!(said.to_string().contains("numbers"), "{said}");
    let still = "ROOT b { OFFSET 0 0 0 }\nMOTION";
    let still = SMALL.replace("MOTION", still);
    let said = Bvh::parse_figures(still.as_bytes(), "still.bvh").unwrap_err();
    assert!(said.to_string().contains("without channels"), "{said}");
}

#[test]
fn mistakes_are_named_with_their_line() {
    let cases = [
        ("HIERARCHY", "HIERARCH", 1, "`HIERARCHY`"),
        ("Zposition\r", "Zposition Wrotation\r", 4, "one OFFSET"),
        (
            "CHANNELS 2 Yposition",
            "CHANNELS 2 Yrotation",
            8,
            "does not have yet",
        ),
        ("CHANNELS 2 Y", "CHANNELS 7 Y", 8, "from 0 to 6"),
        (
            "CHANNELS 2 Yposition",
            "CHANNELS 2 Wposition",
            8,
            "Xposition",
        ),
        ("OFFSET 7 7 7\r\n", "", 14, "one OFFSET"),
        ("0 1 0\r", "0 1,5 0\r", 7, "finite number"),
        (
            "}\r\nMOTION",
            "}\r\nROOT b { OFFSET 0 0 0 }\r\nMOTION",
            16,
            "MOTION",
        ),
        ("Frames: 2", "Frames: -2", 17, "at least 1"),
        ("Frames: 2", "Frames: 3", 20, "3 frames"),
        ("0 1 0\r", "0 nan 0\r", 7, "finite number"),
        (
            "Frames: 2",
            "Frames: 99999999999999999999",
            17,
            "at least 1",
        ),
        (
            "Frame Time: 0.0416666666666667",
            "Frame Time: 0",
            18,
            "positive",
        ),
        ("Frame Time:", "Time:", 18, "`Frame Time:`"),
        ("1 90  360 0 450", "1 90  360 0", 20, "11 numbers"),
        ("1 90  360 0 450", "1 90  360 0 450 0", 20, "11 numbers"),
        ("1 90  360 0 450", "1 90  360 0 nan", 20, "finite number"),
    ];
    for (from, to, at, expected) in cases {
        let text = FIGURE.replacen(from, to, 1);
        assert_ne!(text, FIGURE, "{from}");
        let Error::Format {
            file,
            place,
            allowed,
            ..
        } = parse(&text).unwrap_err()
        else {
            panic!("{from}");
        };
        assert_eq!(
            (file, place),
            ("figure.bvh".into(), format!("line {at}")),
            "{to}"
        );
        assert!(allowed.contains(expected), "{to}: {allowed}");
    }
    for empty in [
        "",
        "HIERARCHY",
        "HIERARCHY ROOT",
        "HIERARCHY ROOT a\n{ OFFSET 0 0 0 }\nMOTION",
    ] {
        assert!(matches!(parse(empty), Err(Error::Format { .. })), "{empty}");
    }
}

#[test]
fn a_deep_tree_needs_no_stack_and_grows_with_its_joints_alone() {
    let depth = 100_000;
    let mut text = "HIERARCHY\nROOT a\n{ OFFSET 0 1 0 CHANNELS 1 Xposition\n".to_string();
    text.push_str(&"JOINT a\n{ OFFSET 0 1 0\n".repeat(depth));
    text.push_str(&"}".repeat(depth + 1));
    text.push_str("\nMOTION\nFrames: 1\nFrame Time: 1\n5\n");
    let bvh = parse(&text).unwrap();
    let world = bvh.world(0);
    assert!(near(world[depth].position, [5.0, 1.0 + depth as f64, 0.0]));
    assert_eq!(bvh.largest_turn(), None);
    assert!(bvh.to_text().len() < 400 * depth);
}

fn channel_name(channel: Channel) -> String {
    match channel {
        Channel::Position(axis) => format!("{axis:?}position"),
        Channel::Rotation(axis) => format!("{axis:?}rotation"),
    }
}

/// Channels and offset of joints, each the child of the one before.
type Chain = Vec<(Vec<Channel>, [f64; 3])>;

/// A chain of joints as text.
fn write(joints: &Chain, frame_time: f64, frames: &[Vec<f64>]) -> String {
    let mut text = "HIERARCHY\nROOT joint 0\n".to_string();
    for (i, (channels, [x, y, z])) in joints.iter().enumerate() {
        if i > 0 {
            writeln!(text, "JOINT joint {i}").unwrap();
        }
        let names: Vec<String> = channels.iter().copied().map(channel_name).collect();
        let count = channels.len();
        writeln!(
            text,
            "{{\nOFFSET {x:e} {y} {z}\nCHANNELS {count} {}",
            names.join(" ")
        )
        .unwrap();
    }
    text.push_str(&"}\n".repeat(joints.len()));
    writeln!(
        text,
        "MOTION\nFrames: {}\nFrame Time: {frame_time}",
        frames.len()
    )
    .unwrap();
    for frame in frames {
        let numbers: Vec<String> = frame.iter().map(f64::to_string).collect();
        writeln!(text, "{}", numbers.join(" ")).unwrap();
    }
    text
}

fn any_channels() -> impl Strategy<Value = Vec<Channel>> {
    let axes = [Axis::X, Axis::Y, Axis::Z];
    let all: Vec<Channel> = axes
        .into_iter()
        .flat_map(|axis| [Channel::Position(axis), Channel::Rotation(axis)])
        .collect();
    (Just(all).prop_shuffle(), 0usize..=6).prop_map(|(mut all, count)| {
        all.truncate(count);
        all
    })
}

fn any_file() -> impl Strategy<Value = (Chain, f64, Vec<Vec<f64>>)> {
    let joint = (any_channels(), prop::array::uniform3(-1e3f64..1e3));
    let joints = prop::collection::vec(joint, 1..6);
    let joints = joints.prop_filter("has channels", |j| j.iter().any(|(c, _)| !c.is_empty()));
    joints.prop_flat_map(|joints| {
        let channels = joints.iter().map(|(c, _)| c.len()).sum::<usize>();
        let frame = prop::collection::vec(-1e4f64..1e4, channels);
        (
            Just(joints),
            1e-4f64..2.0,
            prop::collection::vec(frame, 1..5),
        )
    })
}

proptest! {
    #[test]
    fn what_is_written_is_read((joints, frame_time, frames) in any_file()) {
        let bvh = parse(&write(&joints, frame_time, &frames)).unwrap();
        prop_assert_eq!(bvh.frame_time(), frame_time);
        prop_assert_eq!(bvh.frames(), frames.len());
        for (read, (channels, offset)) in bvh.joints().iter().zip(&joints) {
            prop_assert_eq!((&read.channels, &read.offset), (channels, offset));
        }
        for (t, frame) in frames.iter().enumerate() {
            prop_assert_eq!(bvh.frame(t), &frame[..]);
            for pose in bvh.world(t) {
                prop_assert!((pose.orientation.norm() - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = Bvh::parse(&bytes, "bytes");
    }

    #[test]
    fn damaged_files_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        end in any::<prop::sample::Index>(),
        cut: bool,
    ) {
        let mut bytes = FIGURE.as_bytes().to_vec();
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if cut {
            bytes.truncate(end.index(bytes.len()));
        }
        if let Ok(bvh) = Bvh::parse(&bytes, "damaged") {
            let _ = bvh.root_track(1.0, UpAxis::Z);
        }
    }
}
