//! The axis of a file that points up.

use kinegrad_motion::Quaternion;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The axis of a capture file that points up.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UpAxis {
    /// +y, as in phrases and most BVH files.
    #[default]
    Y,
    /// +z, as in most C3D files.
    Z,
}

impl UpAxis {
    /// The vector in the y-up frame: (x, y, z) becomes (x, z, -y) where z points up.
    pub fn to_y_up(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Y => [x, y, z],
            Self::Z => [x, z, -y],
        }
    }

    /// The same turn, with world and body axes in the y-up frame: an upright rest pose stays the
    /// identity.
    pub fn turn_to_y_up(self, turn: Quaternion) -> Quaternion {
        let [x, y, z] = self.to_y_up([turn.x, turn.y, turn.z]);
        Quaternion::new(turn.w, x, y, z)
    }
}
