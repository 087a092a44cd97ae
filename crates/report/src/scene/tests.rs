use super::*;

/// A body of four joints at 20 frames per second (root, head, left and right foot) that moves
/// forward, turns and bends.
pub fn body(frames: usize) -> SceneObject {
    let mut positions = Vec::new();
    for frame in 0..frames {
        let t = frame as f32 / 20.0;
        let root = [0.3 * t, 0.9 + 0.05 * (3.0 * t).sin(), 0.8 * t];
        let heading = [(0.5 * t).cos(), 0.0, (0.5 * t).sin(), 0.0];
        let bend = 0.4 * (2.0 * t).sin();
        for bone in [
            [0.0; 3],
            [0.1 * bend, 0.7, 0.7 * bend],
            [0.2, -0.8 * (1.0 - 0.1 * bend), 0.3 * bend],
            [-0.2, -0.8, -0.3 * bend],
        ] {
            let turned = rotate(heading, bone);
            positions.extend([0, 1, 2].map(|axis| root[axis] + turned[axis]));
        }
    }
    let names = ["pelvis", "head", "left_foot", "right_foot"];
    SceneObject {
        name: "body".into(),
        fps: 20.0,
        positions,
        joint_names: names.map(String::from).to_vec(),
        parents: vec![None, Some(0), Some(0), Some(0)],
        contacts: vec![Contact {
            joint: 2,
            frames: (0..frames).map(|frame| frame % 10 < 5).collect(),
        }],
        ..SceneObject::default()
    }
}

/// A lone root at 30 frames per second that walks and turns from the heading `yaw`.
pub fn dancer(frames: usize, yaw: f32) -> SceneObject {
    let seconds = |frame: usize| frame as f32 / 30.0;
    let turn = |frame: usize| {
        let half = (yaw + 2.0 * seconds(frame)) / 2.0;
        [half.cos(), 0.0, half.sin(), 0.0]
    };
    let place = |frame: usize| [0.4 * seconds(frame), 0.95, 0.2 * seconds(frame)];
    SceneObject {
        name: "phrase".into(),
        fps: 30.0,
        positions: (0..frames).flat_map(place).collect(),
        joint_names: vec!["root".into()],
        parents: vec![None],
        orientations: Some((0..frames).map(turn).collect()),
        ..SceneObject::default()
    }
}

#[test]
fn poses_lie_between_frames() {
    let object = body(10);
    let (from, to) = (object.joint(3, 2), object.joint(4, 2));
    assert_eq!(object.pose(3.0 / 20.0).joints[2], from);
    let half = object.pose(3.5 / 20.0).joints[2];
    assert!((0..3).all(|axis| (half[axis] - (from[axis] + to[axis]) / 2.0).abs() < 1e-6));
    assert_eq!(object.pose(99.0).joints[2], object.joint(9, 2));
    assert_eq!(object.pose(-1.0).joints[2], object.joint(0, 2));
    let mut dancer = dancer(3, 0.0);
    let known = dancer.pose(0.05).orientation.unwrap();
    // The negated quaternion is the same orientation.
    let turns = dancer.orientations.as_mut().unwrap();
    turns[2] = turns[2].map(|part| -part);
    let found = dancer.pose(0.05).orientation.unwrap();
    assert!((0..4).all(|part| (known[part] - found[part]).abs() < 1e-6));
}

#[test]
fn sides_follow_from_names() {
    let names = [
        ("left_hip", Side::Left),
        ("mixamorig:RightFoot", Side::Right),
        ("LHip", Side::Left),
        ("hand_r", Side::Right),
        ("r_wrist", Side::Right),
        ("lumbar", Side::Middle),
        ("root", Side::Middle),
        ("ROOT", Side::Middle),
        ("L-Knee", Side::Left),
        ("neck", Side::Middle),
    ];
    for (name, side) in names {
        let object = SceneObject {
            joint_names: vec![name.into()],
            ..SceneObject::default()
        };
        assert_eq!(object.side(0), side, "{name}");
    }
}

#[test]
fn the_format_of_a_song_is_that_of_its_bytes() {
    let tagged = |rest: &[u8]| [b"ID3\x04\0\0\0\0\x01\x02".as_slice(), &[0; 130], rest].concat();
    for (bytes, format) in [
        (b"RIFF\x08\0\0\0WAVEfmt ".to_vec(), Some(SongFormat::Wav)),
        (b"fLaC\0".to_vec(), Some(SongFormat::Flac)),
        (b"OggS\0".to_vec(), Some(SongFormat::Ogg)),
        (vec![0xff, 0xfb, 0x90, 0x64], Some(SongFormat::Mp3)),
        (tagged(&[0xff, 0xf3, 0x40]), Some(SongFormat::Mp3)),
        (tagged(b"fLaC"), Some(SongFormat::Flac)),
        (tagged(b""), None),
        (b"ID3\x04\0\0\x7f\x7f\x7f\x7f".to_vec(), None),
        // AAC, and a playlist before MPEG frames.
        (vec![0xff, 0xf1, 0x50, 0x80], None),
        (
            b"#EXTM3U\nfile:///etc/passwd\n\xff\xfb\x90\x64".to_vec(),
            None,
        ),
        (b"RIFF\x08\0\0\0AVI ".to_vec(), None),
        (Vec::new(), None),
    ] {
        assert_eq!(SongFormat::of(&bytes), format, "{bytes:?}");
    }
}
