//! Parameters by state-dict name: counting, reading, loading and updates in place.
//!
//! All functions use the order of the module tree: index `i` is the same parameter everywhere.

use std::collections::{BTreeMap, HashMap};

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData, Transaction};

use crate::Error;

/// Name and shape of a parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParameterInfo {
    /// State-dict name, for example `enc.0.res.1.conv1.weight`.
    pub name: String,
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
}

impl ParameterInfo {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// True if it has no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A parameter's values on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostParameter {
    /// Name and shape.
    pub info: ParameterInfo,
    /// Values in row-major order.
    pub values: Vec<f32>,
}

/// Names and shapes of all parameters, without initializing them.
pub fn infos<M: Module>(module: &M) -> Vec<ParameterInfo> {
    #[derive(Default)]
    struct Visitor {
        path: Vec<String>,
        infos: Vec<ParameterInfo>,
    }
    impl ModuleVisitor for Visitor {
        /// Maps field names as described in [`crate::layers`]; enum variants are not part of names.
        fn enter_module(&mut self, name: &str, container: &str) {
            let nameless = name.starts_with("flat_") || container.starts_with("Enum:");
            let name = if nameless { "" } else { name };
            let name = name.strip_prefix("at_").unwrap_or(name);
            self.path.push(name.replace("_at_", "."));
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let named = self.path.iter().filter(|name| !name.is_empty());
            self.infos.push(ParameterInfo {
                name: named.map(String::as_str).collect::<Vec<_>>().join("."),
                shape: param.lazy_shape().iter().copied().collect(),
            });
        }
    }
    let mut visitor = Visitor::default();
    module.visit(&mut visitor);
    visitor.infos
}

/// True for trained and false for frozen parameters, also on a plain device. Initializes none.
pub fn trainable<M: Module>(module: &M) -> Vec<bool> {
    struct Visitor(Vec<bool>);
    impl ModuleVisitor for Visitor {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.push(is_trainable(param));
        }
    }
    let mut visitor = Visitor(Vec::new());
    module.visit(&mut visitor);
    visitor.0
}

/// Burn shows this setting of a parameter only after `train`, which initializes the parameter: a small
/// tensor that is loaded in its place takes the setting over.
fn is_trainable<const D: usize>(param: &Param<Tensor<D>>) -> bool {
    let stand_in = (!param.is_initialized()).then(|| {
        let small = Tensor::zeros([1; D], &param.lazy_device());
        param.clone().transform_for_load(small, param.id)
    });
    let param = stand_in.as_ref().unwrap_or(param);
    param.valid().train().is_require_grad()
}

/// Copies all parameters to the host, in one read.
pub fn export<M: Module>(module: &M) -> Vec<HostParameter> {
    #[derive(Default)]
    struct Visitor(Transaction);
    impl ModuleVisitor for Visitor {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let reading = std::mem::take(&mut self.0);
            self.0 = reading.register(param.val().inner());
        }
    }
    let mut visitor = Visitor::default();
    module.visit(&mut visitor);
    let values = visitor.0.execute().into_iter().map(to_host);
    let pairs = infos(module).into_iter().zip(values);
    pairs
        .map(|(info, values)| HostParameter { info, values })
        .collect()
}

/// The values of all parameters on the host, in the module's order.
pub fn values<M: Module>(module: &M) -> Vec<Vec<f32>> {
    let parameters = export(module).into_iter();
    parameters.map(|parameter| parameter.values).collect()
}

/// The indices of running statistics, such as those of BatchNorm. They are not trained, but change
/// in training.
pub fn running_statistics(infos: &[ParameterInfo]) -> Vec<usize> {
    let is_running = |info: &ParameterInfo| {
        let last = info.name.rsplit('.').next();
        last.is_some_and(|name| name.starts_with("running_"))
    };
    let indices = infos.iter().enumerate();
    let indices = indices.filter(|(_, info)| is_running(info));
    indices.map(|(index, _)| index).collect()
}

/// The values of the parameters at ascending `indices` on the host.
pub fn values_at<M: Module>(module: &M, indices: &[usize]) -> Vec<Vec<f32>> {
    struct Visitor<'a> {
        indices: &'a [usize],
        index: usize,
        values: Vec<Vec<f32>>,
    }
    impl ModuleVisitor for Visitor<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if self.indices.contains(&self.index) {
                self.values.push(to_host(param.val().inner().into_data()));
            }
            self.index += 1;
        }
    }
    let mut visitor = Visitor {
        indices,
        index: 0,
        values: Vec::new(),
    };
    module.visit(&mut visitor);
    visitor.values
}

/// Number of elements of all parameters, without initializing them.
pub fn count<M: Module>(module: &M) -> usize {
    infos(module).iter().map(ParameterInfo::len).sum()
}

/// All differences of the `found` parameters from the `expected` ones: missing names, different
/// shapes, and unknown names.
pub fn differences(expected: &[ParameterInfo], found: &[ParameterInfo]) -> Vec<String> {
    let mut found: BTreeMap<&str, &[usize]> = found
        .iter()
        .map(|info| (info.name.as_str(), info.shape.as_slice()))
        .collect();
    let differs = |ParameterInfo { name, shape }: &ParameterInfo| match found.remove(name.as_str())
    {
        None => Some(format!("missing: `{name}` {shape:?}")),
        Some(found) if found != shape => {
            Some(format!("`{name}` has shape {found:?}, {shape:?} needed"))
        }
        Some(_) => None,
    };
    let mut differences: Vec<String> = expected.iter().filter_map(differs).collect();
    differences.extend(found.into_keys().map(|name| format!("not known: `{name}`")));
    differences
}

/// Replaces every parameter by its namesake in `weights`. Names and shapes must be exactly those of
/// the module.
///
/// # Errors
/// [`Error::Weights`] with all [`differences`].
pub fn load<M: Module>(module: M, weights: Vec<HostParameter>) -> Result<M, Error> {
    let expected = infos(&module);
    let (found, values): (Vec<_>, Vec<_>) = weights.into_iter().map(|p| (p.info, p.values)).unzip();
    let differences = differences(&expected, &found);
    if !differences.is_empty() {
        return Err(Error::Weights { differences });
    }
    let mut named: HashMap<String, Vec<f32>> = found
        .into_iter()
        .map(|info| info.name)
        .zip(values)
        .collect();
    let ordered = expected.iter().map(|info| named.remove(&info.name));
    let ordered: Option<Vec<_>> = ordered.collect();
    Ok(replace(module, ordered.expect("all names were compared")))
}

/// Replaces the values of all parameters, in the module's order. Frozen parameters stay frozen.
pub fn replace<M: Module>(module: M, values: Vec<Vec<f32>>) -> M {
    struct Mapper(std::vec::IntoIter<Vec<f32>>);
    impl ModuleMapper for Mapper {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let values = self.0.next().expect("one value vector a parameter");
            let shape: [usize; D] = param.lazy_shape().dims();
            let tensor = Tensor::from_data(TensorData::new(values, shape), &param.lazy_device());
            let id = param.id;
            param.transform_for_load(tensor, id)
        }
    }
    module.map(&mut Mapper(values.into_iter()))
}

/// Changes the values of every trained parameter in place. `change` gets the index among all
/// parameters.
///
/// On the CPU the values are not copied if the module has no clones.
pub fn update<M: Module>(module: M, mut change: impl FnMut(usize, &mut [f32])) -> M {
    map(module, |index, row| {
        let device = row.device();
        let mut data = row.into_data();
        change(index, data.as_mut_slice().expect("parameters are float32"));
        Tensor::from_data(data, &device)
    })
}

/// Replaces the values of every trained parameter by the result of `change`. `change` gets the
/// index among all parameters, and one row on the device.
pub fn map<M: Module>(module: M, change: impl FnMut(usize, Tensor<1>) -> Tensor<1>) -> M {
    struct Mapper<F> {
        change: F,
        index: usize,
    }
    impl<F: FnMut(usize, Tensor<1>) -> Tensor<1>> ModuleMapper for Mapper<F> {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let index = self.index;
            self.index += 1;
            if !is_trainable(&param) {
                return param;
            }
            let (id, tensor, mapper) = param.consume();
            let shape = tensor.dims();
            let strategy = tensor.gradient_checkpointing_strategy();
            let require_grad = tensor.is_require_grad();
            let row = tensor.inner().reshape([shape.iter().product::<usize>()]);
            let changed = (self.change)(index, row).reshape(shape);
            let tensor = match strategy {
                Some(strategy) => changed
                    .autodiff()
                    .with_gradient_checkpointing_strategy(strategy)
                    .set_require_grad(require_grad),
                None => changed,
            };
            Param::from_mapped_value(id, tensor, mapper)
        }
    }
    module.map(&mut Mapper { change, index: 0 })
}

pub(crate) fn to_host(data: TensorData) -> Vec<f32> {
    data.try_into_vec().expect("parameters are float32")
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::Initializer;
    use crate::layers::Linear;

    fn layer() -> Linear {
        Linear::new(3, 2, &Initializer::new(1, &Device::flex()))
    }

    #[test]
    fn exported_weights_load_again() {
        let weights = export(&layer());
        let names: Vec<&str> = weights.iter().map(|p| p.info.name.as_str()).collect();
        assert_eq!(names, ["weight", "bias"]);
        let other = Linear::new(3, 2, &Initializer::new(2, &Device::flex()));
        assert_ne!(export(&other), weights);
        let loaded = load(other, weights.clone()).expect("the weights fit");
        assert_eq!(export(&loaded), weights);
    }

    #[test]
    fn what_is_trained_is_known_without_initial_weights() {
        // Its weights would take four tebibytes.
        let huge = Linear::new(1 << 20, 1 << 20, &Initializer::new(1, &Device::flex()));
        assert_eq!(trainable(&huge), [true, true]);
        assert_eq!(trainable(&huge.no_grad()), [false, false]);
        assert_eq!(trainable(&layer()), [true, true]);
        assert_eq!(trainable(&layer().no_grad()), [false, false]);
    }

    #[test]
    fn weights_of_another_architecture_are_refused_by_name() {
        let weights = export(&layer());
        let missing = load(layer(), weights[..1].to_vec()).expect_err("no bias");
        assert!(
            missing
                .to_string()
                .contains("do not fit: missing: `bias` [2]"),
            "{missing}"
        );

        let mut more = weights.clone();
        more.push(weights[0].clone());
        more[2].info.name = "gain".into();
        let unexpected = load(layer(), more).expect_err("a gain");
        assert!(
            unexpected.to_string().contains("not known: `gain`"),
            "{unexpected}"
        );

        let mut turned = weights.clone();
        turned[0].info.shape = vec![3, 2];
        let shape = load(layer(), turned)
            .expect_err("a turned weight")
            .to_string();
        assert!(
            shape.contains("`weight` has shape [3, 2], [2, 3] needed"),
            "{shape}"
        );
    }

    #[test]
    fn updates_reach_the_parameters_in_order() {
        let before = export(&layer());
        let after = export(&update(layer(), |index, values| {
            values
                .iter_mut()
                .for_each(|value| *value += index as f32 + 1.0);
        }));
        for (index, (before, after)) in before.iter().zip(&after).enumerate() {
            for (b, a) in before.values.iter().zip(&after.values) {
                assert_eq!(*a, b + index as f32 + 1.0);
            }
        }
    }
}
