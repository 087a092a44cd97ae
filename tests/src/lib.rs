//! What the golden, parity and end-to-end tests share.

pub mod captures;
pub mod decoder;
pub mod end_to_end;
pub mod gmd;
pub mod golden;
pub mod parity;
pub mod sandbox;
pub mod servers;
pub mod unet;

use kinegrad_models::parameters::{HostParameter, ParameterInfo};

/// The weights under `prefix` of a golden file, by state-dict name.
pub fn weights(golden: &golden::Golden, prefix: &str) -> Vec<HostParameter> {
    let names = golden.names_under(prefix);
    let load = |name: String| {
        let tensor = golden.get(&format!("{prefix}{name}"));
        let values = tensor.f32s();
        HostParameter {
            info: ParameterInfo {
                name,
                shape: tensor.shape,
            },
            values,
        }
    };
    names.into_iter().map(load).collect()
}
