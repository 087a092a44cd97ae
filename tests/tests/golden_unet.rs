//! The whole UNet1D, forward and backward, against golden files 03_unet and
//! 03_unet_mult1248_hashed.

use burn::tensor::Device;
use kinegrad_models::parameters::{self, HostParameter, ParameterInfo};
use kinegrad_models::{Initializer, UNet1d};
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors};
use kinegrad_tests::{unet, weights};

const OUTPUT: f64 = 2e-5;

fn build(golden: &Golden, weights: Vec<HostParameter>, device: &Device) -> UNet1d {
    let config = unet::config(golden.metadata("config"));
    let model = config
        .init(&Initializer::new(0, device))
        .expect("a valid network");
    parameters::load(model, weights).expect("the weights fit")
}

/// Compares output, loss and all stored gradients of every case in the file.
fn compare(golden: &Golden, model: &UNet1d, device: &Device, gradient_tolerance: f64) {
    let zero: Vec<String> = serde_json::from_str(golden.metadata("structurally_zero_gradients"))
        .expect("a list of names");
    let names = golden.names_under("out.");
    let cases: Vec<&str> = names
        .iter()
        .filter_map(|name| name.strip_suffix(".y"))
        .collect();
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

        let y = model.forward(x.clone(), &timesteps, cond.clone(), None);
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
        let gradients = parameters::gradients(model, &mut gradients);
        let mut compared = 0;
        for (info, gradient) in infos.iter().zip(&gradients) {
            let name = &info.name;
            let norm = gradient
                .iter()
                .map(|&g| f64::from(g).powi(2))
                .sum::<f64>()
                .sqrt();
            let key = format!("gradnorm64.{case}.{name}");
            if zero.contains(name) {
                assert!(norm < 1e-5, "{name} should vanish, norm {norm}");
                continue;
            }
            golden
                .get(&key)
                .assert_close(&key, &[norm], gradient_tolerance);
            if golden.has(&format!("grad.{case}.model.{name}")) {
                golden
                    .reference(&format!("grad.{case}.model.{name}"))
                    .assert_close_f32(&format!("{case} d{name}"), gradient, gradient_tolerance);
                compared += 1;
            }
        }
        assert!(compared > 0, "no stored gradient was compared");
    }
}

#[test]
fn golden_unet() {
    let Some(golden) = Golden::open("ccmotion", "03_unet.safetensors") else {
        return;
    };
    let device = Device::flex().autodiff();
    let model = build(&golden, weights(&golden, "model."), &device);
    compare(&golden, &model, &device, 2e-4);
}

/// Parameter number `position`, generated as docs/sources.md defines it, section 1.5.
fn hashed(info: &ParameterInfo, position: u32, seed: u32) -> HostParameter {
    let fan_in: usize = info.shape.iter().skip(1).product();
    let is_norm = info.shape.len() == 1 && info.name.ends_with("weight");
    let values = (0..info.len() as u32)
        .map(|j| {
            let mut x = seed
                .wrapping_add(position.wrapping_mul(0x9E37_79B9))
                .wrapping_add(j);
            x ^= x >> 16;
            x = x.wrapping_mul(0x7feb_352d);
            x ^= x >> 15;
            x = x.wrapping_mul(0x846c_a68b);
            x ^= x >> 16;
            let u = 2.0 * f64::from(x) / 2f64.powi(32) - 1.0;
            let value = match info.shape.len() {
                1 if is_norm => 1.0 + 0.2 * u,
                1 => 0.1 * u,
                _ => u / (fan_in as f64).sqrt(),
            };
            value as f32
        })
        .collect();
    HostParameter {
        info: info.clone(),
        values,
    }
}

#[test]
fn golden_unet_hashed() {
    let Some(golden) = Golden::open("ccmotion", "03_unet_mult1248_hashed.safetensors") else {
        return;
    };
    let device = Device::flex().autodiff();
    let config = unet::config(golden.metadata("config"));
    let model = config
        .init(&Initializer::new(0, &device))
        .expect("a valid network");
    let infos = parameters::infos(&model);
    let order: Vec<String> =
        serde_json::from_str(golden.metadata("param_order")).expect("a list of names");
    let seed = golden.metadata("hash_seed").parse().expect("a number");
    let weights: Vec<HostParameter> = order
        .iter()
        .enumerate()
        .map(|(position, name)| {
            let info = infos.iter().find(|info| info.name == *name);
            hashed(
                info.unwrap_or_else(|| panic!("no parameter {name}")),
                position as u32,
                seed,
            )
        })
        .collect();

    let all = weights.iter().flat_map(|parameter| &parameter.values);
    let sum = all.clone().map(|&v| f64::from(v)).sum::<f64>();
    assert_eq!(
        all.count() as f64,
        golden.get("check.num_parameters").scalar()
    );
    golden
        .get("check.sum64_of_all_parameters")
        .assert_close("sum", &[sum], 1e-9);

    let model = parameters::load(model, weights).expect("the weights fit");
    compare(&golden, &model, &device, 1e-4);
}
