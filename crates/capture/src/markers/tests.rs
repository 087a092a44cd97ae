use super::*;
use crate::MarkerGaps;
use crate::RootSource;
use crate::c3d::tests::writer::Example;
use kinegrad_motion::Quaternion;
use kinegrad_motion::vector::length;

const PELVIS: [&str; 4] = ["d:LFWT", "d:RFWT", "d:LBWT", "d:RBWT"];

/// A pelvis in the y-up frame in metres: its marker places in z-up millimetres.
fn markers(position: [f64; 3], orientation: Quaternion) -> Vec<Option<[f32; 3]>> {
    let corners = [
        [0.1, 0.0, 0.15],
        [-0.1, 0.0, 0.15],
        [0.1, 0.0, -0.15],
        [-0.1, 0.0, -0.15],
    ];
    let places = corners.map(|corner| {
        let turned = orientation.rotate(corner);
        let [x, y, z] = [0, 1, 2].map(|i| 1000.0 * (position[i] + turned[i]));
        Some([x, -z, y].map(|v| v as f32))
    });
    places.to_vec()
}

fn take(frames: Vec<Vec<Option<[f32; 3]>>>) -> C3d {
    C3d::parse(&Example::new(&PELVIS, frames).bytes(), "take.c3d").unwrap()
}

fn standing(frames: usize) -> Vec<Vec<Option<[f32; 3]>>> {
    (0..frames)
        .map(|t| markers([0.01 * t as f64, 1.0, 0.0], Quaternion::IDENTITY))
        .collect()
}

#[test]
fn a_pelvis_gives_back_its_pose() {
    let turns = [
        [0.0; 3],
        [0.2, 1.0, -0.3],
        [-0.5, 3.0, 0.4],
        [0.0, 0.0, 3.1],
    ];
    let turns = turns.map(Quaternion::from_rotation_vector);
    let frames = turns.map(|turn| markers([0.5, 0.9, -1.5], turn)).to_vec();
    let root = MarkerMap::default().root(&take(frames)).unwrap();
    assert_eq!((root.frames(), root.rate()), (4, 80.0));
    assert!(root.gaps().is_empty());
    for (t, turn) in turns.into_iter().enumerate() {
        let pose = root.sample(t as f64).unwrap();
        assert!((pose.orientation.dot(turn).abs() - 1.0).abs() < 1e-12);
        let off = [0.5, 0.9, -1.5];
        let off = [0, 1, 2].map(|i| pose.position[i] - off[i]);
        assert!(length(off) < 1e-6);
    }
}

#[test]
fn between_frames_the_markers_are_interpolated() {
    let turn = Quaternion::from_yaw(1.0);
    let frames = vec![
        markers([0.0; 3], Quaternion::IDENTITY),
        markers([1.0, 0.0, 0.0], turn),
    ];
    let root = MarkerMap::default().root(&take(frames)).unwrap();
    let pose = root.sample(0.25).unwrap();
    assert!((pose.position[0] - 0.25).abs() < 1e-6);
    // The direction of 0.75 (sin 0, cos 0) + 0.25 (sin 1, cos 1), not a yaw of 0.25.
    let expected = (0.25 * 1f64.sin()).atan2(0.75 + 0.25 * 1f64.cos());
    assert!((pose.orientation.yaw() - expected).abs() < 1e-6);
    assert_eq!(root.sample(1.01), None);
    assert_eq!(root.sample(-0.01), None);
}

#[test]
fn short_gaps_are_filled_and_counted_long_ones_are_not_valid() {
    let mut frames = standing(20);
    frames[3][0] = None;
    frames[4][0] = None;
    for frame in &mut frames[10..13] {
        frame[2] = None;
    }
    frames[19][2] = None;
    let map = MarkerMap {
        max_gap_frames: 2,
        ..MarkerMap::default()
    };
    let root = map.root(&take(frames)).unwrap();
    let gaps = |marker: &str, missing_frames, filled_frames, longest_gap_frames| MarkerGaps {
        marker: marker.to_string(),
        missing_frames,
        filled_frames,
        longest_gap_frames,
    };
    assert_eq!(
        root.gaps(),
        [gaps("d:LFWT", 2, 2, 2), gaps("d:LBWT", 4, 0, 3)]
    );
    for t in 0..20 {
        let pose = root.sample(f64::from(t));
        assert_eq!(pose.is_some(), !(10..13).contains(&t) && t != 19, "{t}");
        if let Some(pose) = pose {
            assert!((pose.position[0] - 0.01 * f64::from(t)).abs() < 1e-6);
        }
    }
    assert_eq!(root.sample(9.5), None);
    assert_eq!(root.sample(12.5), None);
}

#[test]
fn the_mean_tilt_can_be_removed() {
    let leaning = Quaternion::from_yaw(2.0) * Quaternion::from_rotation_vector([-0.3, 0.0, 0.0]);
    let frames = vec![markers([0.0; 3], leaning); 3];
    let pitch = |remove_mean_tilt| {
        let map = MarkerMap {
            remove_mean_tilt,
            ..MarkerMap::default()
        };
        let pose = map
            .root(&take(frames.clone()))
            .unwrap()
            .sample(1.0)
            .unwrap();
        assert!((pose.orientation.yaw() - 2.0).abs() < 1e-6);
        pose.orientation.rotate([0.0, 0.0, 1.0])[1].asin()
    };
    assert!((pitch(false) - 0.3).abs() < 1e-6);
    assert!(pitch(true).abs() < 1e-6);
}

#[test]
fn wrong_names_and_useless_takes_are_refused() {
    let with = |change: &dyn Fn(&mut MarkerMap)| {
        let mut map = MarkerMap::default();
        change(&mut map);
        map.root(&take(standing(2))).unwrap_err()
    };
    let error = with(&|map| map.left = vec!["SACR".to_string()]);
    assert!(
        matches!(&error, Error::Name { problem, hint }
            if problem.contains("`left`") && hint.contains("d:LBWT")),
        "{error:?}"
    );
    let error = with(&|map| map.back.clear());
    assert!(matches!(error, Error::Setting(refused) if refused.key == "back"));
    // Forward and left along one line define no axes.
    let error = with(&|map| (map.left, map.right) = (map.front.clone(), map.back.clone()));
    assert!(matches!(error, Error::NoPose { .. }), "{error:?}");
    let twice = Example::new(&["a:LFWT", "b:LFWT"], vec![vec![Some([0.0; 3]); 2]]);
    let twice = C3d::parse(&twice.bytes(), "twice.c3d").unwrap();
    let error = MarkerMap::default().root(&twice).unwrap_err();
    assert!(error.to_string().contains("may mean several"), "{error:?}");
}

#[test]
fn the_map_is_read_with_defaults_and_without_unknown_keys() {
    let map: MarkerMap = serde_json::from_str(r#"{"up": "y", "front": ["A"]}"#).unwrap();
    assert_eq!((map.up, &map.front), (UpAxis::Y, &vec!["A".to_string()]));
    assert_eq!(map.back, MarkerMap::default().back);
    let text = serde_json::to_string(&map).unwrap();
    assert_eq!(serde_json::from_str::<MarkerMap>(&text).unwrap(), map);
    assert!(serde_json::from_str::<MarkerMap>(r#"{"fornt": ["A"]}"#).is_err());
}
