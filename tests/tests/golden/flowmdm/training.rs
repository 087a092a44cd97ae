//! A step of training, and the names of the published weights.

use std::path::PathBuf;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{BlendedConfig, BlendedTransformer, Pass, TextSegments};
use kinegrad_diffusion::{PredictionType, Time};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, ReferenceTensors as _, compared};
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gradients, trials};
use kinegrad_train::config::OptimConfig;
use kinegrad_train::optim::{AdamW, Moments};

use super::super::gmd::bench::process;
use super::network::two_motions;
use super::{flags, motions, network};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_blended_training("flowmdm/training.safetensors"),
        golden_published_names("flowmdm/keys_humanml3d.csv"),
    ]
}

/// The mean over samples of the mean squared error over valid elements, `[batch]` first.
fn training_loss(x_start: &Tensor<3>, y: Tensor<3>, script: &TextSegments) -> Tensor<1> {
    let [_, channels, time] = y.dims();
    let device = y.device();
    let frames: Vec<usize> = script.frames().collect();
    let mask = frames.iter().flat_map(|&frames| {
        let weight = 1.0 / (channels * frames) as f32;
        (0..time).map(move |t| if t < frames { weight } else { 0.0 })
    });
    let data = TensorData::new(mask.collect::<Vec<f32>>(), [frames.len(), 1, time]);
    let squares = (x_start.clone() - y).square() * Tensor::<3>::from_data(data, &device);
    squares.sum_dims_squeeze::<1, _>(&[1, 2])
}

fn golden_blended_training(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = two_motions(&golden);
    let x_start = motions(&golden, "in.x0", &device);
    let timesteps = golden.get("in.t").indices();
    let noise = motions(&golden, "in.noise", &device);
    let x_t = process(PredictionType::Sample).add_noise(x_start.clone(), noise, &timesteps);
    golden
        .get("out.x_t")
        .flat()
        .assert_within("x_t", x_t.clone(), 5e-6, 0.0);
    let told = |name: &str, dropped: &str| -> Tensor<2> {
        let stored = golden.get(name);
        let width = *stored.shape.last().expect("text features");
        let dropped = flags(&golden, dropped);
        let kept = stored.f32s();
        let kept = kept.chunks(width).zip(dropped).flat_map(|(row, dropped)| {
            let factor = if dropped { 0.0 } else { 1.0 };
            row.iter().map(move |value| factor * value)
        });
        let kept: Vec<f32> = kept.collect();
        let rows = kept.len() / width;
        Tensor::from_data(TensorData::new(kept, [rows, width]), &device)
    };
    let is_relative = flags(&golden, "in.is_relative");
    let pass = Pass {
        segments: &script,
        is_relative: &is_relative,
        dropout: None,
        path: None,
        path_mask: None,
    };
    let time = Time::of(&timesteps);
    let y = network.forward(
        x_t.clone(),
        &time,
        told("in.text_features", "in.text_drop"),
        pass,
    );
    golden
        .get("out.pred")
        .flat()
        .assert_within("prediction", y.clone(), 4e-4, 0.0);
    let each = training_loss(&x_start, y, &script);
    golden
        .get("out.loss_per_element")
        .assert_close_tensor("loss of each", each.clone(), 1e-5);
    let loss = each.mean();
    golden
        .get("out.loss")
        .assert_close_tensor("loss", loss.clone(), 1e-5);
    let mut found = loss.backward();
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare_under(&golden, &network, &computed, "grad.model.", 2e-4);
    compare_step(&golden, &network, &computed);
    // One text for each.
    let single = TextSegments::single(script.frames());
    let pass = Pass {
        segments: &single,
        ..pass
    };
    let texts = told("in.single.text_features", "in.single.text_drop");
    let y = network.forward(x_t, &time, texts, pass);
    golden
        .get("out.single.pred")
        .flat()
        .assert_within("single", y.clone(), 4e-4, 0.0);
    let each = training_loss(&x_start, y, &single);
    golden
        .get("out.single.loss_per_element")
        .assert_close_tensor("loss of each", each.clone(), 1e-5);
    let mut found = each.mean().backward();
    let computed = kinegrad_models::gradients(&network, &mut found);
    gradients::compare_under(&golden, &network, &computed, "grad.single.model.", 2e-4);
}

/// One step of AdamW. Entries whose gradient is rounding noise are not compared.
fn compare_step(golden: &Golden, network: &BlendedTransformer, computed: &[Vec<f32>]) {
    let rate = golden.get("in.lr").scalar();
    let config = OptimConfig {
        learning_rate: rate,
        weight_decay: 0.0,
        ..OptimConfig::default()
    };
    let before = parameters::export(network);
    let mut adamw = AdamW::new(&config, 0);
    adamw.begin_step();
    let updated = golden.names_under("out.after_single_step.");
    for (index, parameter) in before.iter().enumerate() {
        let mut after = parameter.values.clone();
        let mut moments = Moments::zeros(after.len());
        let step = adamw.step(index, 1.0, rate);
        moments.update(step, &mut after, &computed[index], None);
        let name = &parameter.info.name;
        if !updated.contains(name) {
            continue;
        }
        let gradient = golden.get(&format!("grad.model.{name}")).values;
        let largest = gradient
            .iter()
            .fold(0.0f64, |most, value| most.max(value.abs()));
        let stored = golden.get(&format!("out.after_single_step.{name}")).values;
        let (mut found, mut expected) = (Vec::new(), Vec::new());
        for place in 0..after.len() {
            if gradient[place].abs() > 1e-3 * largest {
                let start = f64::from(parameter.values[place]);
                found.push((f64::from(after[place]) - start) / rate);
                expected.push((stored[place] - start) / rate);
            }
        }
        golden.compare_lists(&format!("step of {name}"), &found, &expected, 3e-2);
    }
}

/// Names, shapes and order of the published weights.
fn golden_published_names(path: PathBuf) {
    let text = std::fs::read_to_string(path).expect("readable");
    let rows = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').collect::<Vec<_>>());
    let published: Vec<(String, Vec<usize>)> = rows
        .filter(|row| row[3] == "parameter")
        .map(|row| {
            let shape = row[1].split('x').map(|size| size.parse().expect("a size"));
            (row[0].to_owned(), shape.collect())
        })
        .collect();
    let init = Initializer::new(0, &Device::flex());
    let network = BlendedConfig::flowmdm()
        .init(263, 512, &init)
        .expect("a network");
    let mut own: Vec<(String, Vec<usize>)> = parameters::infos(&network)
        .into_iter()
        .map(|info| (info.name, info.shape))
        .collect();
    let mut published = published;
    own.sort();
    published.sort();
    assert_eq!(own, published);
    compared(own.len());
}
