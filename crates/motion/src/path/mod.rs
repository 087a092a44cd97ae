//! Paths on the ground by arc length, path features, and warping of motions onto paths.
//!
//! Ground points are `[x, z]` in metres. A heading is `atan2(dx, dz)`: 0 along +z, growing towards
//! +x. Source: docs/sources.md, section 7, with the readings in `docs/paths.md`.
//!
//! ```
//! use kinegrad_motion::path::Polyline;
//! let line = Polyline::new(vec![[0.0, 0.0], [0.0, 3.0], [4.0, 3.0]])?;
//! assert_eq!(line.length(), 7.0);
//! assert_eq!(line.at(5.0 / 7.0).point, [2.0, 3.0]);
//! # Ok::<(), kinegrad_motion::path::PathError>(())
//! ```

mod bend;
mod course;
mod error;
mod headings;
mod idle;
mod loss;
mod measures;
mod plan;
mod polyline;
mod smoothing;
mod spline;
mod svg;
mod warp;

pub use bend::Bend;
pub use course::{ArcLengthMode, Course};
pub use error::PathError;
pub use headings::{PathFeatures, headings_of, headings_of_gait, unwrapped, wrapped};
pub use loss::{PathLoss, PathLossConfig, root_channels};
pub use measures::{PathReport, distance_from, slide, travelled};
pub use plan::{CurveKind, PathPlan};
pub use polyline::{PathPoint, Polyline};
pub use smoothing::{Edges, HEADING_ORDER, HEADING_WINDOW, savgol, savgol_weights, smoothed};
pub use spline::{CatmullRom, Parameterization};
pub use warp::{HeadingMode, Warp, Warped, placed};

/// Smallest step with a direction, metres per frame, and shortest path with a direction, metres.
const STILL: f64 = 1e-6;

fn between([ax, az]: [f64; 2], [bx, bz]: [f64; 2]) -> f64 {
    (bx - ax).hypot(bz - az)
}
