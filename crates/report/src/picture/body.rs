//! Panels of a body: poses in side view, trajectory in top view, ground contacts.

use super::panel::{Kind, Panel, Pose};
use crate::scene::{Floor, SceneObject};

/// Root motion in meters above which poses are drawn along the trajectory.
const ALONG: f64 = 2.0;

/// Minimum distance of poses along a trajectory, meters.
const BETWEEN: f64 = 0.6;

/// Maximum number of poses along a trajectory.
const MOST: usize = 12;

/// Number and distance (meters) of poses drawn side by side.
const BESIDE: usize = 8;
const APART: f64 = 1.1;

/// Sides of a polygon that approximates a disc.
const SIDES: usize = 48;

/// The poses of a body, its trajectory in top view with the floor, and its ground contacts. A lone
/// root has only the trajectory.
pub fn body_panels(object: &SceneObject, floor: &Floor) -> Vec<Panel> {
    let panels = poses(object).into_iter().chain([path(object, floor)]);
    panels.chain(contacts(object)).collect()
}

fn path(object: &SceneObject, floor: &Floor) -> Panel {
    let root = (0..object.frames()).map(|t| object.joint(t, 0));
    let root = root.map(|[x, _, z]| (x.into(), z.into())).collect();
    let mut series = vec![("path".to_string(), root)];
    if !floor.path.is_empty() {
        let goal = floor.path.iter().map(|&[x, z]| (x.into(), z.into()));
        series.push(("goal".to_string(), goal.collect()));
    }
    let mut map = Panel::map("root path, top view (m; x right, z down)", series);
    for (frame, [x, z]) in &floor.keyframes {
        let place = (f64::from(*x), -f64::from(*z));
        map.points.push((format!("frame {frame}"), place));
    }
    for corners in &floor.polygons {
        let corners = corners.iter().map(|&[x, z]| (x.into(), -f64::from(z)));
        map.regions.push(corners.collect());
    }
    for &([x, z], radius) in &floor.obstacles {
        let [x, z, radius] = [x, z, radius].map(f64::from);
        let corners = (0..SIDES).map(|side| {
            let (sin, cos) = (side as f64 / SIDES as f64 * std::f64::consts::TAU).sin_cos();
            (x + radius * sin, -(z + radius * cos))
        });
        map.regions.push(corners.collect());
    }
    map
}

fn contacts(object: &SceneObject) -> Option<Panel> {
    let tracks = object.contacts.iter().map(|contact| {
        let name = object.joint_names.get(contact.joint);
        let name = name.map_or("foot", String::as_str);
        (name, contact.frames.as_slice())
    });
    let any = !object.contacts.is_empty();
    any.then(|| Panel::strip("on the ground", object.fps, tracks))
}

/// Evenly spaced poses: along the trajectory if the body travels, else side by side.
fn poses(object: &SceneObject) -> Option<Panel> {
    if object.joints() < 2 || object.frames() == 0 {
        return None;
    }
    let frames = object.frames();
    let axis = direction(object);
    let along = |frame: usize, joint: usize| {
        let [x, _, z] = object.joint(frame, joint).map(f64::from);
        x * axis[0] + z * axis[1]
    };
    let positions = (0..frames).map(|t| along(t, 0));
    let (low, high) = super::axes::extremes(positions);
    let is_moving = high - low >= ALONG;
    let count = match is_moving {
        true => (((high - low) / BETWEEN) as usize).min(MOST),
        false => BESIDE,
    };
    let count = count.min(frames);
    let children = object.children();
    let loose: Vec<usize> = (0..object.joints())
        .filter(|joint| object.parents[*joint].is_none() && children[*joint].is_empty())
        .collect();
    let is_dense = count as f64 > 10.0 * object.seconds();
    let digits = if is_dense { 2 } else { 1 };
    let moment = |index: usize| index * (frames - 1) / (count - 1).max(1);
    let poses = (0..count).map(|index| {
        let frame = moment(index);
        let shift = match is_moving {
            true => -along(0, 0),
            false => APART * index as f64 - along(frame, 0),
        };
        let place = |joint: usize| {
            let height = f64::from(object.joint(frame, joint)[1]);
            (along(frame, joint) + shift, height)
        };
        let bones = object.parents.iter().enumerate();
        let bones = bones.filter_map(|(joint, parent)| Some([place((*parent)?), place(joint)]));
        let joints = loose.iter().map(|&joint| place(joint));
        let heights = (0..object.joints()).map(|joint| place(joint).1);
        Pose {
            label: format!("{:.*} s", digits, frame as f64 / object.fps),
            top: (place(0).0, super::axes::extremes(heights).1 + 0.1),
            bones: bones.collect(),
            joints: joints.collect(),
        }
    });
    let title = match is_moving {
        true => "poses along the path, side view (m)",
        false => "poses side by side, side view (m)",
    };
    Some(Panel {
        is_wide: true,
        ..Panel::of(title, "m", Kind::Poses(poses.collect()))
    })
}

/// The main direction (x, z) of the root, towards its end.
fn direction(object: &SceneObject) -> [f64; 2] {
    let track: Vec<[f64; 2]> = (0..object.frames())
        .map(|t| {
            let [x, _, z] = object.joint(t, 0);
            [x.into(), z.into()]
        })
        .collect();
    let mean = |axis: usize| track.iter().map(|p| p[axis]).sum::<f64>() / track.len() as f64;
    let middle = [mean(0), mean(1)];
    let product = |a: usize, b: usize| -> f64 {
        let from_middle = |p: &[f64; 2], axis: usize| p[axis] - middle[axis];
        let products = track.iter().map(|p| from_middle(p, a) * from_middle(p, b));
        products.sum()
    };
    let (xx, xz, zz) = (product(0, 0), product(0, 1), product(1, 1));
    let (sin, cos) = (0.5 * (2.0 * xz).atan2(xx - zz)).sin_cos();
    let (first, last) = (track[0], track[track.len() - 1]);
    let onwards = (last[0] - first[0]) * cos + (last[1] - first[1]) * sin;
    let sign = if onwards < 0.0 { -1.0 } else { 1.0 };
    [sign * cos, sign * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mast of one meter that moves along z by `step` meters per frame.
    fn mast(step: f32) -> SceneObject {
        let frames = (0..20).flat_map(|t| {
            let z = step * t as f32;
            [0.0, 0.0, z, 0.0, 1.0, z]
        });
        SceneObject {
            fps: 10.0,
            positions: frames.collect(),
            parents: vec![None, Some(0)],
            ..SceneObject::default()
        }
    }

    #[test]
    fn the_trajectory_is_seen_from_its_side() {
        let [x, z] = direction(&mast(0.1));
        assert!(x.abs() < 1e-9 && (z - 1.0).abs() < 1e-9, "{x}, {z}");
        let [_, z] = direction(&mast(-0.1));
        assert!((z + 1.0).abs() < 1e-9, "{z}");
    }

    #[test]
    fn poses_of_a_moving_body_are_in_place_and_of_a_still_one_side_by_side() {
        let last = |step: f32| {
            let panel = poses(&mast(step)).expect("poses");
            let places: Vec<(f64, f64)> = panel.places().collect();
            places
                .iter()
                .fold(0.0f64, |furthest, place| furthest.max(place.0))
        };
        assert!((last(0.2) - 3.8).abs() < 1e-6, "{}", last(0.2));
        assert!((last(0.0) - 7.0 * APART).abs() < 1e-6, "{}", last(0.0));
    }
}
