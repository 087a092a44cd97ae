//! The panes of a scene, and the framing of the camera in each.

use super::{DRAWING, Figure, View, seen_from};
use crate::scene::{Floor, Scene, SceneObject};

/// A part of the picture with one figure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pane {
    /// Left and top in pixels.
    pub corner: [u32; 2],
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Height of the ground in meters.
    pub ground: f64,
}

/// The objects of a scene that have frames, side by side, as a page first shows them.
pub(crate) struct Stage<'a> {
    pub objects: Vec<&'a SceneObject>,
    pub figures: Vec<Figure>,
    pub floor: &'a Floor,
    /// Height of the tallest figure in meters.
    pub size: f64,
    /// Height of the common ground in meters.
    pub ground: f64,
    /// True if cameras follow the figures.
    pub follows: bool,
    pub panes: Vec<Pane>,
}

/// What a camera must see.
struct Framing {
    /// The axis through the target.
    axis: [f64; 2],
    /// `[reach, height]` around the axis.
    points: Vec<[f64; 2]>,
    /// Middle of the heights above the ground.
    rise: f64,
}

impl<'a> Stage<'a> {
    /// Places the figures in a picture of `size` pixels, with gaps of `scale` times their width.
    pub fn new(scene: &'a Scene, size: [u32; 2], scale: f64) -> Self {
        let objects: Vec<&SceneObject> = scene.objects.iter().filter(|o| o.frames() > 0).collect();
        let figures: Vec<Figure> = objects.iter().map(|object| Figure::of(object)).collect();
        let tallest = figures
            .iter()
            .map(|figure| figure.height)
            .fold(0.0, f64::max);
        let lowest = figures
            .iter()
            .map(|figure| figure.low[1])
            .fold(f64::INFINITY, f64::min);
        let lone = objects.iter().all(|object| object.joints() == 1);
        // Feet stand at 0, unless the file has another origin.
        let at_zero = lone || lowest.abs() < DRAWING.stage.other_origin * tallest;
        let ground = if at_zero { 0.0 } else { lowest };
        let mut panes = panes(figures.len(), size, (DRAWING.stage.gap * scale).round());
        for ((pane, object), figure) in panes.iter_mut().zip(&objects).zip(&figures) {
            // A body further above 0 than its height has another origin.
            let above = figure.low[1] - ground;
            let own = object.joints() > 1 && above > DRAWING.stage.own_ground * figure.height;
            pane.ground = if own { figure.low[1] } else { ground };
        }
        Self {
            follows: figures.iter().any(Figure::goes_far),
            objects,
            figures,
            floor: &scene.floor,
            size: tallest,
            ground,
            panes,
        }
    }

    /// The camera of each pane at a time. All have one scale and one height of the ground.
    pub fn views(&self, seconds: f64) -> Vec<View> {
        let framings: Vec<Framing> = (0..self.panes.len())
            .map(|pane| self.framing(pane, seconds))
            .collect();
        let lift = framings
            .iter()
            .map(|framing| framing.rise)
            .fold(f64::NEG_INFINITY, f64::max);
        let distances = framings.iter().zip(&self.panes).map(|(framing, pane)| {
            let points = framing.points.iter();
            let points: Vec<_> = points
                .map(|[reach, y]| [*reach, y - pane.ground - lift])
                .collect();
            let [width, height] = pane.size.map(f64::from);
            seen_from(&points, width / height)
        });
        let distance = distances.fold(0.0, f64::max);
        let views = framings.iter().zip(&self.panes).map(|(framing, pane)| {
            let [x, z] = framing.axis;
            View::new([x, pane.ground + lift, z], distance, pane.size)
        });
        views.collect()
    }

    fn framing(&self, index: usize, seconds: f64) -> Framing {
        let (figure, ground) = (&self.figures[index], self.panes[index].ground);
        let (own, outline) = match self.follows {
            true => {
                let (frame, part) = self.objects[index].place(seconds);
                let [a, b] = [frame, frame + 1].map(|frame| {
                    let last = figure.trajectory.len() - 1;
                    figure.trajectory[frame.min(last)]
                });
                let between = [0, 1].map(|axis| a[axis] + f64::from(part) * (b[axis] - a[axis]));
                (between, &figure.around_trajectory)
            }
            false => (figure.middle(), &figure.around_middle),
        };
        let goal = if self.follows {
            Vec::new()
        } else {
            goal_places(self.floor)
        };
        let places: Vec<[f64; 2]> = std::iter::once(own).chain(goal).collect();
        let axis = [0, 1].map(|axis| middle(places.iter().map(|place| place[axis])));
        let off = |place: &[f64; 2]| (place[0] - axis[0]).hypot(place[1] - axis[1]);
        let outline = outline.iter().map(|[reach, y]| [reach + off(&own), *y]);
        let marks = places.iter().map(|place| [off(place), ground]);
        let points: Vec<[f64; 2]> = outline.chain(marks).collect();
        let rise = middle(points.iter().map(|[_, y]| *y)) - ground;
        Framing { axis, points, rise }
    }
}

/// Panes of equal size in as many columns as make them largest.
fn panes(count: usize, [width, height]: [u32; 2], gap: f64) -> Vec<Pane> {
    let [width, height] = [width, height].map(f64::from);
    let side = |columns: usize| {
        let rows = count.div_ceil(columns);
        (width / columns as f64).min(height / rows as f64)
    };
    let columns = (1..=count).fold(1, |best, tried| {
        if side(tried) > side(best) {
            tried
        } else {
            best
        }
    });
    let rows = count.div_ceil(columns);
    let [w, h] = [(width + gap) / columns as f64, (height + gap) / rows as f64];
    let pane = |index: usize| Pane {
        corner: [
            ((index % columns) as f64 * w).round() as u32,
            ((index / columns) as f64 * h).round() as u32,
        ],
        size: [w, h].map(|side| (side - gap).round().max(1.0) as u32),
        ground: 0.0,
    };
    (0..count).map(pane).collect()
}

/// Middle between the smallest and the largest value.
fn middle(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    (low + high) / 2.0
}

/// Corners of the marks of a goal on the ground.
fn goal_places(floor: &Floor) -> Vec<[f64; 2]> {
    let discs = floor
        .obstacles
        .iter()
        .flat_map(|([x, z], radius)| [[x - radius, z - radius], [x + radius, z + radius]]);
    let keys = floor.keyframes.iter().map(|(_, place)| *place);
    let polygons = floor.polygons.iter().flatten().copied();
    let places = keys
        .chain(floor.path.iter().copied())
        .chain(discs)
        .chain(polygons);
    places.map(|place| place.map(f64::from)).collect()
}
