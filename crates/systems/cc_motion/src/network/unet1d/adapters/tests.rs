use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::Time;
use kinegrad_models::parameters::{self, HostParameter};
use kinegrad_random::{Key, Purpose};

use super::*;
use crate::network::UNet1dConfig;

fn device() -> Device {
    Device::flex().autodiff()
}

fn network(device: &Device) -> UNet1d {
    let init = Initializer::new(3, device);
    let config = UNet1dConfig::tiny();
    config.init(25, 163, &init).expect("a valid network")
}

fn all() -> LoraConfig {
    LoraConfig {
        rank: 4,
        alpha: 6.0,
        targets: vec![
            LoraTarget::Attention,
            LoraTarget::Convolution,
            LoraTarget::Conditioning,
        ],
    }
}

fn adapted(config: &LoraConfig, device: &Device) -> UNet1d {
    let init = Initializer::new(9, device);
    let network = network(device);
    network
        .with_adapters(config, &init)
        .expect("valid adapters")
}

/// Adapters as after some training: no factor is zero.
fn trained(config: &LoraConfig, device: &Device) -> UNet1d {
    let key = Key::new(5, Purpose::Noise);
    parameters::update(adapted(config, device), |index, values| {
        let noise = key.at(index as u64).normals(values.len());
        for (value, noise) in values.iter_mut().zip(noise) {
            *value += 0.05 * noise;
        }
    })
}

fn output(network: &UNet1d, device: &Device) -> Tensor<3> {
    let key = Key::new(8, Purpose::Noise);
    let input = |index, channels: usize| -> Tensor<3> {
        let values = key.at(index).normals(2 * channels * 11);
        Tensor::from_data(TensorData::new(values, [2, channels, 11]), device)
    };
    network.forward(input(0, 25), &Time::of(&[3, 700]), input(1, 163), None)
}

fn values(network: &UNet1d, device: &Device) -> Vec<f32> {
    let output = output(network, device).inner();
    output.try_into_vec_as::<f32>().expect("float32")
}

fn is_adapter(name: &str) -> bool {
    name.ends_with(".lora.a") || name.ends_with(".lora.b")
}

fn names(network: &UNet1d) -> Vec<String> {
    let infos = parameters::infos(network).into_iter();
    infos.map(|info| info.name).collect()
}

fn plain_part(network: &UNet1d) -> Vec<HostParameter> {
    let parameters = parameters::export(network).into_iter();
    parameters.filter(|p| !is_adapter(&p.info.name)).collect()
}

#[test]
fn fresh_adapters_change_no_output_bit() {
    let device = Device::flex();
    let plain = values(&network(&device), &device);
    let fresh = values(&adapted(&all(), &device), &device);
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&fresh), bits(&plain));
    // The adapters are part of the forward pass.
    let trained = values(&trained(&all(), &device), &device);
    assert!(trained.iter().zip(&plain).all(|(t, p)| t != p));
}

/// Asserts that merging gives a plain network with the same output and names, on this device.
fn assert_merges(device: &Device) {
    let trained = trained(&all(), device);
    let expected = values(&trained, device);
    let merged = trained.merge_adapters();
    assert_eq!(
        parameters::infos(&merged),
        parameters::infos(&network(device))
    );
    assert!(parameters::trainable(&merged).into_iter().all(|is| is));
    let actual = values(&merged, device);
    let scale = expected.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    for (actual, expected) in actual.iter().zip(&expected) {
        let error = (actual - expected).abs() / scale;
        assert!(error < 1e-5, "{actual} {expected}");
    }
}

#[test]
fn merging_gives_the_plain_network_of_the_same_output() {
    assert_merges(&Device::flex());
    assert_merges(&device());
    assert_merges(&device().gradient_checkpointing());
}

#[test]
fn a_merged_network_trains_all_its_weights() {
    let device = device();
    let merged = trained(&all(), &device).merge_adapters();
    let mut tracked = output(&merged, &device).square().mean().backward();
    let gradients = kinegrad_models::gradients(&merged, &mut tracked);
    for (name, gradient) in names(&merged).iter().zip(gradients) {
        assert!(gradient.iter().any(|&g| g != 0.0), "{name}");
    }
}

fn assert_only_adapters_get_gradients(device: &Device) {
    let network = trained(&all(), device);
    let mut tracked = output(&network, device).square().mean().backward();
    let gradients = kinegrad_models::gradients(&network, &mut tracked);
    for (name, gradient) in names(&network).iter().zip(gradients) {
        let reached = gradient.iter().any(|&g| g != 0.0);
        assert_eq!(reached, is_adapter(name), "{name}");
    }
}

#[test]
fn only_adapters_get_gradients() {
    assert_only_adapters_get_gradients(&device());
    assert_only_adapters_get_gradients(&device().gradient_checkpointing());
}

#[test]
fn adapters_stand_beside_the_weights_they_change() {
    let device = device();
    let plain = parameters::infos(&network(&device));
    let default = LoraConfig::default();
    let adapted = parameters::infos(&adapted(&default, &device));

    // The other parameters in their order, with two factors after the bias of each adapted layer.
    let mut expected = Vec::new();
    let mut elements = 0;
    for info in &plain {
        expected.push((info.name.clone(), info.shape.clone()));
        // The default targets are the layers with a kernel: all except linear layers.
        if let Some(layer) = info.name.strip_suffix(".bias")
            && let Some(weight) = plain.iter().find(|p| p.name == format!("{layer}.weight"))
            && let [outputs, inputs, kernel] = weight.shape[..]
        {
            expected.push((format!("{layer}.lora.a"), vec![8, inputs * kernel]));
            expected.push((format!("{layer}.lora.b"), vec![outputs, 8]));
            elements += 8 * (inputs * kernel + outputs);
        }
    }
    let found: Vec<_> = adapted
        .iter()
        .map(|info| (info.name.clone(), info.shape.clone()))
        .collect();
    assert_eq!(found, expected);
    let count = |infos: &[parameters::ParameterInfo]| infos.iter().map(|i| i.len()).sum::<usize>();
    assert_eq!(count(&adapted) - count(&plain), elements);
    let first = adapted
        .iter()
        .find(|i| i.name == "enc.0.res.0.conv1.lora.a");
    assert_eq!(first.expect("the first block's").shape, [8, 96]);
}

#[test]
fn every_target_names_its_own_layers() {
    let device = device();
    let layers = |target| {
        let config = LoraConfig {
            targets: vec![target],
            ..all()
        };
        let names = names(&adapted(&config, &device)).into_iter();
        names
            .filter_map(|name| Some(name.strip_suffix(".lora.a")?.to_string()))
            .collect::<Vec<_>>()
    };
    let attention = layers(LoraTarget::Attention);
    let convolution = layers(LoraTarget::Convolution);
    let conditioning = layers(LoraTarget::Conditioning);
    // Three encoder levels, the middle and two decoder levels have attention with five projections
    // each.
    assert_eq!(attention.len(), 6 * 5);
    assert!(attention.iter().all(|name| name.contains(".attn.")));
    // 16 residual blocks with one projection of the timestep each, and the projection of the audio.
    assert_eq!(conditioning.len(), 16 + 1);
    assert!(conditioning.contains(&"enc.3.res.1.time_mlp.1".to_string()));
    assert!(conditioning.contains(&"audio_proj".to_string()));
    for name in [
        "input_conv",
        "output_conv",
        "enc.0.down",
        "mid.res2.conv2",
        "dec.3.up",
        "dec.3.res.0.skip_conv",
    ] {
        assert!(convolution.contains(&name.to_string()), "{name}");
    }
    let together = names(&adapted(&all(), &device)).into_iter();
    let together = together.filter(|name| is_adapter(name)).count();
    assert_eq!(
        together,
        2 * (attention.len() + convolution.len() + conditioning.len())
    );
}

#[test]
fn first_values_depend_on_seed_and_name_alone() {
    let device = device();
    let only = LoraConfig {
        targets: vec![LoraTarget::Attention],
        ..all()
    };
    let adapters = |network: UNet1d| {
        let parameters = parameters::export(&network).into_iter();
        parameters
            .filter(|p| is_adapter(&p.info.name))
            .collect::<Vec<_>>()
    };
    let every = adapters(adapted(&all(), &device));
    assert_eq!(adapters(adapted(&all(), &device)), every);
    for adapter in adapters(adapted(&only, &device)) {
        assert!(every.contains(&adapter), "{}", adapter.info.name);
    }
    let mut firsts = Vec::new();
    for HostParameter { info, values } in &every {
        if info.name.ends_with(".b") {
            assert!(values.iter().all(|&v| v == 0.0), "{}", info.name);
            continue;
        }
        let bound = 1.0 / (info.shape[1] as f32).sqrt();
        let largest = values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(largest <= bound && largest > 0.9 * bound, "{}", info.name);
        firsts.push((values[0] / bound).to_bits());
    }
    let adapters = firsts.len();
    firsts.sort_unstable();
    firsts.dedup();
    assert_eq!(firsts.len(), adapters, "two adapters start alike");
}

#[test]
fn the_frozen_stay_frozen_and_unchanged() {
    let device = device();
    let network = adapted(&all(), &device);
    let expected: Vec<bool> = names(&network)
        .iter()
        .map(|name| is_adapter(name))
        .collect();
    let plain = plain_part(&network);
    assert_eq!(parameters::trainable(&network), expected);
    let weights = parameters::export(&network);
    // Loads into lazy parameters here, and into initialized parameters below.
    let loaded = parameters::load(adapted(&all(), &device), weights).expect("the weights fit");
    assert_eq!(parameters::trainable(&loaded), expected);

    let mut changed = vec![false; expected.len()];
    let updated = parameters::update(loaded, |index, values| {
        changed[index] = true;
        values.iter_mut().for_each(|value| *value += 1.0);
    });
    assert_eq!(changed, expected);
    assert_eq!(parameters::trainable(&updated), expected);
    assert_eq!(plain_part(&updated), plain);

    // Also on a device without gradients, where tensors do not have the flag.
    let valid = updated.valid();
    assert_eq!(parameters::trainable(&valid), expected);
    let host = parameters::export(&updated).into_iter();
    let replaced = parameters::replace(valid, host.map(|p| p.values).collect());
    assert_eq!(parameters::trainable(&replaced), expected);
}

#[test]
fn new_adapters_start_from_the_merged_old_ones() {
    let device = Device::flex();
    let trained = trained(&all(), &device);
    let merged = trained.clone().merge_adapters();
    let init = Initializer::new(1, &device);
    let again = trained
        .with_adapters(&all(), &init)
        .expect("valid adapters");
    assert_eq!(plain_part(&again), parameters::export(&merged));
    assert_eq!(values(&again, &device), values(&merged, &device));
}

#[test]
fn bad_settings_are_refused() {
    let device = Device::flex();
    let config = LoraConfig { rank: 0, ..all() };
    let init = Initializer::new(1, &device);
    let refused = network(&device).with_adapters(&config, &init);
    assert_eq!(refused.unwrap_err().key, "lora.rank");
}
