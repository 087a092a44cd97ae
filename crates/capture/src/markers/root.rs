//! The pelvis pose from markers.
//!
//! With `f` from the back to the front markers and `l` from the right to the left markers, the
//! columns of the rotation matrix are the body axes
//! ```text
//! z_b = f / |f|    x_b = (l - (l . z_b) z_b) / |...|    y_b = z_b x x_b
//! ```

use kinegrad_motion::Quaternion;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::track::{MarkerGaps, lerp, split};
use crate::{RootPose, RootSource};

/// Shortest vector with a direction, in metres.
const SHORTEST: f64 = 1e-6;

/// The root of a C3D take, from [`MarkerMap::root`](super::MarkerMap::root). Between frames, the
/// markers are interpolated, not the root.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerRoot {
    frames: Vec<Option<Axes>>,
    rate: f64,
    gaps: Vec<MarkerGaps>,
    /// Turns the body about its own axes, after all other corrections.
    levelling: Quaternion,
}

/// Axes of the body in one frame, from its markers, in metres and y-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axes {
    pub center: [f64; 3],
    pub forward: [f64; 3],
    pub left: [f64; 3],
}

impl MarkerRoot {
    /// A root from the markers of each frame; with `level`, without its mean pitch. None if no
    /// frame has usable axes.
    pub(super) fn new(
        frames: Vec<Option<Axes>>,
        rate: f64,
        gaps: Vec<MarkerGaps>,
        level: bool,
    ) -> Option<Self> {
        let usable = |axes: &Axes| axes.orientation().is_some();
        let frames: Vec<_> = frames.into_iter().map(|axes| axes.filter(usable)).collect();
        let pitches: Vec<f64> = frames.iter().flatten().map(Axes::pitch).collect();
        if pitches.is_empty() {
            return None;
        }
        // A turn about the body's left by a positive angle lowers its forward axis.
        let pitch = pitches.iter().sum::<f64>() / pitches.len() as f64;
        let turn = if level { pitch } else { 0.0 };
        Some(Self {
            frames,
            rate,
            gaps,
            levelling: Quaternion::from_rotation_vector([turn, 0.0, 0.0]),
        })
    }
}

impl RootSource for MarkerRoot {
    fn frames(&self) -> usize {
        self.frames.len()
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn gaps(&self) -> &[MarkerGaps] {
        &self.gaps
    }

    fn sample(&self, frame: f64) -> Option<RootPose> {
        let (t, fraction) = split(frame, self.frames.len())?;
        let mut axes = self.frames[t]?;
        if fraction > 0.0 {
            let next = self.frames[t + 1]?;
            axes = Axes {
                center: lerp(axes.center, next.center, fraction),
                forward: lerp(axes.forward, next.forward, fraction),
                left: lerp(axes.left, next.left, fraction),
            };
        }
        Some(RootPose {
            position: axes.center,
            orientation: axes.orientation()? * self.levelling,
        })
    }
}

impl Axes {
    /// None where forward or left has no length or both are parallel.
    fn orientation(&self) -> Option<Quaternion> {
        let z = Vector3::from(self.forward).try_normalize(SHORTEST)?;
        let left = Vector3::from(self.left);
        let x = (left - z * left.dot(&z)).try_normalize(SHORTEST)?;
        let matrix = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        Some(Quaternion::new(turn.w, turn.i, turn.j, turn.k))
    }

    /// Angle of the forward axis above the horizon in radians.
    fn pitch(&self) -> f64 {
        let [x, y, z] = self.forward;
        y.atan2(x.hypot(z))
    }
}
