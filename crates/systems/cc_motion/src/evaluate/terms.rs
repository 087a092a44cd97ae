//! The losses of end-to-end fine-tuning as measures, as in CC-MotionGen's table 7.5.

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::PhraseItem;
use kinegrad_motion::Phrase;
use kinegrad_motion::phrase::CHANNELS;
use serde::Serialize;

use super::super::losses::{ReconstructionLoss, SignMatching, TemporalLossConfig, temporal_losses};

/// The mean of one loss over motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossTerm {
    /// Name of the loss.
    pub name: &'static str,
    /// Mean of the loss over the motions.
    pub value: f64,
}

/// CC-MotionGen's temporal terms, with its weights and normalizers, and the mean squared errors of
/// position (m^2) and quaternion (up to sign) from the held-out phrase. All are means over
/// `motions`, one list per phrase of `held_out`. Without held-out phrases, there are no errors.
///
/// A sample from noise shares only the audio condition with its phrase. The sample's squared error
/// is about twice the variance of real motion; the mean motion's error is half as large.
pub(super) fn loss_terms(
    motions: &[Vec<Phrase>],
    held_out: Option<&[Arc<PhraseItem>]>,
) -> Vec<LossTerm> {
    let config = TemporalLossConfig::ccmotion();
    let count = motions.iter().map(Vec::len).sum::<usize>() as f64;
    let mut means: Vec<LossTerm> = Vec::new();
    for (index, samples) in motions.iter().enumerate() {
        let target = held_out.map(|phrases| tensor(&phrases[index].motion));
        for motion in samples {
            let frames = motion.frames();
            let decoded = tensor(motion);
            let mask = Tensor::ones([1, frames], &decoded.device());
            let mut terms = temporal_losses(&decoded, &mask, &config);
            if let Some(target) = &target {
                let weights = Tensor::ones([1, 1, 1], &decoded.device());
                let sign = SignMatching::Nearer;
                let error = ReconstructionLoss::new(&decoded, target, &mask, weights, sign);
                terms.push(("position", error.position));
                terms.push(("quaternion", error.quaternion));
            }
            for (name, term) in terms {
                let value = f64::from(term.into_scalar::<f32>()) / count;
                match means.iter_mut().find(|mean| mean.name == name) {
                    Some(mean) => mean.value += value,
                    None => means.push(LossTerm { name, value }),
                }
            }
        }
    }
    means
}

/// `[1, 25, frames]` on the CPU.
fn tensor(motion: &Phrase) -> Tensor<3> {
    let shape = [1, CHANNELS, motion.frames()];
    Tensor::from_data(
        TensorData::new(motion.channel_major(), shape),
        &Device::flex(),
    )
}
