//! Settings of the emphasis projection.

use kinegrad_random::{Key, Purpose};
use kinegrad_settings::{InvalidSetting, Refused, require};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{EmphasisError, EmphasisProjection};

/// Kind of matrix that mixes the emphasized features.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EmphasisKind {
    /// No projection.
    #[default]
    None,
    /// Independent normal numbers, as in published models.
    Gaussian,
    /// A random rotation or reflection, which has the smallest condition number.
    Orthogonal,
}

/// Emphasis of the trajectory within a frame's features (GMD, appendix C). The matrix follows from
/// these settings and the number of features, and is stored with the model.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EmphasisConfig {
    /// Kind of matrix.
    pub kind: EmphasisKind,
    /// Factor of the emphasized features, c in the source.
    pub scale: f64,
    /// Seed of the matrix.
    pub seed: u64,
    /// The emphasized features: root rotation, x and z.
    pub channels: Vec<usize>,
}

impl Default for EmphasisConfig {
    /// No projection. If only `kind` is set, the scale is the published 10.
    fn default() -> Self {
        Self {
            kind: EmphasisKind::None,
            scale: 10.0,
            seed: 0,
            channels: vec![0, 1, 2],
        }
    }
}

impl EmphasisConfig {
    /// # Errors
    /// Errors for a scale out of range, and for missing or repeated channels.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        check(self.scale, &self.channels, usize::MAX)
    }

    /// The projection of frames with `dimension` features; `None` if the kind is none.
    ///
    /// # Errors
    /// [`EmphasisError::Setting`], or [`EmphasisError::Singular`] if the matrix has no inverse.
    pub fn projection(
        &self,
        dimension: usize,
    ) -> Result<Option<EmphasisProjection>, EmphasisError> {
        // Checks precede any random number.
        check(self.scale, &self.channels, dimension)?;
        let construct = match self.kind {
            EmphasisKind::None => return Ok(None),
            EmphasisKind::Gaussian => EmphasisProjection::gaussian,
            EmphasisKind::Orthogonal => EmphasisProjection::orthogonal,
        };
        let normals = Key::new(self.seed, Purpose::Emphasis).normals(dimension * dimension);
        construct(&normals, dimension, self.scale, &self.channels).map(Some)
    }
}

/// Largest scale with an inverse in single precision.
const LARGEST_SCALE: f64 = 1e6;

/// Rejects scales and channels that are invalid for `dimension` features.
pub(super) fn check(
    scale: f64,
    channels: &[usize],
    dimension: usize,
) -> Result<(), InvalidSetting> {
    let allowed = "a positive number, at most 1000000";
    let invertible = scale > 0.0 && scale <= LARGEST_SCALE;
    require(invertible, "emphasis.scale", scale, allowed).hint("1 emphasises nothing")?;
    let mut once = channels.to_vec();
    once.sort_unstable();
    once.dedup();
    let (found, allowed) = (format!("{channels:?}"), "one or more features, each once");
    let unique = !channels.is_empty() && once.len() == channels.len();
    require(unique, "emphasis.channels", found, allowed)
        .hint("0, 1 and 2 are root rotation, x and z")?;
    let highest = once[once.len() - 1];
    let allowed = format!("features below {dimension}");
    require(highest < dimension, "emphasis.channels", highest, allowed)
        .hint("features count from 0")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_keys_take_the_default_and_unknown_ones_are_refused() {
        let read = |json: &str| serde_json::from_str::<EmphasisConfig>(json);
        assert_eq!(read("{}").unwrap(), EmphasisConfig::default());
        let config = read(r#"{"kind": "orthogonal", "scale": 5, "seed": 3}"#).unwrap();
        assert_eq!(config.kind, EmphasisKind::Orthogonal);
        assert_eq!((config.scale, config.seed), (5.0, 3));
        assert_eq!(config.channels, [0, 1, 2]);
        assert!(read(r#"{"kind": "hadamard"}"#).is_err());
        assert!(read(r#"{"c": 10}"#).is_err());
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let key = |config: EmphasisConfig, dimension: usize| {
            assert!(config.validate().is_err() || dimension < 263);
            match config.projection(dimension) {
                Err(EmphasisError::Setting(refused)) => refused.key,
                other => panic!("{other:?}"),
            }
        };
        let default = EmphasisConfig::default;
        for scale in [0.0, -1.0, 1e7, f64::NAN, f64::INFINITY] {
            assert_eq!(
                key(EmphasisConfig { scale, ..default() }, 263),
                "emphasis.scale"
            );
        }
        for channels in [vec![], vec![0, 1, 0]] {
            let config = EmphasisConfig {
                channels,
                ..default()
            };
            assert_eq!(key(config, 263), "emphasis.channels");
        }
        assert_eq!(key(default(), 2), "emphasis.channels");
    }

    #[test]
    fn no_kind_has_no_projection() {
        assert_eq!(EmphasisConfig::default().projection(263), Ok(None));
    }

    #[test]
    fn one_seed_gives_one_matrix() {
        let matrix = |seed| {
            let config = EmphasisConfig {
                kind: EmphasisKind::Gaussian,
                seed,
                ..EmphasisConfig::default()
            };
            config.projection(12).unwrap().unwrap().matrix().to_vec()
        };
        assert_eq!(matrix(4), matrix(4));
        assert_ne!(matrix(4), matrix(5));
    }
}
