//! Draws a scene at many times.

use super::canvas::{Canvas, Image, rectangle};
use super::figure;
use super::floor::Ground;
use crate::drawing::{DRAWING, Stage};
use crate::scene::Scene;

/// A scene in pictures of one size.
pub(crate) struct Painter<'a> {
    stage: Stage<'a>,
    size: (u32, u32),
    /// Pixels of a line of width 1.
    scale: f64,
}

impl<'a> Painter<'a> {
    /// Prepares pictures of `size` pixels, with lines and text `scale` times as large as on a page.
    pub fn new(scene: &'a Scene, size: (u32, u32), scale: f64) -> Self {
        Self {
            stage: Stage::new(scene, [size.0, size.1], scale),
            size,
            scale,
        }
    }

    /// The scene at a time.
    pub fn at(&self, seconds: f64) -> Image {
        let Self { stage, size, .. } = self;
        let background = match stage.panes.len() {
            0 => DRAWING.light.stage,
            // Between the panes.
            _ => DRAWING.light.grid,
        };
        let mut image = Image::filled(size.0, size.1, background.0);
        let goal_frame = stage
            .objects
            .first()
            .map_or(0, |object| object.place(seconds).0);
        for (index, view) in stage.views(seconds).iter().enumerate() {
            let (object, pane) = (stage.objects[index], &stage.panes[index]);
            let (figure, color) = (&stage.figures[index], DRAWING.color_of(index));
            let ground = Ground {
                stage,
                view,
                level: pane.ground,
                scale: self.scale,
            };
            let (frame, _) = object.place(seconds);
            let mut canvas = Canvas::filled(pane.size, DRAWING.light.stage);
            ground.grid(&mut canvas);
            ground.trail(&mut canvas, object, figure.root, frame, color);
            ground.goal(&mut canvas, goal_frame);
            let contacts = object.contacts.iter();
            let contacts = contacts.filter(|contact| contact.frames.get(frame) == Some(&true));
            let standing: Vec<usize> = contacts.map(|contact| contact.joint).collect();
            let pose = object.pose(seconds);
            figure::draw(
                &mut canvas,
                &ground,
                (object, figure, color),
                &pose,
                &standing,
            );
            self.label(&mut canvas, index);
            image.paste(&canvas, pane.corner);
        }
        image
    }

    /// The name of a figure.
    fn label(&self, canvas: &mut Canvas, index: usize) {
        let (table, scale, pane) = (&DRAWING.label, self.scale, &self.stage.panes[index]);
        let square = [table.left, table.top + 1.5].map(|at| at * scale);
        let square = rectangle(square, [table.square * scale; 2]);
        canvas.fill(square.as_ref(), DRAWING.color_of(index));
        let mut name = self.stage.objects[index].name.clone();
        if pane.ground != self.stage.ground {
            name += &format!(" · ground at {:.2} m", pane.ground);
        }
        let at = [table.text_left, table.top + table.square + 1.0].map(|at| at * scale);
        let most = f64::from(pane.size[0]) - (table.text_left + table.top) * scale;
        canvas.text(&name, at, table.size * scale, most, DRAWING.light.ink);
    }
}
