//! Objects: bodies as limbs, lone roots as oriented boxes.

use super::camera::{Camera, Seen};
use super::canvas::Image;
use super::palette::{CONTACT, EDGE, FRONT, LEFT, MIDDLE, NOSE, RIGHT, SHADOW};
use crate::scene::{BODY, Pose, SceneObject, Side, rotate};

/// Length of the pointer in front, meters.
const NOSE_LENGTH: f32 = 0.22;
/// Corners of the six faces of a box; the bits of a corner are its axes (side, up, front).
const FACES: [[usize; 4]; 6] = [
    [0, 2, 6, 4],
    [1, 5, 7, 3],
    [0, 4, 5, 1],
    [2, 3, 7, 6],
    [0, 1, 3, 2],
    [4, 6, 7, 5],
];

/// A shape with its distance.
struct Part {
    depth: f32,
    shape: Shape,
}

enum Shape {
    Limb {
        ends: [[f32; 2]; 2],
        radii: [f32; 2],
        colour: [u8; 3],
    },
    Face {
        corners: Vec<[f32; 2]>,
        colour: [u8; 3],
    },
}

/// Draws an object in `pose` with its shadow; `standing` are the joints in contact.
pub(super) fn draw(
    image: &mut Image,
    camera: &Camera,
    object: &SceneObject,
    pose: &Pose,
    standing: &[usize],
) {
    shadow(image, camera, object, pose);
    let mut parts = Vec::new();
    match pose.orientation {
        Some(orientation) => body(&mut parts, camera, pose.joints[0], orientation),
        None => limbs(&mut parts, camera, object, pose),
    }
    // Contacts are drawn in front of the feet.
    let contacts = standing
        .iter()
        .filter_map(|joint| camera.see(pose.joints[*joint]));
    parts.extend(contacts.map(|seen| limb([seen, seen], [0.045; 2], CONTACT, -0.2)));
    parts.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    for part in parts {
        match part.shape {
            Shape::Limb {
                ends,
                radii,
                colour,
            } => {
                let edge = (0.25 * radii[0].max(radii[1])).clamp(0.5, 1.5);
                image.stroke(ends, radii.map(|radius| radius + edge), EDGE);
                image.stroke(ends, radii, colour);
            }
            Shape::Face { corners, colour } => image.convex(&corners, colour),
        }
    }
}

/// A limb with radii in meters; `nearer` is added to its distance.
fn limb(ends: [Seen; 2], radii: [f32; 2], colour: [u8; 3], nearer: f32) -> Part {
    let [a, b] = ends;
    Part {
        depth: (a.depth + b.depth) / 2.0 + nearer,
        shape: Shape::Limb {
            ends: [a.at, b.at],
            radii: [radii[0] * a.scale, radii[1] * b.scale].map(|radius| radius.max(0.7)),
            colour,
        },
    }
}

fn limbs(parts: &mut Vec<Part>, camera: &Camera, object: &SceneObject, pose: &Pose) {
    let colour = |joint: usize| match object.side(joint) {
        Side::Left => LEFT,
        Side::Right => RIGHT,
        Side::Middle => MIDDLE,
    };
    for (joint, place) in pose.joints.iter().enumerate() {
        let radius = object.bone_radius(joint, &pose.joints);
        let end = match object.parents[joint] {
            Some(parent) => pose.joints[parent],
            None if object.joints() == 1 => *place,
            None => continue,
        };
        if let Some(seen) = camera.line(end, *place) {
            parts.push(limb(seen, [radius; 2], colour(joint), 0.0));
        }
        if let (true, Some(seen)) = (object.is_head(joint), camera.see(*place)) {
            parts.push(limb([seen, seen], [2.6 * radius; 2], colour(joint), 0.0));
        }
    }
}

fn body(parts: &mut Vec<Part>, camera: &Camera, centre: [f32; 3], orientation: [f32; 4]) {
    let place = |local: [f32; 3]| {
        let turned = rotate(orientation, local);
        [0, 1, 2].map(|axis| centre[axis] + turned[axis])
    };
    let corner = |bits: usize| {
        let sign = |axis: usize| 2.0 * ((bits >> axis) & 1) as f32 - 1.0;
        place([0, 1, 2].map(|axis| sign(axis) * BODY[axis]))
    };
    let front = camera.see(place([0.0, 0.0, BODY[2] + NOSE_LENGTH]));
    let base = camera.see(place([0.0, 0.0, BODY[2]]));
    for (index, face) in FACES.iter().enumerate() {
        let (axis, sign) = (index / 2, if index % 2 == 0 { -1.0 } else { 1.0 });
        let mut normal = [0.0; 3];
        normal[axis] = sign;
        let normal = rotate(orientation, normal);
        let corners = face.map(corner);
        let middle = [0, 1, 2].map(|axis| corners.iter().fold(0.0, |sum, at| sum + at[axis] / 4.0));
        let towards = camera.towards(middle);
        let facing: f32 = normal.iter().zip(towards).map(|(n, t)| n * t).sum();
        let seen: Option<Vec<Seen>> = corners.iter().map(|at| camera.see(*at)).collect();
        let (true, Some(seen)) = (facing > 0.0, seen) else {
            continue;
        };
        let colour = match (axis, sign > 0.0) {
            (2, true) => FRONT,
            (0, true) => LEFT,
            (0, false) => RIGHT,
            (1, true) => SHADOW,
            _ => MIDDLE,
        };
        parts.push(Part {
            depth: seen.iter().map(|seen| seen.depth).sum::<f32>() / 4.0,
            shape: Shape::Face {
                corners: seen.iter().map(|seen| seen.at).collect(),
                colour,
            },
        });
    }
    if let (Some(base), Some(front)) = (base, front) {
        parts.push(limb([base, front], [0.035, 0.015], NOSE, 0.0));
    }
}

/// The shadow vertically below the object.
fn shadow(image: &mut Image, camera: &Camera, object: &SceneObject, pose: &Pose) {
    let ground = |joint: usize| {
        let [x, _, z] = pose.joints[joint];
        [x, 0.0, z]
    };
    for joint in 0..pose.joints.len() {
        let end = object.parents[joint].unwrap_or(joint);
        let lone = object.joints() == 1;
        let radius = if lone { BODY[0] } else { 0.04 };
        if let Some([a, b]) = camera.line(ground(end), ground(joint)) {
            image.stroke([a.at, b.at], [radius * a.scale, radius * b.scale], SHADOW);
        }
        if let (true, Some([a, b])) = (lone, camera.line(ground(joint), pose.joints[joint])) {
            image.stroke([a.at, b.at], [0.6; 2], MIDDLE);
        }
    }
}
