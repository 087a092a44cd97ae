//! The temporal losses against golden file 06_temporal_loss: values, gradients, and finite
//! gradients where naive formulas have none.

use burn::tensor::{Device, Tensor};
use kinegrad_cc_motion::losses::{PhaseLoss, TemporalLossConfig, temporal_losses};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;

fn terms(motion: &Tensor<3>, config: &TemporalLossConfig) -> Vec<(&'static str, Tensor<1>)> {
    let [batch, time, _] = motion.dims();
    let mask = Tensor::ones([batch, time], &motion.device());
    temporal_losses(&motion.clone().swap_dims(1, 2), &mask, config)
}

fn value(term: &Tensor<1>) -> f64 {
    f64::from(term.clone().into_scalar::<f32>())
}

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_temporal_losses("ccmotion/06_temporal_loss.safetensors"),
        golden_jerk_of_equal_accelerations("ccmotion/06_temporal_loss.safetensors"),
    ]
}

fn golden_temporal_losses(golden: Golden) {
    let device = Device::flex().autodiff();
    let ccmotion = TemporalLossConfig::ccmotion();
    let unweighted = TemporalLossConfig {
        velocity_weight: 1.0,
        acceleration_weight: 1.0,
        jerk_weight: 1.0,
        quat_delta_weight: 1.0,
        phase_monotonic_weight: 1.0,
        ..ccmotion.clone()
    };
    for case in ["random", "smooth", "raw"] {
        let tolerance = if case == "smooth" { 1e-4 } else { 2e-6 };
        let motion = || {
            golden
                .tensor::<3>(&format!("in.{case}.motion"), &device)
                .require_grad()
        };
        let names: Vec<&str> = terms(&motion(), &ccmotion)
            .iter()
            .map(|(n, _)| *n)
            .collect();
        assert_eq!(names.len(), 5, "CC-MotionGen's terms");
        for name in names {
            let motion = motion();
            let (_, term) = terms(&motion, &ccmotion)
                .into_iter()
                .find(|(n, _)| *n == name)
                .expect("the same terms");
            golden
                .reference(&format!("out.{case}.{name}"))
                .assert_close(&format!("{case} {name}"), &[value(&term)], 2e-6);
            let gradient = motion.grad(&term.backward()).expect("a gradient");
            golden
                .reference(&format!("grad.{case}.{name}"))
                .assert_close_tensor(&format!("d {case} {name}"), gradient, tolerance);
        }
        for (name, term) in terms(&motion(), &unweighted) {
            golden
                .reference(&format!("out.{case}.unweighted.{name}"))
                .assert_close(&format!("{case} unweighted {name}"), &[value(&term)], 2e-6);
        }
        let motion = motion();
        let total = terms(&motion, &ccmotion).into_iter().map(|(_, term)| term);
        let total = total.reduce(|a, b| a + b).expect("five terms");
        golden
            .reference(&format!("out.{case}.total"))
            .assert_close(case, &[value(&total)], 2e-6);
        let gradient = motion.grad(&total.backward()).expect("a gradient");
        golden
            .reference(&format!("grad.{case}.total"))
            .assert_close_tensor(&format!("d {case} total"), gradient, tolerance);

        let sound = TemporalLossConfig {
            phase: PhaseLoss::BackwardSteps,
            ..ccmotion.clone()
        };
        let phase = terms(&motion, &sound)
            .into_iter()
            .find(|(name, _)| *name == "phase_monotonic");
        golden
            .reference(&format!("out.{case}.alt.phase_backward_steps"))
            .assert_close(case, &[value(&phase.expect("a phase term").1)], 2e-6);
        // CC-MotionGen's form, whose gradient is not a number everywhere, has the same value.
        let jerk = jerk(&motion);
        golden
            .reference(&format!("out.{case}.jerk_literal_sqrt"))
            .assert_close(&format!("{case} literal jerk"), &[value(&jerk)], 2e-6);
    }
}

fn jerk(motion: &Tensor<3>) -> Tensor<1> {
    let terms = terms(motion, &TemporalLossConfig::ccmotion());
    let jerk = terms.into_iter().find(|(name, _)| *name == "jerk");
    jerk.expect("a jerk term").1
}

/// Equal accelerations in a row, where CC-MotionGen's form has NaN.
fn golden_jerk_of_equal_accelerations(golden: Golden) {
    let device = Device::flex().autodiff();
    let motion = golden
        .tensor::<3>("in.const_accel.motion", &device)
        .require_grad();
    let jerk = jerk(&motion);
    golden
        .reference("out.const_accel.jerk")
        .assert_close("const_accel", &[value(&jerk)], 2e-6);
    let gradient = motion.grad(&jerk.backward()).expect("a gradient");
    golden
        .reference("grad.const_accel.jerk")
        .assert_close_tensor("d const_accel", gradient, 2e-6);
    let naive = golden.get("out.const_accel.naive_grad_is_nan");
    assert!(
        naive.values.contains(&1.0),
        "a motion that CC-MotionGen's form fails on"
    );
}
