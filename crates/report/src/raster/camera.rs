//! The camera.

use crate::scene::bounds;

/// Vertical field of view in radians.
const FIELD_OF_VIEW: f32 = 0.6;
/// Azimuth from the front, in radians.
const AZIMUTH: f32 = 0.55;
/// Downward angle, in radians.
const ELEVATION: f32 = 0.3;
/// Near plane in meters.
const NEAR: f32 = 0.1;
/// Margin as a part of the view.
const MARGIN: f32 = 0.1;

/// A camera that looks at a target from the front at an angle. Bodies at rest face +z, towards the
/// camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    eye: [f32; 3],
    /// Right, down and forward.
    axes: [[f32; 3]; 3],
    /// Pixels per meter at a distance of one meter.
    focal: f32,
    centre: [f32; 2],
}

/// A projected point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Pixels from the left and from the top.
    pub at: [f32; 2],
    /// Meters from the camera.
    pub depth: f32,
    /// Pixels per meter at the point.
    pub scale: f32,
}

/// Least distance from the target, in meters.
const NEAREST: f32 = 2.0;

impl Camera {
    /// A camera that shows all points in a picture of `size` pixels.
    pub fn around(points: &[[f32; 3]], size: (u32, u32)) -> Self {
        let target = middle(points);
        let free = 2.0 * MARGIN * (size.0.min(size.1) as f32);
        let fits = |distance: f32| {
            let seen = Self::at(target, distance, size).extent(points);
            seen.is_some_and(|[low, high]| {
                let wide = [high[0] - low[0], high[1] - low[1]];
                wide[0] <= size.0 as f32 - free && wide[1] <= size.1 as f32 - free
            })
        };
        let (mut near, mut far) = (NEAREST / 2.0, NEAREST);
        while !fits(far) && far < 1e4 {
            (near, far) = (far, 2.0 * far);
        }
        for _ in 0..20 {
            let middle = (near + far) / 2.0;
            if fits(middle) {
                far = middle;
            } else {
                near = middle;
            }
        }
        let mut camera = Self::at(target, far.max(NEAREST), size);
        if let Some([low, high]) = camera.extent(points) {
            let sizes = [size.0 as f32, size.1 as f32];
            for axis in 0..2 {
                camera.centre[axis] += (sizes[axis] - low[axis] - high[axis]) / 2.0;
            }
        }
        camera
    }

    /// The bounding box of projected points, if all are in front of the camera.
    fn extent(&self, points: &[[f32; 3]]) -> Option<[[f32; 2]; 2]> {
        let seen = points.iter().map(|point| Some(self.see(*point)?.at));
        let seen: Vec<[f32; 2]> = seen.collect::<Option<_>>()?;
        (!seen.is_empty()).then(|| bounds(&seen))
    }

    /// A camera that looks at `target` from `distance`.
    fn at(target: [f32; 3], distance: f32, (width, height): (u32, u32)) -> Self {
        let (side, front) = AZIMUTH.sin_cos();
        let (high, flat) = ELEVATION.sin_cos();
        let forward = [-side * flat, -high, -front * flat];
        let axes = [
            [front, 0.0, -side],
            [side * high, -flat, front * high],
            forward,
        ];
        Self {
            eye: [0, 1, 2].map(|axis| target[axis] - distance * forward[axis]),
            axes,
            focal: height as f32 / 2.0 / (FIELD_OF_VIEW / 2.0).tan(),
            centre: [width as f32 / 2.0, height as f32 / 2.0],
        }
    }

    /// The camera moved by a vector.
    pub fn moved(mut self, by: [f32; 3]) -> Self {
        for (eye, by) in self.eye.iter_mut().zip(by) {
            *eye += by;
        }
        self
    }

    /// The vector from a point to the camera.
    pub fn towards(&self, point: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|axis| self.eye[axis] - point[axis])
    }

    /// The projection of a point in front of the camera.
    pub fn see(&self, point: [f32; 3]) -> Option<Seen> {
        let view = self.view(point);
        (view[2] > NEAR).then(|| self.project(view))
    }

    /// The projection of the part of a line in front of the camera.
    pub fn line(&self, a: [f32; 3], b: [f32; 3]) -> Option<[Seen; 2]> {
        let mut ends = [self.view(a), self.view(b)];
        if ends[0][2] <= NEAR && ends[1][2] <= NEAR {
            return None;
        }
        let [from, to] = ends;
        for end in &mut ends {
            if end[2] <= NEAR {
                let part = (2.0 * NEAR - from[2]) / (to[2] - from[2]);
                *end = [0, 1, 2].map(|axis| from[axis] + part * (to[axis] - from[axis]));
            }
        }
        Some(ends.map(|end| self.project(end)))
    }

    /// A point in camera coordinates.
    fn view(&self, point: [f32; 3]) -> [f32; 3] {
        self.axes.map(|axis| {
            let parts = axis.iter().zip(point).zip(self.eye);
            parts.map(|((axis, point), eye)| axis * (point - eye)).sum()
        })
    }

    fn project(&self, view: [f32; 3]) -> Seen {
        let scale = self.focal / view[2];
        Seen {
            at: [0, 1].map(|axis| self.centre[axis] + scale * view[axis]),
            depth: view[2],
            scale,
        }
    }
}

/// The center of the bounding box.
pub(super) fn middle(points: &[[f32; 3]]) -> [f32; 3] {
    let [low, high] = bounds(points);
    [0, 1, 2].map(|axis| (low[axis] + high[axis]) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corners([low, high]: [[f32; 3]; 2]) -> Vec<[f32; 3]> {
        let corner = |n: usize| [0, 1, 2].map(|axis| [low, high][(n >> axis) & 1][axis]);
        (0..8).map(corner).collect()
    }

    #[test]
    fn a_camera_shows_a_box_and_little_more() {
        for bounds in [
            [[-0.5, 0.0, -0.5], [0.5, 1.8, 0.5]],
            [[-4.0, 0.0, 2.0], [4.0, 1.0, 3.0]],
        ] {
            let points = corners(bounds);
            let camera = Camera::around(&points, (300, 200));
            let seen: Vec<Seen> = points
                .into_iter()
                .map(|corner| camera.see(corner).expect("before the camera"))
                .collect();
            let reach = |axis: usize| {
                let low = seen.iter().map(|seen| seen.at[axis]).fold(1e9, f32::min);
                let high = seen.iter().map(|seen| seen.at[axis]).fold(-1e9, f32::max);
                (low, high)
            };
            let ((left, right), (top, bottom)) = (reach(0), reach(1));
            assert!(left >= 19.9 && right <= 280.1 && top >= 19.9 && bottom <= 180.1);
            // The points reach one side.
            let free = left.min(300.0 - right).min(top).min(200.0 - bottom);
            assert!(free < 20.5, "{free}");
        }
    }

    #[test]
    fn up_is_up_and_what_is_nearer_is_larger() {
        let camera = Camera::around(&corners([[-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]]), (200, 200));
        let see = |x, y, z| camera.see([x, y, z]).unwrap();
        assert!(see(0.0, 2.0, 0.0).at[1] < see(0.0, 0.0, 0.0).at[1]);
        assert!(see(0.5, 1.0, 0.0).at[0] > see(-0.5, 1.0, 0.0).at[0]);
        assert!(see(0.0, 1.0, 1.0).scale > see(0.0, 1.0, -1.0).scale);
        let axes = camera.axes;
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate() {
                let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                assert!((dot - f32::from(u8::from(i == j))).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn lines_end_before_the_camera() {
        let camera = Camera::around(&corners([[-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]]), (200, 200));
        let behind = [0, 1, 2].map(|axis| camera.eye[axis] - 3.0 * camera.axes[2][axis]);
        assert!(camera.see(behind).is_none());
        let [from, to] = camera.line([0.0; 3], behind).unwrap();
        assert!(from.depth > 1.0 && to.depth > 0.0 && to.depth < 0.5);
        assert!(camera.line(behind, behind).is_none());
    }
}
