//! Marks on the floor.

use super::camera::Camera;
use super::canvas::Image;
use super::palette::{GRID, KEYFRAME, OBSTACLE, PATH, TRAIL};
use crate::scene::Floor;

/// Half size of the grid in meters.
const GRID_REACH: i32 = 8;
/// Corners of a circle.
const CIRCLE: usize = 32;
/// Radii of a key frame and of the current key frame, meters.
const KEYFRAME_RADII: [f32; 2] = [0.09, 0.16];

/// Half the width in pixels of a line with width `metres`, at least half a pixel.
fn half(scale: f32, metres: f32) -> f32 {
    (0.5 * scale * metres).max(0.5)
}

/// A polyline on the ground.
fn polyline(image: &mut Image, camera: &Camera, points: &[[f32; 2]], width: f32, colour: [u8; 3]) {
    let on_ground = |[x, z]: [f32; 2]| [x, 0.0, z];
    for pair in points.windows(2) {
        if let Some([a, b]) = camera.line(on_ground(pair[0]), on_ground(pair[1])) {
            let radii = [half(a.scale, width), half(b.scale, width)];
            image.stroke([a.at, b.at], radii, colour);
        }
    }
}

/// A disc on the ground.
fn disc(image: &mut Image, camera: &Camera, [x, z]: [f32; 2], radius: f32, colour: [u8; 3]) {
    let corners: Option<Vec<[f32; 2]>> = (0..CIRCLE)
        .map(|corner| {
            let (sin, cos) = (corner as f32 * std::f32::consts::TAU / CIRCLE as f32).sin_cos();
            let seen = camera.see([x + radius * cos, 0.0, z + radius * sin])?;
            Some(seen.at)
        })
        .collect();
    if let Some(corners) = corners {
        image.convex(&corners, colour);
    }
}

/// Static marks: a grid of one meter around `middle`, the goal, and the root trajectory.
pub(super) fn draw(
    image: &mut Image,
    camera: &Camera,
    middle: [f32; 2],
    floor: &Floor,
    trail: &[[f32; 2]],
) {
    let [x, z] = middle.map(|value| value.round().clamp(-1e6, 1e6));
    let reach = GRID_REACH as f32;
    for step in -GRID_REACH..=GRID_REACH {
        let step = step as f32;
        let across = [[x - reach, z + step], [x + reach, z + step]];
        let along = [[x + step, z - reach], [x + step, z + reach]];
        polyline(image, camera, &across, 0.012, GRID);
        polyline(image, camera, &along, 0.012, GRID);
    }
    for (centre, radius) in &floor.obstacles {
        disc(image, camera, *centre, *radius, OBSTACLE);
    }
    polyline(image, camera, trail, 0.02, TRAIL);
    polyline(image, camera, &floor.path, 0.05, PATH);
    for (_, at) in &floor.keyframes {
        disc(image, camera, *at, KEYFRAME_RADII[0], KEYFRAME);
    }
}

/// The current key frames, enlarged.
pub(super) fn draw_now(image: &mut Image, camera: &Camera, floor: &Floor, frame: usize) {
    let now = floor.keyframes.iter();
    for (_, at) in now.filter(|(key, _)| key.abs_diff(frame) <= 2) {
        disc(image, camera, *at, KEYFRAME_RADII[1], KEYFRAME);
    }
}
