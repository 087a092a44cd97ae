//! The origin of a NaN.

use burn::module::Module;
use kinegrad_data::Batch;
use kinegrad_models::parameters;

use crate::recipe::Loss;

/// The first tensor, in the order of computation, with an infinity or NaN.
pub(super) fn find_not_finite<M: Module, P>(model: &M, batch: &Batch, loss: Loss<P>) -> String {
    let broken = |values: &[f32]| values.iter().any(|v| !v.is_finite());
    if broken(&batch.x_start) {
        return "the batch's motion".into();
    }
    for condition in &batch.conditions {
        if broken(&condition.values) {
            return format!("the batch's condition `{}`", condition.name);
        }
    }
    for parameter in parameters::export(model) {
        if broken(&parameter.values) {
            return format!("parameter `{}`", parameter.info.name);
        }
    }
    for (name, probe) in loss.probes {
        let values = probe.inner().try_into_vec_as::<f32>().unwrap_or_default();
        if broken(&values) {
            return format!("`{name}`");
        }
    }
    "the loss".into()
}
