//! Stateless randomness: every sample is a function of a [`Key`], and a key is a function of the
//! run's seed and of the purpose.
//!
//! A resume must restore a stateful generator, whose numbers also depend on the number of workers.
//! This crate saves no state: the noise of micro-batch 2 of step 700 is `Key::new(seed,
//! Purpose::Noise).at(700).at(2)`, independent of caller, order and device. A resumed run continues
//! bit for bit, and a batch is the same for any number of loader workers.
//!
//! ```
//! use kinegrad_random::{Key, Purpose};
//! let key = Key::new(7, Purpose::Noise).at(700).at(2);
//! assert_eq!(key.normals(4), key.normals(4));
//! assert_ne!(key.normals(4), key.at(0).normals(4));
//! ```

use rand::{Rng, RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Purpose of a random number. Each purpose has its own stream, so a new sample of one purpose
/// changes no other stream.
///
/// Existing runs depend on the discriminants: append new ones, never renumber.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Initial weights, keyed by parameter.
    Init = 1,
    /// Order of the training phrases, keyed by epoch.
    DataOrder = 2,
    /// Crop positions, keyed by sample.
    Crop = 3,
    /// Data augmentation, keyed by sample.
    Augment = 4,
    /// Diffusion timesteps, keyed by step and micro-batch.
    Timesteps = 5,
    /// Diffusion noise, keyed by step and micro-batch.
    Noise = 6,
    /// Dropped conditions of classifier-free guidance, keyed by step and micro-batch.
    CondDropout = 7,
    /// Dropout masks, keyed by step, micro-batch, call and layer.
    Dropout = 8,
    /// Noise of the validation loss, keyed by phrase and repetition.
    Validation = 9,
    /// Start noise and step noise of a sampler.
    Sampling = 10,
    /// Synthetic phrases, keyed by phrase.
    Synthetic = 11,
    /// Train and validation split.
    Split = 12,
    /// Start timesteps of a rollout in training, keyed by step and micro-batch.
    RolloutTimesteps = 13,
    /// Start noise of a rollout in training, keyed by step and micro-batch.
    RolloutNoise = 14,
    /// Dropout masks of the decoder, keyed by step, micro-batch, call and layer.
    DecoderDropout = 15,
    /// Seed of a phrase's samples, keyed by the phrase's id.
    PhraseSeed = 16,
    /// Noise that replaces a phrase's audio features, keyed by the phrase's id.
    NoiseCondition = 17,
    /// Matrix of an emphasis projection.
    Emphasis = 18,
    /// Pairs of feature vectors whose distances are averaged.
    Pairs = 19,
    /// The caption of a motion, keyed by sample.
    Caption = 20,
    /// Shuffled frames and other songs that replace a phrase's music, keyed by the phrase's id.
    Listening = 21,
    /// Phrases of a bootstrap, keyed by resample.
    Bootstrap = 22,
    /// Offsets of motion against music, keyed by the phrase's id.
    BeatOffset = 23,
    /// Dropped style conditions of classifier-free guidance, keyed by step and micro-batch.
    StyleDropout = 24,
    /// Initial noise of patch matching.
    Matching = 25,
    /// Frame numbers of a goal's keyframes, keyed by the clip's id.
    GoalFrames = 26,
    /// Order in which motions and captions are divided into pools.
    Pools = 27,
    /// Vectors of words without published vectors, keyed by the word.
    WordVectors = 28,
    /// Halves of held-out clips.
    Halves = 29,
    /// Noise of training histories, keyed by sample.
    HistoryDrift = 30,
}

/// The name of a random number stream: a seed, a [`Purpose`] and any number of counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key([u64; 4]);

/// The finalizer of SplitMix64, a bijection of 64-bit words.
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Key {
    /// The key of `purpose` in the run with this `seed`.
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        Self([
            0x6b69_6e65_6772_6164,
            0x3c6e_f372_fe94_f82b,
            0xa54f_f53a_5f1d_36f1,
            0x510e_527f_ade6_82d1,
        ])
        .at(seed)
        .at(purpose as u64)
    }

    /// The key one level below, by number: step of a run, micro-batch of a step, layer of a
    /// network.
    #[must_use]
    pub fn at(self, counter: u64) -> Self {
        let mut words = self.0;
        let mut carry = mix(counter.wrapping_add(0x9e37_79b9_7f4a_7c15));
        for (lane, word) in words.iter_mut().enumerate() {
            *word = mix(*word ^ carry ^ (lane as u64).wrapping_mul(0xd6e8_feb8_6659_fd93));
            carry = carry.rotate_left(17).wrapping_add(*word);
        }
        words[0] = mix(words[0] ^ carry);
        Self(words)
    }

    /// The key one level below, by name: a parameter's name, a phrase's id.
    #[must_use]
    pub fn named(self, name: &str) -> Self {
        name.bytes().fold(self.at(name.len() as u64), |key, byte| {
            key.at(u64::from(byte))
        })
    }

    /// A fresh generator at the start of this key's stream.
    pub fn rng(self) -> ChaCha8Rng {
        let mut seed = [0u8; 32];
        for (bytes, word) in seed.chunks_exact_mut(8).zip(self.0) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        ChaCha8Rng::from_seed(seed)
    }

    /// A seed for another tree of keys.
    pub fn seed(self) -> u64 {
        self.rng().next_u64()
    }

    /// `n` samples of the standard normal distribution.
    pub fn normals(self, n: usize) -> Vec<f32> {
        let mut rng = self.rng();
        (0..n).map(|_| StandardNormal.sample(&mut rng)).collect()
    }

    /// One uniform sample of [0, 1).
    pub fn uniform(self) -> f64 {
        self.rng().random()
    }

    /// `n` uniform samples of [0, 1).
    pub fn uniforms(self, n: usize) -> Vec<f32> {
        let mut rng = self.rng();
        (0..n).map(|_| rng.random()).collect()
    }

    /// `n` uniformly distributed integers from `0..bound`. Panics if `bound` is zero.
    pub fn integers(self, n: usize, bound: usize) -> Vec<usize> {
        let mut rng = self.rng();
        (0..n).map(|_| rng.random_range(0..bound)).collect()
    }

    /// The numbers `0..n` in random order.
    pub fn permutation(self, n: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..n).collect();
        order.shuffle(&mut self.rng());
        order
    }

    /// An inverted-dropout mask: `1 / (1 - prob)` for a surviving element, else 0.
    pub fn dropout_mask(self, n: usize, prob: f64) -> Vec<f32> {
        let mut rng = self.rng();
        let threshold = (prob * 2f64.powi(32)) as u64;
        let scale = (1.0 / (1.0 - prob)) as f32;
        (0..n)
            .map(|_| match u64::from(rng.next_u32()) < threshold {
                true => 0.0,
                false => scale,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_differ_in_every_level() {
        let base = Key::new(1, Purpose::Noise);
        let others = [
            Key::new(2, Purpose::Noise),
            Key::new(1, Purpose::Timesteps),
            base.at(0),
            base.at(1),
            base.at(0).at(0),
            base.named("a"),
            base.named("b"),
        ];
        for (i, key) in others.iter().enumerate() {
            assert_ne!(base.normals(8), key.normals(8));
            for other in &others[i + 1..] {
                assert_ne!(key.normals(8), other.normals(8));
            }
        }
    }

    #[test]
    fn seeds_differ_as_their_keys_do() {
        let key = Key::new(1, Purpose::PhraseSeed);
        assert_eq!(key.named("a").seed(), key.named("a").seed());
        let seeds = [key, key.named("a"), key.named("b"), key.at(0)].map(Key::seed);
        for (index, seed) in seeds.iter().enumerate() {
            assert!(!seeds[index + 1..].contains(seed));
        }
    }

    #[test]
    fn normals_have_zero_mean_and_unit_variance() {
        let mut pooled = Vec::new();
        for step in 0..100 {
            pooled.extend(Key::new(3, Purpose::Noise).at(step).normals(1000));
        }
        let n = pooled.len() as f64;
        let mean = pooled.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let variance = pooled.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / n;
        assert!(mean.abs() < 0.015, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.02, "variance {variance}");
    }

    #[test]
    fn dropout_mask_keeps_the_expected_share_and_the_mean() {
        let mask = Key::new(5, Purpose::Dropout).dropout_mask(100_000, 0.1);
        let dropped = mask.iter().filter(|&&m| m == 0.0).count() as f64 / 1e5;
        let mean = mask.iter().map(|&m| f64::from(m)).sum::<f64>() / 1e5;
        assert!((dropped - 0.1).abs() < 0.005, "dropped {dropped}");
        assert!((mean - 1.0).abs() < 0.005, "mean {mean}");
    }

    #[test]
    fn permutation_holds_every_number_once() {
        let mut order = Key::new(9, Purpose::DataOrder).at(4).permutation(61);
        order.sort_unstable();
        assert_eq!(order, (0..61).collect::<Vec<_>>());
    }
}
