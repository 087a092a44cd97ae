//! Networks of golden files of Guided Motion Diffusion, whose sizes follow from the shapes of the
//! weights.

use kinegrad_gmd::network::GmdUnetConfig;

use crate::golden::Golden;
use crate::weights::shape;

/// The UNet whose weights are under `prefix`, its channels and the width of its condition.
///
/// # Panics Panics if the weights are not those of a UNet.
pub fn unet(golden: &Golden, prefix: &str) -> (GmdUnetConfig, usize, usize) {
    let shape = |name: &str| shape(golden, &format!("{prefix}{name}"));
    let size = |name: &str, axis: usize| shape(name).expect("a weight of this name")[axis];
    let adagn = shape("downs.0.0.blocks.0.block1.0.weight").is_some();
    let half = if adagn { "block1" } else { "block" };
    let first = |level: usize| format!("downs.{level}.0.blocks.0.{half}.0.weight");
    let latent_dim = size("time_mlp.2.weight", 0);
    let levels = (0..).take_while(|&level| shape(&first(level)).is_some());
    let config = GmdUnetConfig {
        latent_dim,
        dim_mults: levels
            .map(|level| size(&first(level), 0) as f64 / latent_dim as f64)
            .collect(),
        adagn,
        ..GmdUnetConfig::default()
    };
    (config, size(&first(0), 1), size("time_mlp.0.weight", 1))
}
