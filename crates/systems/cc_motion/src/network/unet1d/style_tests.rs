//! Effects of the style condition.

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::{Denoiser, GuidanceScales, Time, guided};
use kinegrad_models::parameters;
use kinegrad_random::{Key, Purpose};
use serde::Deserialize;
use serde::de::value::{Error as ValueError, MapDeserializer};

use super::*;

const FEATURES: usize = 7;
const TIME: usize = 13;

fn config(style: StyleConditioning, labels: &[&str]) -> UNet1dConfig {
    UNet1dConfig {
        channel_mult: vec![1, 1],
        time_embed_dim: 48,
        context_dim: 32,
        style,
        style_labels: labels.iter().map(|label| label.to_string()).collect(),
        ..UNet1dConfig::tiny()
    }
}

fn network(style: StyleConditioning, labels: &[&str], device: &Device) -> UNet1d {
    let init = Initializer::new(3, device);
    let network = config(style, labels).init(25, FEATURES, &init);
    network.expect("a valid network")
}

fn both(device: &Device) -> UNet1d {
    network(
        StyleConditioning::Both,
        &["rumba", "tango", "waltz"],
        device,
    )
}

fn normal(stream: u64, shape: [usize; 3], device: &Device) -> Tensor<3> {
    let values = Key::new(8, Purpose::Noise).at(stream);
    let values = values.normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn rows(values: Vec<Vec<f32>>, device: &Device) -> Tensor<2> {
    let shape = [values.len(), values[0].len()];
    Tensor::from_data(TensorData::new(values.concat(), shape), device)
}

fn numbers(scale: f32) -> Vec<f32> {
    let numbers = (0..8u8).map(|i| scale * (f32::from(i) - 3.0));
    numbers.chain([1.0]).collect()
}

/// One style of each kind: numbers, a label, another label, nothing.
fn styles(device: &Device) -> StyleCondition {
    let none = vec![0.0; 9];
    StyleCondition {
        numbers: Some(rows(
            vec![numbers(0.3), none.clone(), none.clone(), none],
            device,
        )),
        label: Some(rows(
            vec![
                vec![0.0, 0.0, 0.0],
                vec![0.0, 0.0, 1.0],
                vec![1.0, 0.0, 0.0],
                vec![0.0, 0.0, 0.0],
            ],
            device,
        )),
    }
}

fn condition(batch: usize, style: Option<StyleCondition>, device: &Device) -> AudioCondition {
    // The same audio for all.
    let features = normal(1, [1, FEATURES, TIME], device).repeat_dim(0, batch);
    AudioCondition {
        style,
        ..features.into()
    }
}

fn predicted(network: &UNet1d, cond: &AudioCondition) -> Tensor<3> {
    let device = cond.features.device();
    let batch = cond.features.dims()[0];
    let x = normal(0, [1, 25, TIME], &device).repeat_dim(0, batch);
    network.predict(x, &Time::of(&vec![500; batch]), cond)
}

fn largest(x: Tensor<3>) -> f32 {
    x.abs().max().into_scalar::<f32>()
}

fn sample(x: &Tensor<3>, index: usize) -> Tensor<3> {
    x.clone().narrow(0, index, 1)
}

#[test]
fn each_style_of_a_batch_has_its_own_output_and_the_null_style_is_none() {
    let device = Device::flex();
    let network = both(&device);
    let cond = condition(4, Some(styles(&device)), &device);
    let output = predicted(&network, &cond);
    for one in 0..4 {
        for other in 0..one {
            let apart = largest(sample(&output, one) - sample(&output, other));
            assert!(apart > 1e-3, "{one} {other}: {apart}");
        }
    }
    // The last sample equals a sample without a style, and every sample with its style removed.
    let none = predicted(&network, &condition(4, None, &device));
    let nothing = |x: &Tensor<3>| largest(sample(x, 3) - sample(&none, 3));
    assert!(nothing(&output) < 1e-6, "{}", nothing(&output));
    let unstyled = network.null_style(&cond).expect("a style");
    let unstyled = predicted(&network, &unstyled);
    assert!(largest(unstyled - none) < 1e-6);
}

#[test]
fn numbers_at_their_mean_are_not_the_null_style() {
    let device = Device::flex();
    let network = network(StyleConditioning::Numbers, &[], &device);
    let style = |values| StyleCondition {
        numbers: Some(rows(vec![values], &device)),
        label: None,
    };
    let of = |values| predicted(&network, &condition(1, Some(style(values)), &device));
    let apart = largest(of(numbers(0.0)) - of(vec![0.0; 9]));
    assert!(apart > 1e-3, "{apart}");
}

#[test]
fn networks_without_style_do_not_look_at_it_and_have_no_parameters_of_it() {
    let device = Device::flex();
    let plain = network(StyleConditioning::None, &[], &device);
    let cond = condition(4, Some(styles(&device)), &device);
    let (with, without) = (
        predicted(&plain, &cond),
        predicted(&plain, &condition(4, None, &device)),
    );
    assert_eq!(with.into_data(), without.into_data());
    assert!(plain.null_style(&cond).is_none());
    let names = |network: &UNet1d| -> Vec<String> {
        let infos = parameters::infos(network).into_iter();
        infos.map(|info| info.name).collect()
    };
    let (plain, styled) = (names(&plain), names(&both(&device)));
    let added: Vec<&String> = styled.iter().filter(|name| !plain.contains(name)).collect();
    assert_eq!(
        added,
        [
            "style.numbers.0.weight",
            "style.numbers.0.bias",
            "style.numbers.2.weight",
            "style.numbers.2.bias",
            "style.label.weight",
            "style.label.bias",
        ]
    );
    assert_eq!(plain.len() + added.len(), styled.len());
}

#[test]
fn guidance_of_audio_and_style_is_composed() {
    let device = Device::flex();
    let network = both(&device);
    let cond = condition(4, Some(styles(&device)), &device);
    let null = network.null_cond(&cond);
    let unstyled = network.null_style(&cond).expect("a style");
    let x = normal(0, [1, 25, TIME], &device).repeat_dim(0, 4);
    let time = Time::of(&[500; 4]);
    let scales = GuidanceScales::new(2.5, Some(4.0));
    let found = guided(&network, x, &time, &cond, scales);
    let [nothing, audio, all] = [&null, &unstyled, &cond].map(|cond| predicted(&network, cond));
    let expected = nothing.clone() + (audio.clone() - nothing) * 2.5 + (all - audio) * 4.0;
    let error = largest(found - expected);
    assert!(error < 1e-5, "{error}");
}

#[test]
fn dropped_styles_train_the_null_style_and_others_the_rest() {
    let device = Device::flex().autodiff();
    let network = both(&device);
    let names: Vec<String> = parameters::infos(&network)
        .into_iter()
        .map(|info| info.name)
        .collect();
    let gradients = |style: StyleCondition| -> Vec<(String, Vec<f32>)> {
        let batch = 4;
        let output = predicted(&network, &condition(batch, Some(style), &device));
        let mut tracked = output.square().mean().backward();
        let gradients = kinegrad_models::gradients(&network, &mut tracked);
        names.clone().into_iter().zip(gradients).collect()
    };
    let of = |gradients: &[(String, Vec<f32>)], name: &str| -> Vec<f32> {
        let found = gradients.iter().find(|(known, _)| known == name);
        found.expect("a parameter").1.clone()
    };
    let is_zero = |values: &[f32]| values.iter().all(|&value| value == 0.0);
    // If all styles are dropped, only biases learn the null style.
    let dropped = gradients(styles(&device).null());
    assert!(is_zero(&of(&dropped, "style.label.weight")));
    assert!(is_zero(&of(&dropped, "style.numbers.0.weight")));
    for null in [
        "style.label.bias",
        "style.numbers.0.bias",
        "style.numbers.2.bias",
    ] {
        assert!(!is_zero(&of(&dropped, null)), "{null}");
    }
    // The columns of the two used labels have gradients.
    let labels = of(&gradients(styles(&device)), "style.label.weight");
    for (label, trained) in [true, false, true].into_iter().enumerate() {
        let column: Vec<f32> = labels.iter().skip(label).step_by(3).copied().collect();
        assert_eq!(!is_zero(&column), trained, "label {label}");
    }
}

#[test]
fn adapters_reach_the_style_and_merge() {
    let device = Device::flex();
    let conditioning = kinegrad_models::LoraConfig {
        targets: vec![kinegrad_models::LoraTarget::Conditioning],
        ..Default::default()
    };
    let init = Initializer::new(5, &device);
    let adapted = both(&device)
        .with_adapters(&conditioning, &init)
        .expect("adapters");
    let infos = parameters::infos(&adapted);
    let carries = |layer: &str| infos.iter().any(|info| info.name.starts_with(layer));
    for layer in [
        "style.numbers.0.lora",
        "style.numbers.2.lora",
        "style.label.lora",
    ] {
        assert!(carries(layer), "{layer}");
    }
    // Adapters with an effect.
    let values = parameters::export(&adapted)
        .into_iter()
        .map(|mut parameter| {
            if parameter.info.name.contains("lora") {
                let key = Key::new(1, Purpose::Init).named(&parameter.info.name);
                let values = key.normals(parameter.values.len());
                parameter.values = values.into_iter().map(|v| 0.2 * v).collect();
            }
            parameter.values
        });
    let adapted = parameters::replace(adapted.clone(), values.collect());
    let cond = condition(4, Some(styles(&device)), &device);
    let with = predicted(&adapted, &cond);
    assert!(largest(with.clone() - predicted(&both(&device), &cond)) > 1e-3);
    let merged = adapted.merge_adapters();
    assert_eq!(
        parameters::infos(&merged),
        parameters::infos(&both(&device))
    );
    assert!(largest(predicted(&merged, &cond) - with) < 1e-4);
}

#[test]
fn old_configs_have_no_style() {
    let entries = MapDeserializer::<_, ValueError>::new([("num_heads", 4usize)].into_iter());
    let config = UNet1dConfig::deserialize(entries).expect("a known key");
    assert_eq!(config.style, StyleConditioning::None);
    assert!(config.style_labels.is_empty());
}

#[test]
fn labels_without_their_use_and_repeated_ones_are_refused() {
    let refused = |style, labels: &[&str]| {
        let error = config(style, labels).validate().expect_err("refused");
        let text = error.to_string();
        assert!(text.contains("model.style_labels"), "{text}");
    };
    refused(StyleConditioning::Numbers, &["waltz"]);
    refused(StyleConditioning::Label, &["waltz", "waltz"]);
    refused(StyleConditioning::Both, &["waltz", ""]);
    config(StyleConditioning::Label, &[])
        .validate()
        .expect("filled in later");
}
