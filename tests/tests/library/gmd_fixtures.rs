//! Networks against numbers made with PyTorch: the transformer, and imported checkpoints
//! (`data_fixtures/gmd/README.md`).

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use kinegrad_data::write_values;
use kinegrad_diffusion::Time;
use kinegrad_gmd::network::Backbone;
use kinegrad_gmd::network::TextDenoiser;
use kinegrad_gmd::network::transformer::EncoderConfig;
use kinegrad_gmd::{Gmd, TrainedClips};
use kinegrad_models::Initializer;
use kinegrad_models::parameters;
use kinegrad_tests::golden::{Golden, GoldenTensors, ReferenceTensors, workspace};
use kinegrad_tests::weights;
use kinegrad_train::System;
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::import::ImportRequest;

const OUTPUT: f64 = 2e-5;
const GRADIENT: f64 = 1e-4;

fn fixture(name: &str) -> Golden {
    Golden::read(&workspace().join("data_fixtures/gmd").join(name))
}

fn answer(network: &TextDenoiser, golden: &Golden, device: &Device, told: bool) -> Tensor<3> {
    let text = golden
        .tensor::<2>("in.text_features", device)
        .unsqueeze_dim(2);
    let text: Tensor<3> = if told { text } else { text.zeros_like() };
    network.forward(
        golden.tensor("in.x", device),
        &Time::of(&golden.get("in.t").indices()),
        text,
    )
}

#[test]
fn the_transformer_is_that_of_pytorch() {
    let golden = fixture("mdm_transformer_tiny.safetensors");
    let device = Device::flex().autodiff();
    let config: serde_json::Value =
        serde_json::from_str(golden.metadata("config")).expect("the sizes");
    let width = golden.get("model.embed_text.weight").shape[0];
    let inner = golden
        .get("model.seqTransEncoder.layers.0.linear1.weight")
        .shape[0];
    let layers = (0..).take_while(|layer| {
        golden.has(&format!(
            "model.seqTransEncoder.layers.{layer}.linear1.weight"
        ))
    });
    let heads = ["num_heads", "heads", "nhead"]
        .iter()
        .find_map(|key| config[*key].as_u64())
        .expect("the number of heads");
    let config = EncoderConfig {
        latent_dim: width,
        num_layers: layers.count(),
        num_heads: heads as usize,
        ff_size: inner,
        dropout: 0.0,
        ..EncoderConfig::mdm()
    };
    let channels = golden.get("in.x").shape[1];
    let (backbone, init) = (
        Backbone::MdmTransformer(config),
        Initializer::new(0, &device),
    );
    let network = TextDenoiser::new(&backbone, channels, &init).expect("a network");
    let network = parameters::load(network, weights(&golden, "model.")).expect("the weights fit");
    let x = golden.tensor::<3>("in.x", &device).require_grad();
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    let y = network.forward(x.clone(), &Time::of(&golden.get("in.t").indices()), text);
    golden
        .get("out.y")
        .assert_within("y", y.clone(), OUTPUT, 0.0);
    golden.get("out.y_uncond").assert_within(
        "y without text",
        answer(&network, &golden, &device, false),
        OUTPUT,
        0.0,
    );
    let mut gradients = (y.clone() * y).mean().backward();
    let dx = x.grad(&gradients).expect("part of the loss");
    golden
        .get("grad.in.x")
        .assert_close_tensor("dx", dx, GRADIENT);
    let infos = parameters::infos(&network);
    let gradients = kinegrad_models::gradients(&network, &mut gradients);
    let mut compared = 0;
    for (info, gradient) in infos.iter().zip(&gradients) {
        let name = format!("grad.model.{}", info.name);
        if golden.has(&name) {
            golden
                .get(&name)
                .assert_close_f32(&name, gradient, GRADIENT);
            compared += 1;
        }
    }
    assert!(compared > 8, "{compared} weights' gradients");
}

/// The network of a published file, imported and read back.
fn imported(
    name: &str,
    architecture: &str,
    padded_frames: Option<usize>,
    last: bool,
    device: &Device,
) -> TextDenoiser {
    let folder = tempfile::tempdir().expect("a folder");
    let [mean, std] = ["m.npy", "s.npy"].map(|name| {
        let path = folder.path().join(name);
        write_values(&path, &[263], &[1.0; 263]).expect("a file");
        path
    });
    let run = Gmd
        .import(&ImportRequest {
            overrides: Vec::new(),
            weights: workspace().join("data_fixtures/gmd").join(name),
            architecture: architecture.into(),
            mean: Some(mean),
            std: Some(std),
            projection: None,
            padded_frames,
            last,
            out: folder.path().join("run"),
        })
        .expect("weights that fit");
    let gmd: &dyn System = &Gmd;
    let saved = SavedCheckpoint::read(&run.path).and_then(|saved| gmd.read_tables(saved));
    let saved = saved.expect("a checkpoint");
    let trained = TrainedClips::load(&saved, Weights::Ema, device).expect("weights");
    trained.model.valid()
}

#[test]
fn imported_checkpoints_answer_as_in_pytorch() {
    let device = Device::flex();
    let tracked = device.clone().autodiff();
    for (file, last, told, name) in [
        ("checkpoint_tiny", false, true, "out.y"),
        ("checkpoint_tiny", false, false, "out.y_uncond"),
        ("checkpoint_tiny", true, true, "out.y_model"),
        ("checkpoint_bare", false, true, "out.y"),
        ("checkpoint_bare", false, false, "out.y_uncond"),
        ("checkpoint_mdm", false, true, "out.y"),
        ("checkpoint_mdm", false, false, "out.y_uncond"),
    ] {
        let golden = fixture(&format!("{file}.safetensors"));
        let config: serde_json::Value =
            serde_json::from_str(golden.metadata("config")).expect("the sizes");
        let padded = config["padded_frames"].as_u64().expect("a length") as usize;
        let (architecture, padded) = match file {
            "checkpoint_mdm" => ("mdm", None),
            _ => ("gmd_trajectory", Some(padded)),
        };
        let network = imported(&format!("{file}.pt"), architecture, padded, last, &tracked);
        let y = answer(&network, &golden, &device, told);
        golden
            .get(name)
            .assert_within(&format!("{file} {name}"), y, OUTPUT, 0.0);
    }
}
