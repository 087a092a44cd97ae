use std::cell::Cell;
use std::ops::ControlFlow;

use burn::tensor::{DType, Device, Tensor, TensorData};
use kinegrad_random::{Key, Purpose};
use proptest::prelude::*;

use super::*;
use crate::sampler::{TimestepSpacing, Timesteps};

fn go<const D: usize>(_: f64, _: &Tensor<D>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

const HEUN: SamplerKind = SamplerKind::Heun(Timesteps {
    timestep_spacing: TimestepSpacing::Linspace,
    guidance_until: 0,
});

/// Dormand and Prince's method with equal steps.
const DOPRI5: SamplerKind = SamplerKind::Dopri5(Dopri5 { tolerance: None });

fn adaptive(tolerance: f64) -> SamplerConfig {
    let tolerance = Some(tolerance);
    SamplerConfig::new(SamplerKind::Dopri5(Dopri5 { tolerance }), 1)
}

/// The error at t = 1 of `dy/dt = -2y + t` from 1.3, `(y0 + 1/4) e^-2 + 1/4`, in float64, and the
/// number of velocities.
fn error_of(config: &SamplerConfig) -> (f64, usize) {
    let (start, device) = (1.3, Device::flex());
    let y = Tensor::<1>::from_data([start], (&device, DType::F64));
    let mut calls = 0;
    let mut velocity = |y: Tensor<1>, t: f64| {
        calls += 1;
        Ok(y * -2.0 + t)
    };
    let flowed = integrate(&mut velocity, y, config, &mut go).unwrap();
    assert_eq!(flowed.evaluations, calls, "{config:?}");
    let exact = (start + 0.25) * (-2.0f64).exp() + 0.25;
    let found = flowed.x.into_data().try_to_vec::<f64>().unwrap()[0];
    ((found - exact).abs(), calls)
}

#[test]
fn solvers_have_their_orders() {
    for (kind, order, evaluations) in [
        (SamplerKind::Euler, 1.0, 1),
        (SamplerKind::Midpoint, 2.0, 2),
        (HEUN, 2.0, 2),
        (DOPRI5, 5.0, 6),
    ] {
        let errors = [32, 64, 128].map(|steps| {
            let (error, calls) = error_of(&SamplerConfig::new(kind, steps));
            assert_eq!(calls, evaluations * steps, "{kind}");
            error
        });
        for pair in errors.windows(2) {
            let observed = (pair[0] / pair[1]).log2();
            assert!((observed - order).abs() < 0.1, "{kind}: {observed}");
        }
    }
}

#[test]
fn a_tighter_tolerance_costs_more_and_is_kept() {
    let all = [1e-2, 1e-4, 1e-6].map(|tolerance| {
        let (error, calls) = error_of(&adaptive(tolerance));
        assert!(error < 3.0 * tolerance, "{tolerance}: {error}");
        (error, calls)
    });
    assert!(all[0].1 < all[1].1 && all[1].1 < all[2].1, "{all:?}");
    assert!(all[0].0 > all[2].0, "{all:?}");
}

#[test]
fn a_velocity_that_no_step_is_short_enough_for_is_an_error() {
    let start = || Tensor::<1>::ones([2], &Device::flex());
    let mut calls = 0;
    let mut broken = |y: Tensor<1>, t: f64| {
        calls += 1;
        Ok(if t > 0.5 { y * f64::NAN } else { y })
    };
    let error = integrate(&mut broken, start(), &adaptive(1e-4), &mut go).unwrap_err();
    assert!(matches!(error, Error::NotFinite), "{error}");
    assert!(calls < 200, "{calls}");
    let mut wild = |y: Tensor<1>, t: f64| Ok(y.zeros_like() + if t < 0.5 { 0.0 } else { 1e12 });
    let error = integrate(&mut wild, start(), &adaptive(1e-6), &mut go).unwrap_err();
    assert!(
        error.to_string().contains("0.5") || error.to_string().contains("0.49"),
        "{error}"
    );
}

#[test]
fn steps_are_seen_and_can_end_a_solver() {
    for kind in [SamplerKind::Euler, SamplerKind::Midpoint, HEUN, DOPRI5] {
        let mut seen = Vec::new();
        let mut still = |y: Tensor<1>, _: f64| Ok(y.zeros_like());
        let start = Tensor::<1>::ones([3], &Device::flex());
        let config = SamplerConfig::new(kind, 4);
        integrate(&mut still, start.clone(), &config, &mut |t, _| {
            seen.push(t);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(seen, [0.25, 0.5, 0.75, 1.0], "{kind}");
        let stopped = integrate(&mut still, start, &config, &mut |_, _| {
            ControlFlow::Break(())
        });
        assert!(matches!(stopped, Err(Error::Stopped)), "{kind}");
    }
}

fn normal(seed: u64, shape: [usize; 3]) -> Tensor<3> {
    let values = Key::new(seed, Purpose::Noise).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn apart(a: Tensor<3>, b: Tensor<3>) -> f32 {
    (a - b).abs().max().into_scalar()
}

const KINDS: [FlowPrediction; 3] = [
    FlowPrediction::Velocity,
    FlowPrediction::Epsilon,
    FlowPrediction::Sample,
];

proptest! {
    #[test]
    fn targets_convert_into_each_other(t in prop::collection::vec(0.05f64..0.95, 3)) {
        let (noise, x_start) = (normal(1, [3, 2, 5]), normal(2, [3, 2, 5]));
        let x_t = FlowPrediction::add_noise(noise.clone(), x_start.clone(), &t);
        for from in KINDS {
            for to in KINDS {
                let target = from.target(noise.clone(), x_start.clone());
                let found = from.convert(target, x_t.clone(), &t, to);
                let expected = to.target(noise.clone(), x_start.clone());
                prop_assert!(apart(found, expected) < 2e-4, "{from} to {to}");
            }
        }
    }
}

#[test]
fn a_path_begins_in_noise_and_ends_on_data() {
    let (noise, x_start) = (normal(1, [2, 2, 5]), normal(2, [2, 2, 5]));
    let x_t = FlowPrediction::add_noise(noise.clone(), x_start.clone(), &[0.0, 1.0]);
    assert_eq!(
        apart(x_t.clone().narrow(0, 0, 1), noise.narrow(0, 0, 1)),
        0.0
    );
    assert!(apart(x_t.narrow(0, 1, 1), x_start.narrow(0, 1, 1)) < 1e-6);
}

/// Predicts a straight path to `cond` and counts its own calls.
struct Straight(FlowPrediction, Cell<usize>);

impl Denoiser for Straight {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Tensor<3>) -> Tensor<3> {
        self.1.set(self.1.get() + 1);
        // The data determine velocity and noise until NEAREST_END.
        let inner = |t: f64| t.min(1.0 - NEAREST_END);
        let times: Vec<f64> = time.iter().map(|time| inner(time.0)).collect();
        FlowPrediction::Sample.convert(cond.clone(), x_t, &times, self.0)
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.zeros_like()
    }
}

#[test]
fn every_solver_follows_a_straight_flow_and_guidance_overshoots() {
    let (noise, data) = (normal(3, [2, 3, 4]), normal(4, [2, 3, 4]));
    for kind in [SamplerKind::Euler, SamplerKind::Midpoint, HEUN, DOPRI5] {
        for (guidance_scale, calls) in [(1.0, 1), (2.0, 2)] {
            let network = Straight(FlowPrediction::Velocity, Cell::new(0));
            let config = SamplerConfig {
                guidance_scale,
                ..SamplerConfig::new(kind, 8)
            };
            let flowed = sample_flow(
                &network,
                noise.clone(),
                &data,
                FlowPrediction::Velocity,
                &config,
                &mut go,
            )
            .unwrap();
            assert_eq!(network.1.get(), calls * flowed.evaluations, "{kind}");
            // With guidance the result is twice the data, without guidance the data.
            let error = apart(flowed.x, data.clone() * guidance_scale);
            // The bound of the divisor deflects solvers that compute a slope at t = 1.
            let allowed = if kind == SamplerKind::Euler {
                1e-5
            } else {
                0.7
            };
            assert!(error < allowed, "{kind}, {guidance_scale}: {error}");
        }
    }
}

#[test]
fn a_network_of_noise_leads_near_the_data() {
    let (noise, data) = (normal(3, [2, 3, 4]), normal(4, [2, 3, 4]));
    for (prediction, allowed) in [
        (FlowPrediction::Velocity, 1e-5),
        (FlowPrediction::Sample, 1e-5),
        (FlowPrediction::Epsilon, 0.7),
    ] {
        let network = Straight(prediction, Cell::new(0));
        let config = SamplerConfig::new(SamplerKind::Euler, 20);
        let flowed =
            sample_flow(&network, noise.clone(), &data, prediction, &config, &mut go).unwrap();
        let error = apart(flowed.x, data.clone());
        assert!(error < allowed, "{prediction}: {error}");
    }
}

#[test]
fn exact_data_is_met_in_a_single_step() {
    let (noise, data) = (normal(3, [2, 3, 4]), normal(4, [2, 3, 4]));
    for prediction in [FlowPrediction::Velocity, FlowPrediction::Sample] {
        let network = Straight(prediction, Cell::new(0));
        let config = SamplerConfig::new(SamplerKind::Euler, 1);
        let flowed =
            sample_flow(&network, noise.clone(), &data, prediction, &config, &mut go).unwrap();
        assert!(apart(flowed.x, data.clone()) < 1e-5, "{prediction}");
    }
}

#[test]
fn an_answer_of_another_size_is_refused() {
    struct Short;
    impl Denoiser for Short {
        type Cond = ();
        fn predict(&self, x_t: Tensor<3>, _: &[Time], (): &()) -> Tensor<3> {
            x_t.narrow(2, 0, 1)
        }
        fn null_cond(&self, (): &()) {}
    }
    let refused = sample_flow(
        &Short,
        normal(1, [2, 3, 4]),
        &(),
        FlowPrediction::Velocity,
        &SamplerConfig::new(SamplerKind::Euler, 1),
        &mut go,
    );
    assert!(matches!(refused, Err(Error::ModelOutput { .. })));
}
