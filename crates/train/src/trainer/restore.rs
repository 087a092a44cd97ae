//! Reordering a checkpoint's tensors to match the module.

use std::collections::HashMap;
use std::path::Path;

use burn::module::Module;
use kinegrad_models::parameters::{self, ParameterInfo};

use crate::checkpoint::Checkpoint;
use crate::error::Error;

/// For each parameter of the module, its index in the checkpoint.
pub(super) fn order_of(infos: &[ParameterInfo], checkpoint: &Checkpoint) -> Vec<usize> {
    let names = checkpoint
        .model
        .iter()
        .map(|parameter| &parameter.info.name);
    let indices: HashMap<&String, usize> = names.zip(0..).collect();
    infos.iter().map(|info| indices[&info.name]).collect()
}

/// Rejects a checkpoint whose running means do not fit the trained parameters of `model`.
pub(crate) fn check_moments<M: Module>(
    model: &M,
    checkpoint: &Checkpoint,
    path: &Path,
) -> Result<(), Error> {
    let infos = parameters::infos(model);
    let order = order_of(&infos, checkpoint);
    let trained = parameters::trainable(model);
    for ((info, index), trained) in infos.iter().zip(order).zip(trained) {
        let moments = &checkpoint.moments[index];
        let expected = if trained { info.len() } else { 0 };
        if moments.exp_avg.len() != expected || moments.exp_avg_sq.len() != expected {
            return Err(Error::CheckpointDamaged {
                path: path.to_path_buf(),
                reason: format!(
                    "it cannot be resumed: the optimiser's state of `{}` has not {expected} \
                     elements (a merged run has none)",
                    info.name
                ),
            });
        }
    }
    Ok(())
}
