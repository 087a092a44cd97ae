//! The motion decoder against golden file 04_decoder: outputs and gradients, in the linear and in
//! the saturated range.

use burn::tensor::Device;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{decoder, trials, weights};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![golden_decoder("ccmotion/04_decoder.safetensors"),]
}

fn golden_decoder(golden: Golden) {
    let device = Device::flex().autodiff();
    let size = |key: &str| golden.metadata(key).parse::<usize>().expect("a size");
    let decoder = decoder::of_size(size("hidden"), size("layers"), &device);
    let decoder = parameters::load(decoder, weights(&golden, "model.")).expect("the weights fit");
    let infos = parameters::infos(&decoder);

    for (case, tolerance) in [("unit", 1e-5), ("large", 2e-4)] {
        // Golden files have [batch, time, channels].
        let x = golden.tensor::<3>(&format!("in.{case}.x"), &device);
        let x = x.require_grad();
        let y = decoder
            .forward(x.clone().swap_dims(1, 2), None)
            .swap_dims(1, 2);
        golden
            .reference(&format!("out.{case}.y"))
            .assert_close_tensor(case, y.clone(), 1e-5);
        let target = golden.tensor::<3>(&format!("in.{case}.target"), &device);
        let loss = (y - target).square().mean();
        let value = f64::from(loss.clone().into_scalar::<f32>());
        golden
            .reference(&format!("out.{case}.loss"))
            .assert_close(case, &[value], 1e-5);

        let mut tracked = loss.backward();
        let gradient = x.grad_remove(&mut tracked).expect("a gradient");
        golden
            .reference(&format!("grad.{case}.in.x"))
            .assert_close_tensor("dx", gradient.clone(), tolerance);
        let norm = f64::from(gradient.square().sum().sqrt().into_scalar::<f32>());
        golden.get(&format!("gradnorm64.{case}.in.x")).assert_close(
            &format!("{case} |dx|"),
            &[norm],
            tolerance,
        );
        let gradients = kinegrad_models::gradients(&decoder, &mut tracked);
        let stored = golden.names_under(&format!("grad.{case}.model."));
        let mut compared = 0;
        for (info, gradient) in infos.iter().zip(&gradients) {
            let name = &info.name;
            if stored.contains(name) {
                compared += 1;
                golden
                    .reference(&format!("grad.{case}.model.{name}"))
                    .assert_close_f32(&format!("{case} d{name}"), gradient, tolerance);
            }
            let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>();
            golden
                .get(&format!("gradnorm64.{case}.model.{name}"))
                .assert_close(&format!("{case} |d{name}|"), &[norm.sqrt()], tolerance);
        }
        assert_eq!(compared, stored.len(), "every stored gradient");
    }
}
