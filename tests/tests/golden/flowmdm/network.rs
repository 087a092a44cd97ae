//! The network, forward and backward, for one text and for several.

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_bpe_transformer::network::{BlendedTransformer, Composed, Pass, TextSegments};
use kinegrad_diffusion::{Denoiser as _, Time, guided};
use kinegrad_tests::golden::{Golden, GoldenTensors as _, ReferenceTensors as _, values};
use kinegrad_tests::stages::Noted;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_tests::{gradients, trials};

use super::{GRADIENT, STAGE, compare_stages, counts, flags, motion, motions, network, switch};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_blended_single_text("flowmdm/denoiser_single.safetensors"),
        golden_blended_several_texts("flowmdm/denoiser_multi.safetensors"),
    ]
}

/// One forward pass with gradients of a case of a denoiser file.
struct Case<'a> {
    golden: &'a Golden,
    network: &'a BlendedTransformer,
    name: &'a str,
    segments: &'a TextSegments,
    is_relative: Vec<bool>,
    time: Vec<Time>,
    /// For each text, true if it is dropped.
    dropped: Vec<bool>,
}

impl Case<'_> {
    fn run(&self, text: &str, loss_weights: &Tensor<3>, device: &Device) {
        let golden = self.golden;
        let x = golden.get("in.x").flat().tensor::<3>(device).require_grad();
        let stored = golden.get(text);
        let channels = *stored.shape.last().expect("text features");
        let texts: Tensor<2> = Tensor::from_data(
            TensorData::new(stored.f32s(), [stored.values.len() / channels, channels]),
            device,
        )
        .require_grad();
        let kept: Vec<f32> = self
            .dropped
            .iter()
            .map(|dropped| f32::from(u8::from(!dropped)))
            .collect();
        let count = kept.len();
        let kept = Tensor::<2>::from_data(TensorData::new(kept, [count, 1]), device);
        let pass = Pass {
            segments: self.segments,
            is_relative: &self.is_relative,
            dropout: None,
            path: None,
            path_mask: None,
        };
        let mut stages = Noted::default();
        let told = texts.clone() * kept;
        let y = self
            .network
            .forward_stages(x.clone(), &self.time, told, pass, &mut stages);
        let name = self.name;
        compare_stages(golden, &stages, &format!("out.{name}."));
        golden
            .get(&format!("out.{name}.y"))
            .flat()
            .assert_within(name, y.clone(), STAGE, 0.0);
        let uncond = format!("out.{name}.y_uncond");
        if golden.has(&uncond) {
            let without = self
                .network
                .forward(x.clone(), &self.time, texts.zeros_like(), pass);
            golden
                .get(&uncond)
                .flat()
                .assert_within(&uncond, without, STAGE, 0.0);
        }
        let loss = (y * loss_weights.clone()).sum();
        golden
            .get(&format!("out.{name}.loss"))
            .assert_within("loss", loss.clone(), STAGE, STAGE);
        let mut found = loss.backward();
        let mut inputs = vec![("in.x", values(x.grad(&found).expect("part of the loss")))];
        if golden.has(&format!("grad.{name}.in.text_features")) {
            inputs.push((
                "in.text_features",
                values(texts.grad(&found).expect("part too")),
            ));
        }
        let computed = kinegrad_models::gradients(self.network, &mut found);
        for (input, gradient) in inputs {
            let stored = golden.get(&format!("grad.{name}.{input}"));
            stored.assert_close_f32(input, &gradient, GRADIENT);
        }
        let prefix = format!("grad.{name}.model.");
        gradients::compare_under(golden, self.network, &computed, &prefix, GRADIENT);
    }
}

/// The loss weights, zero in padding.
fn loss_weights(golden: &Golden, device: &Device) -> Tensor<3> {
    let mask = golden.get("in.mask").flat();
    let [batch, 1, time] = mask.shape[..] else {
        panic!("{:?}", mask.shape)
    };
    let mask = Tensor::<3>::from_data(TensorData::new(mask.f32s(), [batch, 1, time]), device);
    motions(golden, "in.loss_weights", device) * mask
}

fn golden_blended_single_text(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = TextSegments::single(counts(&golden, "in.lengths"));
    let switch = switch(&golden);
    let weights = loss_weights(&golden, &device);
    let plain = network.valid();
    let at = |name: &str| Time::of(&golden.get(name).indices());
    for name in ["absolute", "relative"] {
        let time = at(&format!("in.{name}.t"));
        let is_relative: Vec<bool> = time
            .iter()
            .map(|time| switch.is_relative(time.timestep()))
            .collect();
        assert_eq!(is_relative, [name == "relative"; 2]);
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            segments: &script,
            is_relative,
            time: time.clone(),
            dropped: vec![false; 2],
        };
        case.run("in.text_features", &weights, &device);
        let composed = Composed {
            network: &plain,
            path: None,
            path_guidance_scale: 1.0,
            segments: script.clone(),
            switch,
        };
        let device = Device::flex();
        let text = golden
            .tensor::<2>("in.text_features", &device)
            .unsqueeze_dim(2);
        let scale = golden.get("in.guidance").scalar();
        let x = motions(&golden, "in.x", &device);
        let mixed = guided(&composed, x, &time, &text, scale);
        let name = format!("out.{name}.y_cfg");
        golden
            .get(&name)
            .flat()
            .assert_within(&name, mixed, 3e-3, 0.0);
    }
    // The last absolute step and the first relative one.
    let device = Device::flex();
    let text = golden
        .tensor::<2>("in.text_features", &device)
        .unsqueeze_dim(2);
    let composed = Composed {
        network: &plain,
        path: None,
        path_guidance_scale: 1.0,
        segments: script,
        switch,
    };
    for (index, t) in golden.get("in.switch.t").indices().into_iter().enumerate() {
        let x = motions(&golden, "in.x", &device);
        let y = composed.predict(x, &Time::of(&[t; 2]), &text);
        let expected = golden.get("out.switch.y").part(index).flat();
        expected.assert_within("switch", y, STAGE, 0.0);
    }
}

/// The segments of a file with `in.lengths0` and `in.lengths1`; texts have the shape `[segments,
/// batch, width]`.
pub fn two_motions(golden: &Golden) -> TextSegments {
    let both = ["in.lengths0", "in.lengths1"].map(|name| counts(golden, name));
    TextSegments::new([motion(&both[0], 0, 2), motion(&both[1], 1, 2)])
}

fn golden_blended_several_texts(golden: Golden) {
    let device = Device::flex().autodiff();
    let network = network(&golden, &device);
    let script = two_motions(&golden);
    let weights = loss_weights(&golden, &device);
    let switch = switch(&golden);
    let texts: usize = golden.get("in.text_features").shape[..2].iter().product();
    let at = |name: &str| Time::of(&golden.get(name).indices());
    for name in ["absolute", "relative"] {
        let time = at(&format!("in.{name}.t"));
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            segments: &script,
            is_relative: time
                .iter()
                .map(|time| switch.is_relative(time.timestep()))
                .collect(),
            time,
            dropped: vec![false; texts],
        };
        case.run("in.text_features", &weights, &device);
    }
    for name in ["mixed", "mixed_swapped"] {
        let case = Case {
            golden: &golden,
            network: &network,
            name,
            segments: &script,
            is_relative: flags(&golden, &format!("in.{name}.is_relative")),
            time: at("in.train.t"),
            dropped: flags(&golden, "in.train.text_drop"),
        };
        case.run("in.text_features", &weights, &device);
    }
}
