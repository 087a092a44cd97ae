//! Weights of golden files: stored, or generated as the files' README defines.

use kinegrad_models::parameters::{HostParameter, ParameterInfo};

use crate::golden::Golden;

/// The prefix of a file's parameters.
const PARAMETERS: &str = "model.";

/// The weights under `prefix`, by state-dict name.
///
/// # Panics Panics if there are none, or if the generated weights have another count or sum than
/// the file states.
pub fn weights(golden: &Golden, prefix: &str) -> Vec<HostParameter> {
    match layout(golden) {
        Some(layout) => {
            let part = prefix.strip_prefix(PARAMETERS).expect("a parameter");
            let all = generated(golden, &layout).into_iter();
            let under = all.filter_map(|mut parameter| {
                parameter.info.name = parameter.info.name.strip_prefix(part)?.to_owned();
                Some(parameter)
            });
            let under: Vec<HostParameter> = under.collect();
            assert!(!under.is_empty(), "{} has no `{prefix}*`", golden.name());
            under
        }
        None => {
            let load = |name: String| {
                let tensor = golden.get(&format!("{prefix}{name}"));
                let values = tensor.f32s();
                let shape = tensor.shape;
                HostParameter {
                    info: ParameterInfo { name, shape },
                    values,
                }
            };
            golden.names_under(prefix).into_iter().map(load).collect()
        }
    }
}

/// The shape of the parameter `name`, which begins with `model.`, if the file contains it.
pub fn shape(golden: &Golden, name: &str) -> Option<Vec<usize>> {
    match layout(golden) {
        Some(layout) => {
            let name = name.strip_prefix(PARAMETERS)?;
            let info = layout.into_iter().find(|info| info.name == name)?;
            Some(info.shape)
        }
        None => golden.find(name).map(|tensor| tensor.shape),
    }
}

/// Names and shapes of the parameters that a file omits, in order.
fn layout(golden: &Golden) -> Option<Vec<ParameterInfo>> {
    let shapes = golden.find_metadata("param_shapes")?;
    let shapes: Vec<Vec<usize>> = serde_json::from_str(shapes).expect("a list of shapes");
    let names = order(golden);
    assert_eq!(names.len(), shapes.len(), "a shape for each name");
    let infos = names.into_iter().zip(shapes);
    Some(
        infos
            .map(|(name, shape)| ParameterInfo { name, shape })
            .collect(),
    )
}

/// Names of the parameters that a file omits, in their numbered order.
pub fn order(golden: &Golden) -> Vec<String> {
    serde_json::from_str(golden.metadata("param_order")).expect("a list of names")
}

/// The parameters of `layout`, which is complete.
///
/// # Panics Panics if they have another count or sum than the file states.
pub fn generated(golden: &Golden, layout: &[ParameterInfo]) -> Vec<HostParameter> {
    let seed = golden.metadata("hash_seed").parse().expect("a number");
    let numbered = layout.iter().zip(0u32..);
    let parameters: Vec<HostParameter> = numbered
        .map(|(info, position)| hashed(info, position, seed))
        .collect();
    let all = parameters.iter().flat_map(|parameter| &parameter.values);
    // Not counted: a test must compare more than its own weights.
    let expected = |name: &str| golden.get(&format!("check.{name}")).scalar();
    assert_eq!(all.clone().count() as f64, expected("num_parameters"));
    let sum: f64 = all.map(|&value| f64::from(value)).sum();
    let error = (sum / expected("sum64_of_all_parameters") - 1.0).abs();
    assert!(error < 1e-9, "{}: the weights' sum is {sum}", golden.name());
    parameters
}

/// Parameter number `position`: a hash of its number and the element's, scaled by the kind of
/// parameter.
fn hashed(info: &ParameterInfo, position: u32, seed: u32) -> HostParameter {
    let fan_in: usize = info.shape.iter().skip(1).product();
    let is_norm = info.shape.len() == 1 && info.name.ends_with("weight");
    let values = (0..info.len() as u32)
        .map(|j| {
            let mut x = seed
                .wrapping_add(position.wrapping_mul(0x9E37_79B9))
                .wrapping_add(j);
            x ^= x >> 16;
            x = x.wrapping_mul(0x7feb_352d);
            x ^= x >> 15;
            x = x.wrapping_mul(0x846c_a68b);
            x ^= x >> 16;
            let u = 2.0 * f64::from(x) / 2f64.powi(32) - 1.0;
            let value = match info.shape.len() {
                1 if is_norm => 1.0 + 0.2 * u,
                1 => 0.1 * u,
                _ => u / (fan_in as f64).sqrt(),
            };
            value as f32
        })
        .collect();
    HostParameter {
        info: info.clone(),
        values,
    }
}
