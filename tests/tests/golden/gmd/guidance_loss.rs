//! The loss of a goal and its gradient through the denoiser, derived by hand in double precision.

use kinegrad_motion::goal::{GuidanceConfig, GuidanceLoss, GuidanceNorm};
use kinegrad_tests::golden::Golden;
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

use super::guidance::goals;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![golden_guidance_of_the_trajectory_agrees(
        "gmd/guidance.safetensors",
        "gmd/schedule_cosine1000.safetensors"
    ),]
}

/// The reference's denoiser of the trajectory, `s tanh(W x + v t / 1000)`, on one frame of noise,
/// and the clamped prediction of the clean motion.
struct Denoiser {
    weights: Vec<f64>,
    time: Vec<f64>,
    size: f64,
}

impl Denoiser {
    /// The prediction for each channel and its slopes by each channel of `x`.
    fn predict(&self, x: &[f64], t: f64, alpha: f64) -> Vec<(f64, Vec<f64>)> {
        let noise_share = (1.0 / alpha - 1.0).sqrt();
        let rows = self.weights.chunks(x.len()).zip(&self.time).enumerate();
        let channel = |(index, (weights, time)): (usize, (&[f64], &f64))| {
            let dot: f64 = weights.iter().zip(x).map(|(w, x)| w * x).sum();
            let wave = (dot + time * t / 1000.0).tanh();
            let start = x[index] / alpha.sqrt() - noise_share * self.size * wave;
            let slope = |(other, weight): (usize, &f64)| {
                let direct = if other == index {
                    alpha.sqrt().recip()
                } else {
                    0.0
                };
                let slope = direct - noise_share * self.size * (1.0 - wave * wave) * weight;
                // A clamped prediction has no gradient.
                if start.abs() > 6.0 { 0.0 } else { slope }
            };
            let slopes = weights.iter().enumerate().map(slope).collect();
            (start.clamp(-6.0, 6.0), slopes)
        };
        rows.map(channel).collect()
    }
}

fn golden_guidance_of_the_trajectory_agrees(golden: Golden, schedule: Golden) {
    let alphas = schedule.get("out.alphas_cumprod").values;
    let denoiser = Denoiser {
        weights: golden.get("model.traj.W").values,
        time: golden.get("model.traj.v").values,
        size: golden.get("model.traj.s").values[0],
    };
    let x_t = golden.get("in.traj.x_t");
    let (batch, channels, frames) = (x_t.shape[0], x_t.shape[1], x_t.shape[3]);
    let x_t = x_t.values;
    let (mean, std) = (golden.get("in.mean").values, golden.get("in.std").values);
    let (free, obstructed) = (goals(&golden, false), goals(&golden, true));
    // Strength and end of the published guidance; obstacles are stored for every timestep.
    let (strength, until) = (100.0, 20.0);
    let variants = [
        ("l1", GuidanceNorm::L1, &free, until),
        ("mse", GuidanceNorm::Mse, &free, until),
        ("sdf_l1", GuidanceNorm::L1, &obstructed, 0.0),
    ];
    for (name, norm, goals, until) in variants {
        let config = GuidanceConfig {
            norm,
            frame_limit: Some(120),
        };
        let loss = GuidanceLoss::new(&config, goals, frames).expect("sound goals");
        let mut found = Vec::new();
        for t in golden.get("in.timesteps").values {
            let predictions: Vec<_> = (0..batch * frames)
                .map(|place| {
                    let (sample, frame) = (place / frames, place % frames);
                    let of_channel = |c| x_t[(sample * channels + c) * frames + frame];
                    let x: Vec<f64> = (0..channels).map(of_channel).collect();
                    denoiser.predict(&x, t, alphas[t as usize])
                })
                .collect();
            let metres = |prediction: &Vec<(f64, Vec<f64>)>| {
                [1, 2].map(|channel| prediction[channel].0 * std[channel] + mean[channel])
            };
            let ground: Vec<f64> = predictions.iter().flat_map(metres).collect();
            let (_, gradient) = loss.evaluate(&ground);
            let scaled = |sample: usize, channel: usize, frame: usize| {
                let place = sample * frames + frame;
                let through = |axis: usize| {
                    let slope = predictions[place][axis + 1].1[channel];
                    gradient[2 * place + axis] * std[axis + 1] * slope
                };
                let acts = if t >= until { strength } else { 0.0 };
                -acts * (through(0) + through(1))
            };
            for sample in 0..batch {
                for channel in 0..channels {
                    found.extend((0..frames).map(|frame| scaled(sample, channel, frame)));
                }
            }
        }
        let key = format!("out.traj.{name}.scaled_grad");
        golden.get(&key).assert_within_f64(&key, &found, 1e-4, 1e-4);
    }
}
