//! The contrastive loss of captions and motions.
//!
//! ```text
//! L = mean over the pairs that belong together of  d^2
//!   + mean over all other pairs of                 max(0, margin - d)^2
//! ```
//!
//! d is the Euclidean distance of the embeddings of a caption and a motion. The published program
//! (Guo et al. 2022, section 5) uses one other motion per caption and trains the movement encoder
//! first. This recipe uses all pairs of the batch. A caption and a clip belong together if the clip
//! has the same captions or the same sentence.

use burn::tensor::{Device, Int, Tensor, TensorData};
use kinegrad_data::{Batch, CAPTIONS, Condition, WORDS};
use kinegrad_train::denoising::HeldOut;
use kinegrad_train::{Loss, Measured, Recipe, StepKey};

use crate::network::TextMotionEncoders;

/// Gives the distance of equal embeddings a gradient.
const EPSILON: f64 = 1e-6;

/// Trains [`TextMotionEncoders`].
pub(super) struct ContrastiveRecipe {
    pub margin: f64,
    pub held_out: HeldOut,
}

impl ContrastiveRecipe {
    fn terms(
        &self,
        model: &TextMotionEncoders,
        batch: &Batch,
        device: &Device,
    ) -> [(&'static str, Tensor<1>); 2] {
        let texts = texts(model, batch, device);
        let frames = [batch.batch_size, batch.channels, batch.frames];
        let frames = Tensor::from_data(TensorData::new(batch.x_start.clone(), frames), device);
        let lengths = batch.mask.chunks(batch.frames);
        let lengths = lengths.map(|mask| mask.iter().filter(|&&valid| valid > 0.0).count());
        let motions = model.motions(frames, &lengths.collect::<Vec<_>>());
        contrast(texts, motions, &positive(batch), self.margin)
    }
}

/// The two terms, for embeddings `[batch, width]` of captions and motions. Caption i and motion j
/// are a positive pair if `positive[i * batch + j]`.
fn contrast(
    texts: Tensor<2>,
    motions: Tensor<2>,
    positive: &[bool],
    margin: f64,
) -> [(&'static str, Tensor<1>); 2] {
    let [batch, width] = texts.dims();
    let device = texts.device();
    let difference = texts.reshape([batch, 1, width]) - motions.reshape([1, batch, width]);
    let squares = difference.powi_scalar(2).sum_dim(2).reshape([batch, batch]);
    let distances = (squares.clone() + EPSILON).sqrt();
    let missing = (distances * -1.0 + margin).clamp_min(0.0).powi_scalar(2);
    let mean = |of: Tensor<2>, belongs: bool| {
        let weight = positive.iter().map(|&is| f32::from(is == belongs));
        let weight: Vec<f32> = weight.collect();
        let count = weight.iter().sum::<f32>().max(1.0);
        let weight = Tensor::<2>::from_data(TensorData::new(weight, [batch, batch]), &device);
        (of * weight).sum() / count
    };
    [
        ("together", mean(squares, true)),
        ("apart", mean(missing, false)),
    ]
}

fn texts(model: &TextMotionEncoders, batch: &Batch, device: &Device) -> Tensor<2> {
    let condition = condition(batch, WORDS);
    let (words, width) = (condition.frames, condition.channels - 1);
    let (mut vectors, mut classes, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
    for rows in condition.values.chunks(condition.channels * words) {
        let (of_channels, of_classes) = rows.split_at(width * words);
        for word in 0..words {
            vectors.extend((0..width).map(|channel| of_channels[channel * words + word]));
            classes.push((of_classes[word] as i32 - 1).max(0));
        }
        lengths.push(of_classes.iter().filter(|&&class| class > 0.0).count());
    }
    let vectors = TensorData::new(vectors, [lengths.len(), words, width]);
    let classes = TensorData::new(classes, [lengths.len(), words]);
    let classes = Tensor::<2, Int>::from_data(classes, device);
    model.texts(Tensor::from_data(vectors, device), classes, &lengths)
}

/// For each pair of clips, true if the clips have the same captions, or the same sampled caption.
fn positive(batch: &Batch) -> Vec<bool> {
    let captions = &condition(batch, CAPTIONS).values;
    let words = condition(batch, WORDS);
    let sentences: Vec<&[f32]> = words.values.chunks(words.channels * words.frames).collect();
    let count = captions.len();
    let pairs = (0..count).flat_map(|first| (0..count).map(move |second| (first, second)));
    let belong =
        |(a, b): (usize, usize)| captions[a] == captions[b] || sentences[a] == sentences[b];
    pairs.map(belong).collect()
}

fn condition<'a>(batch: &'a Batch, name: &str) -> &'a Condition {
    let found = batch.conditions.iter().find(|each| each.name == name);
    found.expect("samples with words")
}

impl Recipe for ContrastiveRecipe {
    type Model = TextMotionEncoders;
    type Pending = ();

    fn weight(&self, batch: &Batch) -> f64 {
        batch.batch_size as f64
    }

    fn loss(&self, model: &TextMotionEncoders, batch: &Batch, _: StepKey, device: &Device) -> Loss {
        let terms = self.terms(model, batch, device);
        Loss {
            total: terms[0].1.clone() + terms[1].1.clone(),
            terms: terms.to_vec(),
            probes: Vec::new(),
            pending: (),
        }
    }

    fn validation_loss(&self, model: &TextMotionEncoders, device: &Device) -> Measured {
        self.held_out
            .mean_terms(|_, batch| self.terms(model, &batch, device).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_pulled_together_and_pushed_apart() {
        let device = Device::flex();
        let embeddings = |values: [f32; 6]| {
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), [3, 2]), &device)
        };
        // The captions 0 and 2 are equal.
        let texts = embeddings([0.0, 0.0, 3.0, 4.0, 0.0, 0.0]);
        let motions = embeddings([1.0, 0.0, 3.0, 4.0, 0.0, 2.0]);
        let positive = [true, false, true, false, true, false, true, false, true];
        let [(_, near), (_, apart)] = contrast(texts, motions, &positive, 6.0);
        // The distances are 1 and 4 for captions 0 and 2, and 0.
        let near = near.into_scalar::<f32>();
        assert!((near - 10.0 / 5.0).abs() < 1e-5, "{near}");
        // Caption 0 and 2 to motion 1: 6 - 5. Caption 1 to motions 0 and 2: 6 - sqrt(20), sqrt(13).
        let from_1: f32 = [20.0f32, 13.0]
            .iter()
            .map(|d| (6.0 - d.sqrt()).powi(2))
            .sum();
        let apart = apart.into_scalar::<f32>();
        assert!((apart - (2.0 + from_1) / 4.0).abs() < 1e-4, "{apart}");
    }

    #[test]
    fn equal_sentences_belong_to_both_clips() {
        let condition = |name, channels, values: &[f32]| Condition {
            name,
            values: values.to_vec(),
            channels,
            frames: 1,
        };
        // Clips 0 and 1 have different captions and the same sentence. Clip 2 has clip 0's captions
        // and another sentence.
        let batch = Batch {
            x_start: vec![0.0; 3],
            conditions: vec![
                condition(CAPTIONS, 1, &[7.0, 8.0, 7.0]),
                condition(WORDS, 2, &[0.5, 1.0, 0.5, 1.0, 0.25, 1.0]),
            ],
            mask: vec![1.0; 3],
            ids: ["a", "b", "c"].map(str::to_owned).to_vec(),
            batch_size: 3,
            channels: 1,
            frames: 1,
        };
        let expected = [true, true, true, true, true, false, true, false, true];
        assert_eq!(positive(&batch), expected);
    }
}
