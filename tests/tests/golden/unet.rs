//! The complete UNet1D, forward and backward, against golden files 03_unet and
//! 03_unet_mult1248_hashed.

use std::collections::BTreeSet;

use burn::tensor::Device;
use kinegrad_cc_motion::network::UNet1d;
use kinegrad_diffusion::Time;
use kinegrad_models::Initializer;
use kinegrad_models::parameters::{self, HostParameter, ParameterInfo};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors, wide};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::weights::{generated, order};
use kinegrad_tests::{trials, unet, weights};

const OUTPUT: f64 = 2e-5;
const STAGE: f64 = 5e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_unet("ccmotion/03_unet.safetensors"),
        golden_unet_stages("ccmotion/03_unet.safetensors"),
        golden_unet_hashed("ccmotion/03_unet_mult1248_hashed.safetensors"),
    ]
}

/// The file's network with new weights.
fn fresh(golden: &Golden, device: &Device) -> UNet1d {
    unet::fresh(golden.metadata("config"), &Initializer::new(0, device))
}

fn build(golden: &Golden, weights: Vec<HostParameter>, device: &Device) -> UNet1d {
    parameters::load(fresh(golden, device), weights).expect("the weights fit")
}

/// Compares output, loss and all stored gradients of every case in the file.
fn compare(golden: &Golden, model: &UNet1d, device: &Device, gradient_tolerance: f64) {
    let zero: Vec<String> = serde_json::from_str(golden.metadata("structurally_zero_gradients"))
        .expect("a list of names");
    let names = golden.names_under("out.");
    let cases = names.iter().filter_map(|name| name.strip_suffix(".y"));
    let cases: Vec<&str> = cases.collect();
    assert!(!cases.is_empty());
    for case in cases {
        let x = golden
            .tensor::<3>(&format!("in.{case}.x"), device)
            .require_grad();
        let cond = golden
            .tensor::<3>(&format!("in.{case}.cond"), device)
            .require_grad();
        let timesteps = golden.get(&format!("in.{case}.t")).indices();
        let target = golden.tensor::<3>(&format!("in.{case}.eps"), device);

        let y = model.forward(x.clone(), &Time::of(&timesteps), cond.clone(), None);
        golden
            .reference(&format!("out.{case}.y"))
            .assert_close_tensor(case, y.clone(), OUTPUT);
        let loss = (y - target).square().mean();
        let value = f64::from(loss.clone().into_scalar::<f32>());
        golden
            .reference(&format!("out.{case}.loss"))
            .assert_close("loss", &[value], OUTPUT);

        let mut gradients = loss.backward();
        for (name, tensor) in [("x", &x), ("cond", &cond)] {
            let gradient = tensor.grad(&gradients).expect("a gradient");
            golden
                .reference(&format!("grad.{case}.in.{name}"))
                .assert_close_tensor(&format!("{case} d{name}"), gradient, gradient_tolerance);
        }
        let infos = parameters::infos(model);
        let gradients = kinegrad_models::gradients(model, &mut gradients);
        let stored = golden.names_under(&format!("grad.{case}.model."));
        let mut compared = 0;
        for (info, gradient) in infos.iter().zip(&gradients) {
            let name = &info.name;
            let norm = gradient
                .iter()
                .map(|&g| f64::from(g).powi(2))
                .sum::<f64>()
                .sqrt();
            let key = format!("gradnorm64.{case}.{name}");
            compared += usize::from(stored.contains(name));
            if zero.contains(name) {
                golden.bound(&format!("{key}, which vanishes"), norm, 1e-5);
                continue;
            }
            golden
                .get(&key)
                .assert_close(&key, &[norm], gradient_tolerance);
            if stored.contains(name) {
                golden
                    .reference(&format!("grad.{case}.model.{name}"))
                    .assert_close_f32(&format!("{case} d{name}"), gradient, gradient_tolerance);
            }
        }
        assert_eq!(compared, stored.len(), "every stored gradient");
    }
}

fn golden_unet(golden: Golden) {
    let device = Device::flex().autodiff();
    let model = build(&golden, weights(&golden, "model."), &device);
    compare(&golden, &model, &device, 2e-4);
}

/// The output of each part, if the file has it.
fn golden_unet_stages(golden: Golden) {
    let device = Device::flex();
    let model = build(&golden, weights(&golden, "model."), &device);
    let names = golden.names_under("out.");
    let taps = names.iter().filter_map(|name| name.split_once(".tap."));
    let cases: BTreeSet<&str> = taps.map(|(case, _)| case).collect();
    for case in cases {
        let mut stages = Noted::default();
        model.forward_stages(
            golden.tensor(&format!("in.{case}.x"), &device),
            &Time::of(&golden.get(&format!("in.{case}.t")).indices()),
            golden.tensor(&format!("in.{case}.cond"), &device),
            None,
            &mut stages,
        );
        for tap in golden.names_under(&format!("out.{case}.tap.")) {
            let reference = golden.reference(&format!("out.{case}.tap.{tap}"));
            let what = format!("{case} {tap}");
            assert_eq!(stages.shape(&tap), reference.shape, "{what}: shape");
            reference.assert_close_f32(&what, stages.values(&tap), STAGE);
        }
    }
}

/// Weights from a hash, with the network's shapes.
fn golden_unet_hashed(golden: Golden) {
    let device = Device::flex().autodiff();
    let infos = parameters::infos(&fresh(&golden, &device));
    let layout: Vec<ParameterInfo> = order(&golden)
        .iter()
        .map(|name| {
            let info = infos.iter().find(|info| info.name == *name);
            info.unwrap_or_else(|| panic!("no parameter {name}"))
                .clone()
        })
        .collect();
    let weights = generated(&golden, &layout);
    let seed: f64 = golden.metadata("hash_seed").parse().expect("a number");
    golden.compare_exactly("check.hash_seed", &[seed]);
    let of = |name: &str| {
        let weight = weights.iter().find(|weight| weight.info.name == name);
        wide(&weight.expect("a parameter").values)
    };
    let first = "time_embed.0.weight";
    golden.compare_exactly(&format!("check.first8.{first}"), &of(first)[..8]);
    let last = "output_conv.weight";
    let values = of(last);
    let tail = &values[values.len() - 8..];
    golden.compare_exactly(&format!("check.last8.{last}"), tail);
    let model = build(&golden, weights, &device);
    compare(&golden, &model, &device, 1e-4);
}
