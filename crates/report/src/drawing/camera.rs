//! A camera that looks at a target from the front at an angle, as the viewer's camera before it is
//! moved.

use super::DRAWING;

/// A camera in a pane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    eye: [f64; 3],
    /// Right, up and ahead.
    axes: [[f64; 3]; 3],
    /// Pixels per meter at a distance of one meter.
    pub scale: f64,
    /// Middle of the pane in pixels.
    center: [f64; 2],
    /// Distance of the near plane, meters.
    pub near: f64,
    /// Distance of the target, meters.
    pub far: f64,
    /// The target.
    pub target: [f64; 3],
}

/// Smallest distance from which a camera sees all `points` from any side. Points are `[reach,
/// rise]`: the distance from the vertical axis through the target, and the height above the target.
/// `aspect` is width by height of the pane.
pub(crate) fn seen_from(points: &[[f64; 2]], aspect: f64) -> f64 {
    let (sin, cos) = DRAWING.camera.pitch.sin_cos();
    let half = DRAWING.camera.filled * half_view();
    let distances = points.iter().map(|[reach, rise]| {
        let before = (rise * cos - reach * sin).abs() / half + reach * cos;
        let behind = (rise * cos + reach * sin).abs() / half - reach * cos;
        let beside = reach * (1.0 / (half * aspect)).hypot(cos);
        before.max(behind).max(beside) + rise * sin
    });
    distances.fold(0.0, f64::max)
}

/// Half the height of the view at a distance of one.
fn half_view() -> f64 {
    (DRAWING.camera.view_degrees.to_radians() / 2.0).tan()
}

impl View {
    /// A camera that looks at `target` from `distance`, in a pane of `[width, height]` pixels.
    pub fn new(target: [f64; 3], distance: f64, [width, height]: [u32; 2]) -> Self {
        let (sin_yaw, cos_yaw) = DRAWING.camera.yaw.sin_cos();
        let (sin, cos) = DRAWING.camera.pitch.sin_cos();
        let ahead = [-sin_yaw * cos, -sin, -cos_yaw * cos];
        Self {
            eye: [0, 1, 2].map(|axis| target[axis] - distance * ahead[axis]),
            axes: [
                [cos_yaw, 0.0, -sin_yaw],
                [-sin_yaw * sin, cos, -cos_yaw * sin],
                ahead,
            ],
            scale: f64::from(height) / 2.0 / half_view(),
            center: [width, height].map(|side| f64::from(side) / 2.0),
            near: DRAWING.camera.near * distance,
            far: distance,
            target,
        }
    }

    /// Right, up and depth of a point.
    pub fn seen(&self, point: [f64; 3]) -> [f64; 3] {
        let eye_to = self.eye_to(point);
        self.axes.map(|axis| dot(axis, eye_to))
    }

    /// The vector from the eye to a point.
    pub fn eye_to(&self, point: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| point[axis] - self.eye[axis])
    }

    /// The pixel of a seen point.
    pub fn on_screen(&self, [x, y, depth]: [f64; 3]) -> [f64; 2] {
        let part = self.scale / depth;
        [self.center[0] + part * x, self.center[1] - part * y]
    }

    /// True if a seen point is before the near plane.
    pub fn shows(&self, seen: [f64; 3]) -> bool {
        seen[2] > self.near
    }

    /// The point between two seen points that lies on the near plane.
    pub fn clipped(&self, a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
        let part = (self.near - a[2]) / (b[2] - a[2]);
        [0, 1, 2].map(|axis| a[axis] + part * (b[axis] - a[axis]))
    }
}

/// The scalar product.
pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_sees_a_cylinder_and_little_more() {
        for (reach, rise, size) in [
            (0.5, 0.9, [300, 200]),
            (4.0, 0.5, [300, 200]),
            (0.2, 2.0, [100, 400]),
        ] {
            let points = [[reach, rise], [reach, -rise]];
            let aspect = f64::from(size[0]) / f64::from(size[1]);
            let view = View::new([1.0, 2.0, 3.0], seen_from(&points, aspect), size);
            let mut least = f64::INFINITY;
            for degrees in 0..360 {
                let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                for y in [-rise, rise] {
                    let seen = view.seen([1.0 + reach * sin, 2.0 + y, 3.0 + reach * cos]);
                    assert!(view.shows(seen));
                    let at = view.on_screen(seen);
                    let free = [0, 1].map(|axis| {
                        let size = f64::from(size[axis]);
                        at[axis].min(size - at[axis]) / size
                    });
                    least = least.min(free[0].min(free[1]));
                }
            }
            assert!((0.045..0.08).contains(&least), "{reach} {rise}: {least}");
        }
    }

    #[test]
    fn up_is_up_and_what_is_nearer_is_larger() {
        let view = View::new([0.0, 1.0, 0.0], 5.0, [200, 200]);
        let at = |point| view.on_screen(view.seen(point));
        assert!(at([0.0, 2.0, 0.0])[1] < at([0.0, 0.0, 0.0])[1]);
        assert!(at([0.5, 1.0, 0.0])[0] > at([-0.5, 1.0, 0.0])[0]);
        assert!(view.seen([0.0, 1.0, 1.0])[2] < view.seen([0.0, 1.0, -1.0])[2]);
        for (i, a) in view.axes.iter().enumerate() {
            for (j, b) in view.axes.iter().enumerate() {
                assert!((dot(*a, *b) - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
    }
}
