//! Properties of the sampling loops, with networks of known predictions.

use burn::tensor::{Device, TensorData};
use kinegrad_random::{Key, Purpose};
use proptest::prelude::*;

use std::ops::ControlFlow;

use super::*;
use crate::{BetaSchedule, DiffusionConfig, PredictionType};

/// Predicts `cond` as the clean motion: the optimal denoiser of a dataset of one motion.
struct Knows<'a>(&'a GaussianDiffusion);

impl Denoiser for Knows<'_> {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        let to = self.0.config.prediction_type;
        self.0.convert(
            cond.clone(),
            x_t,
            &Time::timesteps(time),
            PredictionType::Sample,
            to,
        )
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.zeros_like()
    }
}

/// A nonlinear prediction that depends on all inputs.
struct Waves;

impl Denoiser for Waves {
    type Cond = ();

    fn predict(&self, x_t: Tensor<3>, time: &[Time], _: &()) -> Tensor<3> {
        (x_t + time[0].0 * 0.01).sin()
    }

    fn null_cond(&self, _: &()) {}
}

/// Drops a channel.
struct Narrow;

impl Denoiser for Narrow {
    type Cond = ();

    fn predict(&self, x_t: Tensor<3>, _: &[Time], _: &()) -> Tensor<3> {
        x_t.narrow(1, 0, 1)
    }

    fn null_cond(&self, _: &()) {}
}

const SHAPE: [usize; 3] = [2, 3, 5];

fn kinds(timesteps: Timesteps, eta: f64) -> [SamplerKind; 4] {
    let ddim = Ddim {
        timesteps,
        eta,
        ..Ddim::default()
    };
    [
        SamplerKind::Ddim(ddim),
        SamplerKind::Ddpm(timesteps.into()),
        SamplerKind::Dpmpp2m(timesteps),
        SamplerKind::Heun(timesteps),
    ]
}

fn ddim(eta: f64, num_inference_steps: usize) -> SamplerConfig {
    let [ddim, ..] = kinds(Timesteps::default(), eta);
    SamplerConfig::new(ddim, num_inference_steps)
}

fn ddpm(num_inference_steps: usize) -> SamplerConfig {
    let ddpm = SamplerKind::Ddpm(Ddpm::default());
    SamplerConfig::new(ddpm, num_inference_steps)
}

fn normal(seed: u64) -> Tensor<3> {
    let values = Key::new(seed, Purpose::Noise).normals(SHAPE.iter().product());
    Tensor::from_data(TensorData::new(values, SHAPE), &Device::flex())
}

fn key(seed: u64) -> Key {
    Key::new(seed, Purpose::Sampling)
}

fn process(num_train_timesteps: usize, prediction_type: PredictionType) -> GaussianDiffusion {
    let config = DiffusionConfig {
        num_train_timesteps,
        prediction_type,
        beta_schedule: BetaSchedule::Linear,
        ..Default::default()
    };
    GaussianDiffusion::new(&config).unwrap()
}

fn run<D: Denoiser>(
    diffusion: &GaussianDiffusion,
    denoiser: &D,
    cond: &D::Cond,
    config: &SamplerConfig,
    key: Key,
) -> Tensor<3> {
    try_run(diffusion, denoiser, cond, config, key).unwrap()
}

fn try_run<D: Denoiser>(
    diffusion: &GaussianDiffusion,
    denoiser: &D,
    cond: &D::Cond,
    config: &SamplerConfig,
    key: Key,
) -> Result<Tensor<3>, Error> {
    let ignore = &mut |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
    sample(
        diffusion,
        denoiser,
        normal(1),
        cond,
        config,
        &ClipRange::None,
        key,
        ignore,
    )
}

fn largest(x: Tensor<3>) -> f32 {
    x.abs().max().into_scalar()
}

fn any_type() -> impl Strategy<Value = PredictionType> {
    prop_oneof![
        Just(PredictionType::Epsilon),
        Just(PredictionType::Sample),
        Just(PredictionType::VPrediction)
    ]
}

fn any_config(total: usize) -> impl Strategy<Value = SamplerConfig> {
    let spacing = prop_oneof![
        Just(TimestepSpacing::CcMotion),
        Just(TimestepSpacing::Leading),
        Just(TimestepSpacing::Linspace),
        Just(TimestepSpacing::Trailing)
    ];
    (0..4usize, 1..=total, 0.0..=1.0, spacing, any::<bool>()).prop_map(
        |(kind, num_inference_steps, eta, timestep_spacing, recompute_epsilon)| {
            let timesteps = Timesteps {
                timestep_spacing,
                guidance_until: 0,
            };
            let mut kind = kinds(timesteps, eta)[kind];
            if let SamplerKind::Ddim(ddim) = &mut kind {
                ddim.recompute_epsilon = recompute_epsilon;
            }
            SamplerConfig::new(kind, num_inference_steps)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// This holds for every kind, spacing, number of steps and prediction type.
    #[test]
    fn a_network_that_knows_the_motion_leads_to_it(
        config in any_config(50),
        prediction_type in any_type(),
    ) {
        let diffusion = process(50, prediction_type);
        let x = run(&diffusion, &Knows(&diffusion), &normal(7), &config, key(3));
        let error = largest(x - normal(7));
        prop_assert!(error < 1e-4, "{error}");
    }

    #[test]
    fn without_eta_ddim_is_deterministic(steps in 1..=20usize, seed: u64) {
        let config = ddim(0.0, steps);
        let diffusion = process(20, PredictionType::Epsilon);
        let [one, other] =
            [seed, seed ^ 1].map(|seed| run(&diffusion, &Waves, &(), &config, key(seed)));
        prop_assert_eq!(one.into_data(), other.into_data());
    }

    #[test]
    fn ddpm_is_ddim_with_eta_one(total in 2usize..40, prediction_type in any_type()) {
        let diffusion = process(total, prediction_type);
        let ddim = run(&diffusion, &Waves, &(), &ddim(1.0, total), key(3));
        let ddpm = run(&diffusion, &Waves, &(), &ddpm(total), key(3));
        let scale = largest(ddpm.clone()).max(1.0);
        let error = largest(ddim - ddpm) / scale;
        prop_assert!(error < 2e-5, "{error}");
    }
}

#[test]
fn the_key_decides_the_noise_and_nothing_else_does() {
    let diffusion = process(20, PredictionType::Epsilon);
    for config in [ddim(1.0, 5), ddpm(5)] {
        let [one, again, other] =
            [1, 1, 2].map(|seed| run(&diffusion, &Waves, &(), &config, key(seed)).into_data());
        assert_eq!(one, again);
        assert_ne!(one, other);
    }
}

#[test]
fn a_sample_does_not_depend_on_its_batch() {
    let diffusion = process(20, PredictionType::Epsilon);
    let config = ddpm(20);
    let both = run(&diffusion, &Waves, &(), &config, key(5));
    let ignore = &mut |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
    let first = normal(1).narrow(0, 0, 1);
    let alone = sample(
        &diffusion,
        &Waves,
        first,
        &(),
        &config,
        &ClipRange::None,
        key(5),
        ignore,
    );
    assert_eq!(both.narrow(0, 0, 1).into_data(), alone.unwrap().into_data());
}

#[test]
fn a_sample_with_its_own_key_is_the_same_anywhere_in_a_batch() {
    let diffusion = process(20, PredictionType::Epsilon);
    let config = ddpm(20);
    let sampled = |start: Tensor<3>, keys: &[Key]| {
        let (clip, keys) = (ClipRange::None, NoiseKeys::Samples(keys));
        let ignore = &mut |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
        sample(&diffusion, &Waves, start, &(), &config, &clip, keys, ignore).unwrap()
    };
    let both = sampled(normal(1), &[key(5), key(6)]);
    let second = sampled(normal(1).narrow(0, 1, 1), &[key(6)]);
    assert_eq!(both.clone().narrow(0, 1, 1).into_data(), second.into_data());
    let other = sampled(normal(1), &[key(5), key(7)]);
    assert_eq!(
        both.clone().narrow(0, 0, 1).into_data(),
        other.clone().narrow(0, 0, 1).into_data()
    );
    assert_ne!(both.into_data(), other.into_data());
}

#[test]
fn parts_share_the_noise_of_their_frames() {
    let (channels, time) = (2, 5);
    let starts = [0, 3, 4];
    let values = noise_of_parts(key(9), &starts, [channels, time]);
    assert_eq!(values.len(), 3 * channels * time);
    let at = |part: usize, channel: usize, t: usize| {
        values[(part * channels + channel) * time + t - starts[part]]
    };
    for channel in 0..channels {
        for t in 0..9 {
            let shared = (0..3).filter(|part| (starts[*part]..starts[*part] + time).contains(&t));
            let found: Vec<f32> = shared.map(|part| at(part, channel, t)).collect();
            let expected = key(9).at(t as u64).normals(channels)[channel];
            assert!(!found.is_empty() && found.iter().all(|noise| *noise == expected));
        }
    }
    // The noise of a part does not depend on the earlier parts.
    assert_eq!(noise_of_parts(key(9), &[4], [channels, time]), values[20..]);
}

#[test]
fn guidance_scales_the_effect_of_the_condition() {
    let diffusion = process(50, PredictionType::Sample);
    let config = SamplerConfig {
        guidance_scale: 3.0,
        ..SamplerConfig::default()
    };
    let x = run(&diffusion, &Knows(&diffusion), &normal(7), &config, key(3));
    assert!(largest(x - normal(7) * 3.0) < 1e-4);
}

#[test]
fn on_step_sees_every_state_and_the_last_is_the_sample() {
    let diffusion = process(50, PredictionType::Epsilon);
    let config = ddim(0.0, 7);
    let mut seen = Vec::new();
    let on_step = &mut |step: usize, total: usize, x: &Tensor<3>| {
        seen.push((step, total, x.to_data()));
        ControlFlow::Continue(())
    };
    let clip = ClipRange::Symmetric(1.0);
    let x = sample(
        &diffusion,
        &Waves,
        normal(1),
        &(),
        &config,
        &clip,
        key(1),
        on_step,
    )
    .unwrap();
    assert_eq!(
        seen.iter().map(|s| (s.0, s.1)).collect::<Vec<_>>(),
        (1..8).map(|i| (i, 7)).collect::<Vec<_>>()
    );
    assert_eq!(seen[6].2, x.into_data());
    assert!(seen.windows(2).all(|pair| pair[0].2 != pair[1].2));
}

#[test]
fn on_step_can_stop_every_sampler() {
    let diffusion = process(50, PredictionType::Epsilon);
    for kind in kinds(Timesteps::default(), 0.0) {
        let config = SamplerConfig::new(kind, 7);
        let kind = &config.kind;
        let mut last = 0;
        let stopped = sample(
            &diffusion,
            &Waves,
            normal(1),
            &(),
            &config,
            &ClipRange::None,
            key(1),
            &mut |step, _, _| {
                last = step;
                match step {
                    3 => ControlFlow::Break(()),
                    _ => ControlFlow::Continue(()),
                }
            },
        );
        assert!(matches!(stopped, Err(Error::Stopped)), "{kind:?}");
        assert_eq!(last, 3, "{kind:?}");
    }
}

#[test]
fn the_last_step_ends_at_the_clipped_motion() {
    let diffusion = process(50, PredictionType::Epsilon);
    let clip = ClipRange::PerChannel {
        min: vec![-0.1, -0.2, -0.3],
        max: vec![0.4, 0.5, 0.6],
    };
    for kind in kinds(Timesteps::default(), 0.0) {
        let config = SamplerConfig::new(kind, 20);
        let ignore = &mut |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
        let x = sample(
            &diffusion,
            &Waves,
            normal(1),
            &(),
            &config,
            &clip,
            key(1),
            ignore,
        )
        .unwrap();
        let within = clip.apply(x.clone()).unwrap();
        assert!(largest(within - x) < 1e-6);
    }
}

/// After clipping, the recomputed noise and the clipped motion add up to x_t. The network's noise
/// does not.
#[test]
fn recomputed_noise_belongs_to_the_clipped_motion() {
    let diffusion = process(50, PredictionType::Epsilon);
    let clip = ClipRange::Symmetric(0.1);
    let step = |recompute_epsilon| {
        let config = Ddim {
            recompute_epsilon,
            ..Ddim::default()
        };
        let now = [30, 30];
        let prediction = Prediction::new(&diffusion, normal(2), normal(1), &now, &clip).unwrap();
        // A step to the same timestep returns x_t if motion and noise are consistent.
        ddim_step(&diffusion, &prediction, &now, &now.map(Some), None, &config)
    };
    assert!(largest(step(true) - normal(1)) < 1e-6);
    assert!(largest(step(false) - normal(1)) > 0.1);
}

#[test]
fn wrong_sizes_are_errors() {
    let diffusion = process(50, PredictionType::Epsilon);
    let ignore = &mut |_: usize, _: usize, _: &Tensor<3>| ControlFlow::Continue(());
    let good = SamplerConfig::default();
    let many = SamplerConfig {
        num_inference_steps: 51,
        ..good.clone()
    };
    let clip = ClipRange::None;
    let result = sample(
        &diffusion,
        &Waves,
        normal(1),
        &(),
        &many,
        &clip,
        key(1),
        ignore,
    );
    assert!(matches!(result, Err(Error::Setting(_))));
    let narrow = ClipRange::PerChannel {
        min: vec![0.0],
        max: vec![1.0],
    };
    let result = sample(
        &diffusion,
        &Waves,
        normal(1),
        &(),
        &good,
        &narrow,
        key(1),
        ignore,
    );
    assert!(matches!(result, Err(Error::Setting(_))));
    let result = sample(
        &diffusion,
        &Narrow,
        normal(1),
        &(),
        &good,
        &clip,
        key(1),
        ignore,
    );
    assert!(matches!(result, Err(Error::ModelOutput { .. })));
}

#[test]
fn a_schedule_that_ends_in_pure_noise_can_be_sampled() {
    let config = DiffusionConfig {
        num_train_timesteps: 50,
        rescale_betas_zero_snr: true,
        prediction_type: PredictionType::VPrediction,
        ..Default::default()
    };
    let diffusion = GaussianDiffusion::new(&config).unwrap();
    let timesteps = Timesteps {
        timestep_spacing: TimestepSpacing::Trailing,
        guidance_until: 0,
    };
    for kind in kinds(timesteps, 0.5) {
        let config = SamplerConfig::new(kind, 20);
        if matches!(config.kind, SamplerKind::Heun(_)) {
            // Heun's slope is that of x / alpha, which is undefined for pure noise.
            let network = Knows(&diffusion);
            let refused = try_run(&diffusion, &network, &normal(7), &config, key(3));
            assert!(matches!(refused, Err(Error::Setting(_))));
            continue;
        }
        let x = run(&diffusion, &Knows(&diffusion), &normal(7), &config, key(3));
        assert!(largest(x - normal(7)) < 1e-4, "{}", config.kind);
    }
}

#[test]
fn the_larger_variance_of_ddpm_is_beta_and_changes_samples() {
    let diffusion = process(20, PredictionType::Sample);
    let of = |variance_type| {
        let kind = SamplerKind::Ddpm(Ddpm {
            variance_type,
            ..Ddpm::default()
        });
        let config = SamplerConfig::new(kind, 20);
        run(&diffusion, &Waves, &(), &config, key(3))
    };
    let [small, large] = [VarianceType::FixedSmall, VarianceType::FixedLarge].map(of);
    assert!(largest(large - small.clone()) > 1e-4);
    let usual = run(&diffusion, &Waves, &(), &ddpm(20), key(3));
    assert_eq!(usual.into_data(), small.into_data());

    let step = |t: usize, variance_type| {
        let zeros = || Tensor::<3>::zeros(SHAPE, &Device::flex());
        let prediction =
            Prediction::new(&diffusion, zeros(), zeros(), &[t; 2], &ClipRange::None).unwrap();
        let config = Ddpm {
            variance_type,
            ..Ddpm::default()
        };
        let noise = Some(Tensor::ones(SHAPE, &Device::flex()));
        let before = [t.checked_sub(1); 2];
        let x = ddpm_step(
            &diffusion,
            &prediction,
            &[t; 2],
            &before,
            [noise, None],
            &config,
        );
        f64::from(largest(x)).powi(2)
    };
    for t in [1, 7, 19] {
        let schedule = &diffusion.schedule;
        let found = [VarianceType::FixedSmall, VarianceType::FixedLarge].map(|v| step(t, v));
        for (found, expected) in found
            .iter()
            .zip([schedule.posterior_variance[t], schedule.betas[t]])
        {
            assert!(
                (found / expected - 1.0).abs() < 1e-5,
                "{t}: {found} {expected}"
            );
        }
    }
    assert_eq!(step(0, VarianceType::FixedLarge), 0.0, "the clean motion");
}
