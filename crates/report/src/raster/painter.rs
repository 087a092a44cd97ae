//! Draws a scene at many times.

use super::canvas::{Canvas, Image, rectangle};
use super::figure;
use super::floor::Ground;
use crate::drawing::{DRAWING, Stage, View};
use crate::scene::Scene;

/// A scene in pictures of one size.
pub(crate) struct Painter<'a> {
    stage: Stage<'a>,
    size: (u32, u32),
    /// Pixels of a line of width 1.
    scale: f64,
    /// What never changes in each pane, if the cameras are at rest.
    still: Vec<Canvas>,
}

impl<'a> Painter<'a> {
    /// Prepares pictures of `size` pixels, with lines and text `scale` times as large as on a page.
    pub fn new(scene: &'a Scene, size: (u32, u32), scale: f64) -> Self {
        let mut painter = Self {
            stage: Stage::new(scene, [size.0, size.1], scale),
            size,
            scale,
            still: Vec::new(),
        };
        if !painter.stage.follows {
            let views = painter.stage.views(0.0);
            let still = views
                .iter()
                .enumerate()
                .map(|(index, view)| painter.still(index, view));
            painter.still = still.collect();
        }
        painter
    }

    fn ground<'b>(&'b self, index: usize, view: &'b View) -> Ground<'b> {
        Ground {
            stage: &self.stage,
            view,
            level: self.stage.panes[index].ground,
            scale: self.scale,
        }
    }

    /// The grid and the root trajectory in a pane.
    fn still(&self, index: usize, view: &View) -> Canvas {
        let (object, root) = (self.stage.objects[index], self.stage.figures[index].root);
        let ground = self.ground(index, view);
        let mut canvas = Canvas::filled(self.stage.panes[index].size, DRAWING.light.stage);
        ground.grid(&mut canvas);
        ground.trail(&mut canvas, object, root, DRAWING.color_of(index));
        canvas
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
            let ground = self.ground(index, view);
            let (frame, _) = object.place(seconds);
            let still = self.still.get(index).cloned();
            let mut canvas = still.unwrap_or_else(|| self.still(index, view));
            ground.recent_trail(&mut canvas, object, figure.root, frame, color);
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
