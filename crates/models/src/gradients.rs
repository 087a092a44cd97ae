//! Sums of gradients over several backward passes, on the device.

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, Transaction};

use crate::parameters;

/// Removes the gradients of `module`'s parameters from `gradients`. Parameters that are frozen or
/// unused in the loss have zeros.
pub fn gradients<M: Module>(module: &M, gradients: &mut Gradients) -> Vec<Vec<f32>> {
    let mut sum = GradientSum::default();
    sum.add(module, gradients);
    sum.into_host(module)
}

/// The sum of the gradients of a module's parameters, in the module's order
/// ([`crate::parameters`]).
#[derive(Debug, Default)]
pub struct GradientSum(Vec<Option<Tensor<1>>>);

impl GradientSum {
    /// Moves the gradients of `module`'s parameters from `gradients` into the sums.
    pub fn add<M: Module>(&mut self, module: &M, gradients: &mut Gradients) {
        struct Visitor<'a> {
            gradients: &'a mut Gradients,
            sums: &'a mut Vec<Option<Tensor<1>>>,
            index: usize,
        }
        impl ModuleVisitor for Visitor<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if self.sums.len() == self.index {
                    self.sums.push(None);
                }
                let sum = &mut self.sums[self.index];
                self.index += 1;
                if let Some(gradient) = param.val().grad_remove(self.gradients) {
                    let len = gradient.shape().num_elements();
                    let gradient = gradient.without_autodiff().reshape([len]);
                    *sum = Some(match sum.take() {
                        Some(sum) => sum + gradient,
                        None => gradient,
                    });
                }
            }
        }
        module.visit(&mut Visitor {
            gradients,
            sums: &mut self.0,
            index: 0,
        });
    }

    /// The sums on the host, in one read. Parameters unused in all losses have zeros.
    pub fn into_host<M: Module>(self, module: &M) -> Vec<Vec<f32>> {
        self.into_host_with(module, Vec::new()).0
    }

    /// [`into_host`](Self::into_host) that also reads the values of `others`, in the same read.
    pub fn into_host_with<M: Module>(
        mut self,
        module: &M,
        others: Vec<Tensor<1>>,
    ) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
        let infos = parameters::infos(module);
        assert!(self.0.len() <= infos.len(), "sums of another module");
        self.0.resize(infos.len(), None);
        let there: Vec<bool> = self.0.iter().map(Option::is_some).collect();
        let tensors: Vec<Tensor<1>> = self.0.into_iter().flatten().chain(others).collect();
        // An empty transaction has no device.
        let read = match tensors.is_empty() {
            true => Vec::new(),
            false => {
                let reading = Transaction::default();
                let reading = tensors.into_iter().fold(reading, Transaction::register);
                reading.execute()
            }
        };
        let mut read = read.into_iter().map(parameters::to_host);
        let values = infos.iter().zip(there).map(|(info, there)| match there {
            true => read.next().expect("as many as were registered"),
            false => vec![0.0; info.len()],
        });
        (values.collect(), read.collect())
    }

    /// The sums on their device, in the module's order; `None` for parameters unused in all losses.
    pub fn into_tensors(self) -> Vec<Option<Tensor<1>>> {
        self.0
    }
}
