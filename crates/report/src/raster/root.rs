//! A lone root: a body with an arrow to its front if its orientation is known, else a ball; and a
//! vertical line to the ground.

use std::f64::consts::TAU;

use super::canvas::{Canvas, Ends, Ink, area, circle, lines};
use super::figure::Piece;
use super::floor::Ground;
use crate::drawing::{BLACK, Color, DRAWING, View, WHITE, dot};
use crate::scene::{cross, rotate};

/// Corners of the faces of a box, seen from outside; the bits of a corner are side, up and back.
const FACES: [[usize; 4]; 6] = [
    [0, 1, 3, 2],
    [5, 4, 6, 7],
    [4, 0, 2, 6],
    [1, 5, 7, 3],
    [2, 3, 7, 6],
    [4, 5, 1, 0],
];

/// A face of the body or of its arrow, corners in meters from the root.
type Face = Vec<[f64; 3]>;

pub(super) fn draw(
    canvas: &mut Canvas,
    ground: &Ground<'_>,
    at: [f64; 3],
    orientation: Option<[f32; 4]>,
    color: Color,
    pieces: &mut Vec<Piece>,
) {
    let (view, table, theme) = (ground.view, &DRAWING.root, &DRAWING.light);
    let seen = view.seen(at);
    if !view.shows(seen) {
        return;
    }
    let shadow = area(view, ground.circle([at[0], at[2]], table.shadow));
    canvas.fill(shadow.as_ref(), Ink(theme.shadow, DRAWING.shadow.opacity));
    let down = lines(view, [[at, [at[0], ground.level, at[2]]]]);
    canvas.stroke(
        down.as_ref(),
        table.line * ground.scale,
        Ends::Butt,
        theme.muted,
    );
    let Some(orientation) = orientation else {
        let path = circle(view.on_screen(seen), table.ball * view.scale / seen[2]);
        pieces.push(Piece {
            depth: seen[2],
            path,
            fill: Some(color),
            strokes: Vec::new(),
        });
        return;
    };
    let world = |point: [f64; 3]| {
        let turned = rotate(orientation, point.map(|value| value as f32));
        [0, 1, 2].map(|axis| at[axis] + f64::from(turned[axis]))
    };
    for part in in_order(world, at, view) {
        let (faces, color, is_round) = match part {
            Part::Body => (body(), color, false),
            Part::Shaft => (
                prism(table.shaft[0], table.shaft[0], shaft_ends()),
                theme.contact,
                true,
            ),
            Part::Head => (prism(table.head[0], 0.0, head_ends()), theme.contact, true),
        };
        for face in faces {
            let points = face.into_iter().map(world).collect();
            pieces.extend(solid(
                view,
                points,
                color,
                is_round,
                (seen[2], ground.scale),
            ));
        }
    }
}

#[derive(Clone, Copy)]
enum Part {
    Body,
    Shaft,
    Head,
}

/// The parts lie behind one another along the front: from far to near of the eye.
fn in_order(world: impl Fn([f64; 3]) -> [f64; 3], at: [f64; 3], view: &View) -> [Part; 3] {
    let front = world([0.0, 0.0, 1.0]);
    let front = [0, 1, 2].map(|axis| front[axis] - at[axis]);
    let towards = -dot(front, view.eye_to(at));
    match towards {
        _ if towards < shaft_ends()[0] => [Part::Head, Part::Shaft, Part::Body],
        _ if towards < shaft_ends()[1] => [Part::Body, Part::Head, Part::Shaft],
        _ => [Part::Body, Part::Shaft, Part::Head],
    }
}

/// Near and far end of the arrow's shaft and head along the front, meters.
fn shaft_ends() -> [f64; 2] {
    let from = DRAWING.root.body[2];
    [from, from + DRAWING.root.shaft[1]]
}

fn head_ends() -> [f64; 2] {
    let from = shaft_ends()[1];
    [from, from + DRAWING.root.head[1]]
}

fn body() -> Vec<Face> {
    let [width, height, depth] = DRAWING.root.body;
    let corner = |index: usize| {
        let sign = |bit: usize| if index & bit > 0 { 1.0 } else { -1.0 };
        [sign(1) * width, sign(2) * height, -sign(4) * depth]
    };
    FACES
        .iter()
        .map(|face| face.iter().map(|index| corner(*index)).collect())
        .collect()
}

/// Faces, seen from outside, of a prism or cone along z, without its far end.
fn prism(near: f64, far: f64, ends: [f64; 2]) -> Vec<Face> {
    let sides = DRAWING.root.sides;
    let ring = |radius: f64, z: f64| -> Face {
        let corner = |index: usize| {
            let (sin, cos) = (TAU * index as f64 / sides as f64).sin_cos();
            [radius * cos, radius * sin, z]
        };
        (0..sides).map(corner).collect()
    };
    let (a, b) = (ring(near, ends[0]), ring(far, ends[1]));
    let side = |index: usize| {
        let next = (index + 1) % sides;
        vec![a[index], a[next], b[next], b[index]]
    };
    let base = a.iter().rev().copied().collect();
    std::iter::once(base).chain((0..sides).map(side)).collect()
}

/// A face that is seen from outside, lit from above.
fn solid(
    view: &View,
    points: Face,
    color: Color,
    is_round: bool,
    (depth, scale): (f64, f64),
) -> Option<Piece> {
    let table = &DRAWING.root;
    let along = |point: usize| [0, 1, 2].map(|axis| points[point][axis] - points[0][axis]);
    let normal = cross(along(1), along(2));
    if dot(normal, view.eye_to(points[0])) >= 0.0 {
        return None;
    }
    let light = dot(table.light, normal) / dot(normal, normal).sqrt();
    let shade = match light > 0.0 {
        true => color.mixed(WHITE, table.lighter * light),
        false => color.mixed(BLACK, -table.darker * light),
    };
    let edge = if is_round {
        shade
    } else {
        color.mixed(BLACK, table.edge_darker)
    };
    Some(Piece {
        depth,
        path: area(view, points),
        fill: Some(shade),
        strokes: vec![(scale, edge)],
    })
}
