//! Bodies: foot contacts, and curves of motion without a known representation.

use kinegrad_motion::humanml::Joints;
use kinegrad_report::scene::{Contact, Curves, SceneObject};

use crate::io::is_foot;

/// Height of a person for whom the contact thresholds hold, meters.
const PERSON: f64 = 1.7;

/// Largest height of a standing joint above its lowest position, meters.
const LOW: f64 = 0.05;

/// Largest speed of a standing joint, meters per second.
const SLOW: f64 = 0.4;

/// The figure of a body's joints. `feet` are the joints that can stand on the ground; by default,
/// joints with names of feet or toes.
///
/// A foot stands within 5 cm of its lowest position if it is slower than 0.4 m/s. The thresholds
/// are for a person 1.7 m tall and scale with the height.
pub fn figure(
    name: String,
    fps: f64,
    joints: &Joints,
    joint_names: Vec<String>,
    parents: Vec<Option<usize>>,
    feet: Option<&[usize]>,
) -> SceneObject {
    let named = || {
        let feet = joint_names.iter().enumerate();
        feet.filter(|(_, name)| is_foot(name))
            .map(|(joint, _)| joint)
            .collect()
    };
    let feet: Vec<usize> = feet.map_or_else(named, <[usize]>::to_vec);
    let size = height(joints) / PERSON;
    let contacts = feet.into_iter().map(|joint| Contact {
        joint,
        frames: stands(&joints.track(joint), fps, size),
    });
    SceneObject {
        name,
        fps,
        positions: joints.to_f32(),
        contacts: contacts.collect(),
        curves: curves(joints, fps),
        joint_names,
        parents,
        ..SceneObject::default()
    }
}

/// The largest distance from the lowest to the highest joint, over about 50 frames.
fn height(joints: &Joints) -> f64 {
    let step = joints.frames().div_ceil(50);
    let heights = (0..joints.frames()).step_by(step).map(|t| {
        let places = || joints.frame(t).iter().map(|place| place[1]);
        places().fold(f64::NEG_INFINITY, f64::max) - places().fold(f64::INFINITY, f64::min)
    });
    heights.fold(0.0, f64::max)
}

fn stands(track: &[[f64; 3]], fps: f64, size: f64) -> Vec<bool> {
    let mut heights: Vec<f64> = track.iter().map(|place| place[1]).collect();
    heights.sort_by(f64::total_cmp);
    // Ignores single frames below the floor.
    let lowest = heights[heights.len() / 50];
    let speed = |t: usize| {
        let (from, to) = (t.saturating_sub(1), (t + 1).min(track.len() - 1));
        let step = [0, 1, 2].map(|axis| track[to][axis] - track[from][axis]);
        let metres = step.iter().map(|value| value * value).sum::<f64>().sqrt();
        metres * fps / (to - from).max(1) as f64
    };
    let low = |t: usize| track[t][1] <= lowest + LOW * size;
    (0..track.len())
        .map(|t| low(t) && speed(t) <= SLOW * size)
        .collect()
}

/// Height and speed of the root.
fn curves(joints: &Joints, fps: f64) -> Vec<Curves> {
    let track = joints.track(0);
    let heights = track.iter().map(|place| place[1] as f32).collect();
    let speeds = track.windows(2).map(|pair| {
        let [x, _, z] = [0, 1, 2].map(|axis| pair[1][axis] - pair[0][axis]);
        (x.hypot(z) * fps) as f32
    });
    let of_root = |title: &str, values| Curves {
        title: title.to_string(),
        series: vec![("root".to_string(), values)],
    };
    vec![
        of_root("height (m)", heights),
        of_root("speed on the ground (m/s)", speeds.collect()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_foot_stands_while_it_is_low_and_slow() {
        // Ten frames on the ground, ten frames up and forward, ten frames on the ground.
        let place = |t: usize| match t {
            0..10 => [0.0, 0.02, 0.0],
            10..20 => [0.0, 0.2, 0.05 * (t - 9) as f64],
            _ => [0.0, 0.02, 0.55],
        };
        let places = (0..30).flat_map(|t| [[0.0, 1.7, 0.0], place(t)]);
        let joints = Joints::new(places.collect(), 2).unwrap();
        let names = ["Hips", "mixamorig:LeftFoot"].map(String::from).to_vec();
        let shown = figure("a".into(), 20.0, &joints, names, vec![None, Some(0)], None);
        let [contact] = shown.contacts.as_slice() else {
            panic!("one foot");
        };
        assert_eq!(contact.joint, 1);
        let standing: Vec<usize> = (0..30).filter(|t| contact.frames[*t]).collect();
        assert_eq!(standing, (0..9).chain(21..30).collect::<Vec<_>>());
    }
}
