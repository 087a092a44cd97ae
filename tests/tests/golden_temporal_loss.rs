//! The temporal losses against golden file 06_temporal_loss: values, gradients, and the finite
//! gradients at the places where naive formulas have none.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_train::losses::{PhaseLoss, TemporalLossConfig, temporal_losses};

fn terms(motion: &Tensor<3>, config: &TemporalLossConfig) -> Vec<(&'static str, Tensor<1>)> {
    let [batch, time, _] = motion.dims();
    let mask = Tensor::ones([batch, time], &motion.device());
    temporal_losses(&motion.clone().swap_dims(1, 2), &mask, config)
}

fn value(term: &Tensor<1>) -> f64 {
    f64::from(term.clone().into_scalar::<f32>())
}

#[test]
fn golden_temporal_losses() {
    let Some(golden) = Golden::open("ccmotion", "06_temporal_loss.safetensors") else {
        return;
    };
    let device = Device::flex().autodiff();
    let document = TemporalLossConfig::document();
    for case in ["random", "smooth", "raw"] {
        let tolerance = if case == "smooth" { 1e-4 } else { 2e-6 };
        let motion = || {
            golden
                .tensor::<3>(&format!("in.{case}.motion"), &device)
                .require_grad()
        };
        let names: Vec<&str> = terms(&motion(), &document)
            .iter()
            .map(|(n, _)| *n)
            .collect();
        assert_eq!(names.len(), 5, "CC-MotionGen's terms");
        for name in names {
            let motion = motion();
            let (_, term) = terms(&motion, &document)
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
        let motion = motion();
        let total = terms(&motion, &document).into_iter().map(|(_, term)| term);
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
            ..document.clone()
        };
        let phase = terms(&motion, &sound)
            .into_iter()
            .find(|(name, _)| *name == "phase_monotonic");
        golden
            .reference(&format!("out.{case}.alt.phase_backward_steps"))
            .assert_close(case, &[value(&phase.expect("a phase term").1)], 2e-6);
    }

    // Equal accelerations in a row, where CC-MotionGen's form has NaN.
    let motion = golden
        .tensor::<3>("in.const_accel.motion", &device)
        .require_grad();
    let jerk = terms(&motion, &document)
        .into_iter()
        .find(|(name, _)| *name == "jerk")
        .expect("a jerk term")
        .1;
    golden
        .reference("out.const_accel.jerk")
        .assert_close("const_accel", &[value(&jerk)], 2e-6);
    let gradient = motion.grad(&jerk.backward()).expect("a gradient");
    golden
        .reference("grad.const_accel.jerk")
        .assert_close_tensor("d const_accel", gradient, 2e-6);
}

/// Every term, those that are not CC-MotionGen's included.
fn all_terms() -> TemporalLossConfig {
    TemporalLossConfig {
        quat_norm_weight: 1.0,
        angular_velocity_weight: 1.0,
        position_smoothness_weight: 1.0,
        ..TemporalLossConfig::default()
    }
}

/// A motion `[1, 8, 25]` at rest whose quaternions are those given.
fn turning(quaternions: [[f32; 4]; 8]) -> Tensor<3> {
    let mut values = vec![0.0; 8 * 25];
    for (frame, quaternion) in values.chunks_mut(25).zip(quaternions) {
        frame[9..13].copy_from_slice(&quaternion);
    }
    Tensor::from_data(
        TensorData::new(values, [1, 8, 25]),
        &Device::flex().autodiff(),
    )
}

#[test]
fn gradients_are_finite_where_formulas_are_not() {
    let unit = [1.0, 0.0, 0.0, 0.0];
    let antipodal = [-1.0, 0.0, 0.0, 0.0];
    let half_turn = [0.0, 1.0, 0.0, 0.0];
    let cases = [
        [unit; 8],
        [
            unit, antipodal, unit, antipodal, unit, antipodal, unit, antipodal,
        ],
        [
            unit, half_turn, unit, half_turn, unit, half_turn, unit, half_turn,
        ],
        [[0.0; 4]; 8],
    ];
    for quaternions in cases {
        let motion = turning(quaternions).require_grad();
        let total = terms(&motion, &all_terms()).into_iter().map(|(_, t)| t);
        let total = total.reduce(|a, b| a + b).expect("terms");
        assert!(value(&total).is_finite());
        let gradient = motion.grad(&total.backward()).expect("a gradient");
        let gradient = gradient.try_into_vec_as::<f32>().expect("float32");
        assert!(gradient.iter().all(|g| g.is_finite()), "{quaternions:?}");
    }
}

#[test]
fn angular_velocity_agrees_with_that_of_the_phrases() {
    use kinegrad_motion::{Quaternion, kinematics};
    let quaternions: Vec<Quaternion> = (0..8)
        .map(|t| {
            let angle = 0.4 * f64::from(t * t) / 8.0;
            let axis = [0.6, 0.0, 0.8].map(|c| c * angle);
            Quaternion::from_rotation_vector(axis)
        })
        .collect();
    let turns = kinematics::angular_velocity(&quaternions, 30.0);
    let mut values = vec![0.0f32; 8 * 25];
    for (t, frame) in values.chunks_mut(25).enumerate() {
        let q = quaternions[t];
        // Every second one by its other quaternion: the rotation is the same.
        let sign = if t % 2 == 0 { 1.0 } else { -1.0 };
        for (value, part) in frame[9..13].iter_mut().zip([q.w, q.x, q.y, q.z]) {
            *value = (sign * part) as f32;
        }
        for (value, part) in frame[13..16].iter_mut().zip(turns[t]) {
            *value = part as f32;
        }
    }
    let motion = Tensor::from_data(TensorData::new(values, [1, 8, 25]), &Device::flex());
    let error = terms(&motion, &all_terms())
        .into_iter()
        .find(|(name, _)| *name == "angular_velocity");
    assert!(value(&error.expect("a term").1) < 1e-9);
}

#[test]
fn padding_does_not_count() {
    let motion = turning([[1.0, 0.2, -0.3, 0.1]; 8]);
    let noise = Tensor::<3>::ones([1, 4, 25], &motion.device()) * 3.0;
    let padded = Tensor::cat(vec![motion.clone(), noise], 1);
    let mut mask = vec![1.0f32; 8];
    mask.resize(12, 0.0);
    let mask = Tensor::from_data(TensorData::new(mask, [1, 12]), &motion.device());
    let found = temporal_losses(&padded.swap_dims(1, 2), &mask, &all_terms());
    for ((name, expected), (_, found)) in terms(&motion, &all_terms()).iter().zip(&found) {
        assert!((value(expected) - value(found)).abs() < 1e-7, "{name}");
    }
}
