//! A random phrase for the tests of this crate: smooth and coherent.

use std::f64::consts::TAU;

use kinegrad_random::{Key, Purpose};

use crate::{FPS, Phrase, Quaternion, derive};

/// A coherent phrase of `frames` frames: sums of slow sines in position and rotation.
pub fn random_phrase(seed: u64, frames: usize) -> Phrase {
    let key = Key::new(seed, Purpose::Synthetic);
    let wave = |channel: u64, t: usize| -> f64 {
        let uniforms = key.at(channel).uniforms(6);
        let seconds = t as f64 / FPS;
        (0..3)
            .map(|part| {
                let frequency = 0.5 + f64::from(uniforms[2 * part]);
                let offset = TAU * f64::from(uniforms[2 * part + 1]);
                (TAU * frequency * seconds + offset).sin() / (1 + part) as f64
            })
            .sum()
    };
    let vector = |first: u64, size: f64, t: usize| [0, 1, 2].map(|i| size * wave(first + i, t));
    let positions: Vec<_> = (0..frames).map(|t| vector(0, 0.4, t)).collect();
    let orientations: Vec<_> = (0..frames)
        .map(|t| Quaternion::from_rotation_vector(vector(3, 0.8, t)))
        .collect();
    let phase: Vec<f64> = (0..frames).map(|t| (t as f64 / 60.0).fract()).collect();
    let style: Vec<[f64; 8]> = (0..frames)
        .map(|t| std::array::from_fn(|i| wave(6 + i as u64, t)))
        .collect();
    derive(&positions, &orientations, &phase, &style).unwrap()
}
