//! Bringing a checkpoint's tensors into the module's order.

use std::path::Path;

use kinegrad_models::parameters::ParameterInfo;

use crate::checkpoint::Checkpoint;
use crate::error::Error;
use crate::optim::Moments;

/// For each parameter of the module, its index in the checkpoint.
pub(super) fn order_of(infos: &[ParameterInfo], checkpoint: &Checkpoint) -> Vec<usize> {
    let indices: std::collections::HashMap<&str, usize> = checkpoint
        .model
        .iter()
        .enumerate()
        .map(|(i, p)| (p.info.name.as_str(), i))
        .collect();
    infos
        .iter()
        .map(|info| indices[info.name.as_str()])
        .collect()
}

/// Refuses a checkpoint whose running means are not those of the parameters that are trained.
pub(super) fn check_moments(
    moments: &[Moments],
    lengths: &[usize],
    infos: &[ParameterInfo],
    folder: &Path,
) -> Result<(), Error> {
    let wrong = |(moments, length): &(&Moments, &usize)| {
        moments.exp_avg.len() != **length || moments.exp_avg_sq.len() != **length
    };
    match moments.iter().zip(lengths).position(|pair| wrong(&pair)) {
        None => Ok(()),
        Some(index) => Err(Error::CheckpointDamaged {
            path: folder.to_path_buf(),
            reason: format!(
                "the optimiser's state of `{}` has not {} elements",
                infos[index].name, lengths[index]
            ),
        }),
    }
}
