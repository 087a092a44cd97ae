//! Figures: bodies with bones, and lone roots.

use tiny_skia::Path;

use super::canvas::{Canvas, Ends, Ink, area, circle, lines, segment};
use super::floor::Ground;
use super::root;
use crate::drawing::{BLACK, Color, DRAWING, Figure, WHITE};
use crate::scene::{Pose, SceneObject, Side};

/// A part of a figure.
pub(super) struct Piece {
    /// Meters from the camera.
    pub depth: f64,
    pub path: Option<Path>,
    /// Color of the inside.
    pub fill: Option<Color>,
    /// Lines along the path, the first below: width in pixels and color.
    pub strokes: Vec<(f64, Color)>,
}

impl Piece {
    pub fn draw(&self, canvas: &mut Canvas) {
        if let Some(color) = self.fill {
            canvas.fill(self.path.as_ref(), color);
        }
        for (width, color) in &self.strokes {
            canvas.stroke(self.path.as_ref(), *width, Ends::Round, *color);
        }
    }
}

/// Draws an object in `pose` with its shadow; `standing` are the joints in contact.
pub(super) fn draw(
    canvas: &mut Canvas,
    ground: &Ground<'_>,
    (object, figure, color): (&SceneObject, &Figure, Color),
    pose: &Pose,
    standing: &[usize],
) {
    let joints: Vec<[f64; 3]> = pose
        .joints
        .iter()
        .map(|place| place.map(f64::from))
        .collect();
    let mut pieces = Vec::new();
    if object.joints() == 1 {
        root::draw(
            canvas,
            ground,
            joints[0],
            pose.orientation,
            color,
            &mut pieces,
        );
    } else {
        shadow(canvas, ground, figure, &joints);
        pieces = skeleton(ground, figure, &joints, color);
    }
    for joint in standing {
        touch(canvas, ground, figure, joints[*joint], &mut pieces);
    }
    pieces.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    for piece in &pieces {
        piece.draw(canvas);
    }
}

fn shadow(canvas: &mut Canvas, ground: &Ground<'_>, figure: &Figure, joints: &[[f64; 3]]) {
    let flat = |joint: usize| [joints[joint][0], ground.level, joints[joint][2]];
    let bones = figure.bones.iter();
    let bones = bones.map(|bone| [flat(bone.parent), flat(bone.joint)]);
    let (view, table) = (ground.view, &DRAWING.shadow);
    let width = (table.width * figure.height * view.scale / view.far).max(ground.scale);
    let ink = Ink(DRAWING.light.shadow, table.opacity);
    canvas.stroke(lines(view, bones).as_ref(), width, Ends::Round, ink);
}

fn skeleton(ground: &Ground<'_>, figure: &Figure, joints: &[[f64; 3]], color: Color) -> Vec<Piece> {
    let (view, scale, background) = (ground.view, ground.scale, DRAWING.light.stage);
    let seen: Vec<[f64; 3]> = joints.iter().map(|place| view.seen(*place)).collect();
    let (table, ball) = (&DRAWING.bone, &DRAWING.ball);
    let mut pieces = Vec::new();
    for bone in &figure.bones {
        let ends = [seen[bone.parent], seen[bone.joint]];
        if !ends.iter().all(|end| view.shows(*end)) {
            continue;
        }
        let depth = (ends[0][2] + ends[1][2]) / 2.0;
        let width = (2.0 * bone.radius * view.scale / depth).max(table.least_width * scale);
        let shade = match bone.side {
            Side::Left => color.mixed(WHITE, table.left_lighter),
            Side::Right => color.mixed(BLACK, table.right_darker),
            Side::Middle => color,
        };
        pieces.push(Piece {
            depth,
            path: segment(ends.map(|end| view.on_screen(end))),
            fill: None,
            strokes: vec![
                (width + 2.0 * table.edge * scale, background),
                (width, shade),
            ],
        });
    }
    let dots = if figure.bones.is_empty() {
        0..seen.len()
    } else {
        0..0
    };
    let dots = dots.map(|joint| ([joint, joint], ball.joint));
    for ([joint, other], radius) in dots.chain(figure.head.map(|ends| (ends, ball.head))) {
        let [a, b] = [joint, other].map(|joint| (seen[joint], view.on_screen(seen[joint])));
        let depth = (a.0[2] + b.0[2]) / 2.0;
        if depth < view.near {
            continue;
        }
        let radius = radius * figure.height;
        let size = (radius * view.scale / depth).max(ball.least * scale);
        pieces.push(Piece {
            depth: depth - radius,
            path: circle([0, 1].map(|axis| (a.1[axis] + b.1[axis]) / 2.0), size),
            fill: Some(color),
            strokes: vec![(ball.edge * scale, background)],
        });
    }
    pieces
}

/// A joint that stands on the ground: a ring below it, and a highlighted joint.
fn touch(
    canvas: &mut Canvas,
    ground: &Ground<'_>,
    figure: &Figure,
    place: [f64; 3],
    pieces: &mut Vec<Piece>,
) {
    let (view, table) = (ground.view, &DRAWING.contact);
    let ring = ground.circle([place[0], place[2]], table.ring * figure.height);
    let color = DRAWING.light.contact;
    canvas.fill(area(view, ring).as_ref(), Ink(color, table.ring_opacity));
    let seen = view.seen(place);
    if !view.shows(seen) {
        return;
    }
    let size = (table.dot * figure.height * view.scale / seen[2]).max(table.least * ground.scale);
    pieces.push(Piece {
        depth: seen[2] - table.nearer * figure.height,
        path: circle(view.on_screen(seen), size),
        fill: Some(color),
        strokes: Vec::new(),
    });
}
