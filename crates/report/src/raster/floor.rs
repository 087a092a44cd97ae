//! Marks on the floor.

use std::ops::Range;

use tiny_skia::Path;

use super::canvas::{Canvas, Ends, Ink, area, lines};
use crate::drawing::{Color, DRAWING, Stage, View};
use crate::scene::SceneObject;

/// The floor of a pane.
pub(super) struct Ground<'a> {
    pub stage: &'a Stage<'a>,
    pub view: &'a View,
    /// Height in meters.
    pub level: f64,
    /// Pixels of a line of width 1.
    pub scale: f64,
}

impl Ground<'_> {
    /// A round grid of squares below the target.
    pub fn grid(&self, canvas: &mut Canvas) {
        let (view, table) = (self.view, &DRAWING.floor);
        let least = view.far / table.most_cells;
        let cell = 10f64.powf(
            (self.stage.size / table.size_per_cell)
                .max(least)
                .log10()
                .round(),
        );
        let cells = (table.reach * view.far / cell / 2.0).ceil() as i32;
        let reach = f64::from(cells) * cell;
        let [x, z] = [view.target[0], view.target[2]].map(|value| (value / cell).round() * cell);
        let y = self.level;
        let both = (-cells..=cells).flat_map(|step| {
            let by = f64::from(step) * cell;
            let half = (reach * reach - by * by).max(0.0).sqrt();
            [
                [[x + by, y, z - half], [x + by, y, z + half]],
                [[x - half, y, z + by], [x + half, y, z + by]],
            ]
        });
        let width = table.width * self.scale;
        canvas.stroke(
            lines(view, both).as_ref(),
            width,
            Ends::Butt,
            DRAWING.light.grid,
        );
    }

    /// The root trajectory, faint.
    pub fn trail(&self, canvas: &mut Canvas, object: &SceneObject, root: usize, color: Color) {
        let table = &DRAWING.trail;
        let path = self.course(object, root, 0..object.frames() - 1, table.points);
        let ink = Ink(color, table.opacity);
        canvas.stroke(path.as_ref(), table.width * self.scale, Ends::Bent, ink);
    }

    /// The last seconds of the root trajectory.
    pub fn recent_trail(
        &self,
        canvas: &mut Canvas,
        object: &SceneObject,
        root: usize,
        frame: usize,
        color: Color,
    ) {
        let table = &DRAWING.trail;
        let from = frame.saturating_sub((table.recent_seconds * object.fps).round() as usize);
        let path = self.course(object, root, from..frame, table.recent_points);
        let ink = Ink(color, table.recent_opacity);
        canvas.stroke(
            path.as_ref(),
            table.recent_width * self.scale,
            Ends::Bent,
            ink,
        );
    }

    /// The root trajectory from the first frame of a range to its end, of about `most` points.
    fn course(
        &self,
        object: &SceneObject,
        root: usize,
        frames: Range<usize>,
        most: usize,
    ) -> Option<Path> {
        let step = frames.len().div_ceil(most).max(1);
        let last = frames.end;
        let points = frames.step_by(step).chain([last]).map(|frame| {
            let [x, _, z] = object.joint(frame, root).map(f64::from);
            [x, self.level, z]
        });
        lines(self.view, [points])
    }

    /// The goal; key frames near `frame` are highlighted.
    pub fn goal(&self, canvas: &mut Canvas, frame: usize) {
        let (view, table, theme) = (self.view, &DRAWING.goal, &DRAWING.light);
        let standing = |[x, z]: [f32; 2]| [f64::from(x), self.level, f64::from(z)];
        let floor = self.stage.floor;
        let discs = floor
            .obstacles
            .iter()
            .map(|(center, radius)| self.circle(center.map(f64::from), f64::from(*radius)));
        let polygons = floor.polygons.iter();
        let polygons = polygons.map(|corners| corners.iter().map(|at| standing(*at)).collect());
        for shape in discs.chain(polygons) {
            let path = area(view, shape);
            canvas.fill(path.as_ref(), Ink(theme.obstacle, table.area_opacity));
            canvas.stroke(
                path.as_ref(),
                table.width * self.scale,
                Ends::Bent,
                theme.obstacle,
            );
        }
        let path = lines(view, [floor.path.iter().map(|at| standing(*at))]);
        let dash = table.dash.map(|part| part * self.scale);
        canvas.dashed(
            path.as_ref(),
            table.width * self.scale,
            Ends::Bent,
            Some(dash),
            theme.goal,
        );
        for (at, place) in &floor.keyframes {
            let (opacity, width) = match at.abs_diff(frame) <= table.near_frames {
                true => (table.near_opacity, table.near_ring_width),
                false => (table.opacity, table.ring_width),
            };
            let ring = self.circle(place.map(f64::from), table.keyframe * self.stage.size);
            let ring = area(view, ring);
            canvas.fill(ring.as_ref(), Ink(theme.goal, opacity));
            canvas.stroke(ring.as_ref(), width * self.scale, Ends::Bent, theme.goal);
            let center = view.seen(standing(*place));
            if view.shows(center) {
                let [x, y] = view.on_screen(center);
                let at_right = [x + 8.0 * self.scale, y - 6.0 * self.scale];
                let size = DRAWING.label.keyframe_size * self.scale;
                canvas.text(&at.to_string(), at_right, size, f64::INFINITY, theme.ink);
            }
        }
    }

    /// Corners of a circle on the ground.
    pub fn circle(&self, [x, z]: [f64; 2], radius: f64) -> Vec<[f64; 3]> {
        let corners = DRAWING.goal.corners;
        let corner = |index: usize| {
            let (sin, cos) = (index as f64 * std::f64::consts::TAU / corners as f64).sin_cos();
            [x + radius * cos, self.level, z + radius * sin]
        };
        (0..corners).map(corner).collect()
    }
}
