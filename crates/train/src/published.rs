//! Files of other programs: PyTorch weights and NumPy arrays.

use std::collections::BTreeMap;
use std::path::Path;

use burn::module::Module;
use half::{bf16, f16};
use kinegrad_data::file::{MAX_TENSOR_BYTES, regular};
use kinegrad_data::read_array;
use kinegrad_models::parameters::{self, ParameterInfo};
use kinegrad_motion::humanml::FeatureLayout;
use pytorch_reader::{DType, PytorchReader, Tensor};

use crate::error::Error;

/// All tensors of a file that `torch.save` wrote, by path through the file's dictionaries.
///
/// # Errors
/// [`Error::Foreign`] for any other file.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>, Error> {
    let foreign = |reason: String| Error::Foreign {
        path: path.to_path_buf(),
        reason,
    };
    let length = regular(path).map_err(|error| foreign(error.to_string()))?;
    // A pickle may declare any part of the file as one value, which is then read.
    if length > MAX_TENSOR_BYTES {
        let reason = format!("{length} bytes found, at most {MAX_TENSOR_BYTES} are read");
        return Err(foreign(reason));
    }
    let read = PytorchReader::new(path).map_err(|error| foreign(error.to_string()))?;
    let tensors: BTreeMap<String, Tensor> = read.into_tensors().into_iter().collect();
    let bytes = |tensor: &Tensor| tensor.byte_len() as u64;
    let stated = tensors.values().map(bytes).try_fold(0, u64::checked_add);
    match stated.is_some_and(|stated| stated <= SHARED.saturating_mul(length)) {
        true => unwrapped(tensors).map_err(foreign),
        false => Err(foreign(format!(
            "its tensors need more than its {length} bytes"
        ))),
    }
}

/// Parts of names that wrappers add: data parallelism, compiled models, Lightning.
const WRAPPERS: [&str; 3] = ["module", "_orig_mod", "_forward_module"];

/// Dictionaries with the weights in files with more, such as the state of an optimizer.
const STATE_DICTS: [&str; 2] = ["state_dict", "model_state_dict"];

/// Tensors named without the parts that wrappers add; those of a `state_dict` alone if the file is a
/// dictionary with one. Fails for two tensors of one name.
fn unwrapped<T>(mut tensors: BTreeMap<String, T>) -> Result<BTreeMap<String, T>, String> {
    let first = |name: &str| name.split('.').next().unwrap_or_default().to_owned();
    let is_inside = |name: &str| STATE_DICTS.contains(&first(name).as_str());
    if tensors.keys().any(|name| is_inside(name)) {
        tensors.retain(|name, _| is_inside(name));
    }
    let is_added = |part: &&str| WRAPPERS.contains(part) || STATE_DICTS.contains(part);
    let mut plain: BTreeMap<String, (String, T)> = BTreeMap::new();
    for (name, tensor) in tensors {
        let parts = name.split('.').filter(|part| !is_added(part));
        let short = parts.collect::<Vec<_>>().join(".");
        if let Some((other, _)) = plain.get(&short) {
            return Err(format!(
                "it has `{other}` and `{name}`, two sets of weights of one network: save one of them"
            ));
        }
        plain.insert(short, (name, tensor));
    }
    let plain = plain
        .into_iter()
        .map(|(short, (_, tensor))| (short, tensor));
    Ok(plain.collect())
}

/// The tensors below the prefix of `known`, names of parameters, without it. All tensors if no name
/// ends so behind a prefix, or if there are several prefixes.
pub fn without_prefix(
    tensors: BTreeMap<String, Tensor>,
    known: &[&str],
) -> BTreeMap<String, Tensor> {
    let prefixes = tensors.keys().flat_map(|name| {
        let before = known.iter().filter_map(|known| name.strip_suffix(known));
        before.map(str::to_owned)
    });
    let mut prefixes: Vec<String> = prefixes.collect();
    prefixes.dedup();
    match prefixes.as_slice() {
        [prefix] if prefix.len() > 1 && prefix.ends_with('.') => {
            part_of(&tensors, &prefix[..prefix.len() - 1])
        }
        _ => tensors,
    }
}

/// Limit on the total size of tensors with shared storage, in file sizes.
const SHARED: u64 = 4;

/// The tensors below `part`, named without the prefix `part`.
pub fn part_of(tensors: &BTreeMap<String, Tensor>, part: &str) -> BTreeMap<String, Tensor> {
    let inside = tensors.iter().filter_map(|(name, tensor)| {
        let name = name.strip_prefix(part)?.strip_prefix('.')?;
        Some((name.to_string(), tensor.clone()))
    });
    inside.collect()
}

/// Replaces every parameter of `module` by the tensor of that name in the file at `path`.
///
/// # Errors
/// [`Error::ForeignWeights`] with all differences, [`Error::ForeignNumbers`].
pub fn load<M: Module>(
    path: &Path,
    module: M,
    tensors: &BTreeMap<String, Tensor>,
) -> Result<M, Error> {
    let info = |(name, tensor): (&String, &Tensor)| ParameterInfo {
        name: name.clone(),
        shape: tensor.shape().to_vec(),
    };
    let found: Vec<_> = tensors.iter().map(info).collect();
    let values = |name: &str| values_of(&tensors[name]);
    load_values(path, module, &found, values)
}

/// [`load`] of the parameters `found` in the file at `path`; `values` reads the numbers.
pub(crate) fn load_values<M: Module>(
    path: &Path,
    module: M,
    found: &[ParameterInfo],
    values: impl Fn(&str) -> Result<Vec<f32>, String>,
) -> Result<M, Error> {
    let infos = parameters::infos(&module);
    let mut differences = parameters::differences(&infos, found);
    let (mut weights, mut broken) = (Vec::with_capacity(infos.len()), None);
    for ParameterInfo { name, shape } in infos {
        // Parameters of other shapes, which may have any size, are listed in `differences`.
        let fits = found
            .iter()
            .any(|info| info.name == name && info.shape == shape);
        match fits.then(|| values(&name)) {
            Some(Ok(values)) if values.iter().all(|value| value.is_finite()) => {
                weights.push(values);
            }
            Some(Ok(_)) => {
                broken.get_or_insert(name);
            }
            Some(Err(reason)) => differences.push(format!("`{name}`: {reason}")),
            None => {}
        }
    }
    let path = path.to_path_buf();
    match broken {
        _ if !differences.is_empty() => Err(Error::ForeignWeights { path, differences }),
        Some(name) => Err(Error::ForeignNumbers { path, name }),
        None => Ok(parameters::replace(module, weights)),
    }
}

/// A tensor in single precision.
pub(crate) fn values_of(tensor: &Tensor) -> Result<Vec<f32>, String> {
    let bytes = tensor.read().map_err(|error| error.to_string())?;
    singles(&bytes, tensor.dtype())
}

/// Numbers of type `dtype` in single precision.
pub(crate) fn singles(bytes: &[u8], dtype: DType) -> Result<Vec<f32>, String> {
    fn numbers<T: bytemuck::Pod>(bytes: &[u8], single: impl Fn(T) -> f32) -> Vec<f32> {
        let numbers: Vec<T> = bytemuck::pod_collect_to_vec(bytes);
        numbers.into_iter().map(single).collect()
    }
    match dtype {
        DType::F32 => Ok(bytemuck::pod_collect_to_vec(bytes)),
        DType::F64 => Ok(numbers(bytes, |value: f64| value as f32)),
        DType::F16 => Ok(numbers(bytes, |bits| f16::from_bits(bits).to_f32())),
        DType::BF16 => Ok(numbers(bytes, |bits| bf16::from_bits(bits).to_f32())),
        other => Err(format!("{other:?} found, a floating-point type needed")),
    }
}

/// The numbers of a `.npy` file whose shape `fits`, row by row.
///
/// # Errors
/// [`Error::Array`] with the `allowed` shapes, for another shape.
pub fn array(
    path: &Path,
    allowed: impl Into<String>,
    fits: impl Fn(&[usize]) -> bool,
) -> Result<Vec<f32>, Error> {
    let array = read_array(path)?;
    match fits(&array.shape) {
        true => Ok(array.values),
        false => Err(Error::Array {
            path: path.to_path_buf(),
            found: format!("shape {:?}", array.shape),
            allowed: allowed.into(),
        }),
    }
}

/// Mean and deviation of features from two `.npy` files; joint features are converted to meters.
///
/// # Errors
/// [`Error::Array`] for files of different shapes.
pub fn mean_and_deviation(mean_path: &Path, std_path: &Path) -> Result<[Vec<f64>; 2], Error> {
    let (mut mean, mut std) = (vector(mean_path)?, vector(std_path)?);
    if mean.len() != std.len() {
        return Err(Error::Array {
            path: std_path.to_path_buf(),
            found: format!("{} numbers", std.len()),
            allowed: format!("{}, as many as {} has", mean.len(), mean_path.display()),
        });
    }
    if let Ok(layout) = FeatureLayout::of_channels(mean.len()) {
        layout.statistics_in_metres(&mut mean, &mut std);
    }
    Ok([mean, std])
}

/// The numbers of a one-dimensional `.npy` file.
fn vector(path: &Path) -> Result<Vec<f64>, Error> {
    let values = array(path, "one axis", |shape| shape.len() == 1)?;
    Ok(values.into_iter().map(f64::from).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_that_are_not_finite_are_called_that() {
        let module = burn::nn::LinearConfig::new(1, 1).init(&burn::tensor::Device::flex());
        let found = parameters::infos(&module);
        let load = |value: f32| {
            let read = |_: &str| Ok(vec![value]);
            load_values(Path::new("a.pt"), module.clone(), &found, read)
        };
        load(0.5).expect("finite weights");
        for value in [f32::NAN, f32::INFINITY] {
            let error = load(value).expect_err("not finite").to_string();
            assert!(error.starts_with("a.pt: `"), "{error}");
            assert!(error.ends_with("` contains NaN or infinity"), "{error}");
        }
    }

    #[test]
    fn names_lose_the_parts_that_wrappers_add() {
        let names = |names: &[&str]| {
            let tensors = names.iter().map(|name| ((*name).to_owned(), ()));
            let plain = unwrapped(tensors.collect()).unwrap();
            plain.into_keys().collect::<Vec<String>>()
        };
        assert_eq!(
            names(&["embed.weight", "out.bias"]),
            ["embed.weight", "out.bias"]
        );
        assert_eq!(names(&["module.a.weight", "module.b"]), ["a.weight", "b"]);
        assert_eq!(
            names(&["model.module.a", "model_avg.module.a"]),
            ["model.a", "model_avg.a"]
        );
        let lightning = ["optimizer_states.0.step", "state_dict.model._orig_mod.a"];
        assert_eq!(names(&lightning), ["model.a"]);
        let nested = [
            "epoch.0",
            "model_state_dict.module.a",
            "optimizer_state_dict.x",
        ];
        assert_eq!(names(&nested), ["a"]);
        assert_eq!(
            names(&["weights.state_dict._forward_module.b"]),
            ["weights.b"]
        );
        assert_eq!(
            names(&["model.a", "scheduler.state_dict.step"]),
            ["model.a", "scheduler.step"]
        );
        for both in [
            ["a.b", "module.a.b"],
            ["model_state_dict.a", "state_dict.a"],
        ] {
            let tensors = both.iter().map(|name| ((*name).to_owned(), ()));
            let reason = unwrapped(tensors.collect()).unwrap_err();
            for name in both {
                assert!(reason.contains(&format!("`{name}`")), "{reason}");
            }
        }
    }
}
