use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_diffusion::Time;
use kinegrad_models::parameters;
use kinegrad_random::{Key, Purpose};

use super::*;

const CHANNELS: usize = 5;
const FRAMES: usize = 14;

fn random(shape: [usize; 3], stream: u64) -> Tensor<3> {
    let values = Key::new(stream, Purpose::Noise).normals(shape.iter().product());
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn config(path: bool) -> BlendedConfig {
    BlendedConfig {
        latent_dim: 24,
        num_layers: 2,
        num_heads: 2,
        ff_size: 30,
        horizon: 4,
        dropout: 0.1,
        path,
        path_tokens: PathTokens::Added,
    }
}

fn network() -> BlendedTransformer {
    let init = Initializer::new(3, &Device::flex());
    config(false).init(CHANNELS, 7, &init).expect("a network")
}

/// The network with a path embedding. The last weights are random, or zero as in a new network.
fn path_conditioned(is_random: bool) -> BlendedTransformer {
    let init = Initializer::new(3, &Device::flex());
    let network = config(true).init(CHANNELS, 7, &init).expect("a network");
    let mut values = parameters::export(&network);
    for parameter in values.iter_mut().filter(|_| is_random) {
        if parameter.info.name == "embed_path.2.weight" {
            let key = Key::new(9, Purpose::Noise);
            parameter.values = key.normals(parameter.values.len());
        }
    }
    parameters::load(network, values).expect("its own weights")
}

fn two() -> TextSegments {
    let segment = |text, frames| Segment { text, frames };
    TextSegments::new([
        vec![segment(0, 5), segment(1, 6)],
        vec![segment(2, 3), segment(1, 4), segment(0, 7)],
    ])
}

fn answer(
    x: Tensor<3>,
    texts: Tensor<2>,
    segments: &TextSegments,
    relative: [bool; 2],
) -> Tensor<3> {
    let pass = Pass {
        segments,
        is_relative: &relative,
        dropout: None,
        path: None,
        path_mask: None,
    };
    network().forward(x, &[Time(30.0), Time(700.0)], texts, pass)
}

/// Largest difference in each frame of each motion.
fn apart(a: &Tensor<3>, b: &Tensor<3>) -> Vec<Vec<f32>> {
    let difference = (a.clone() - b.clone()).abs().max_dim(1);
    let values = difference.try_into_vec_as::<f32>().expect("float32");
    values.chunks(FRAMES).map(<[f32]>::to_vec).collect()
}

fn texts(stream: u64) -> Tensor<2> {
    random([3, 7, 1], stream).squeeze_dim(2)
}

#[test]
fn the_published_sizes_have_the_published_number_of_parameters() {
    let init = Initializer::new(0, &Device::flex());
    let count = |config: BlendedConfig, channels| {
        parameters::count(&config.init(channels, 512, &init).expect("a network"))
    };
    assert_eq!(count(BlendedConfig::flowmdm(), 263), 18_394_376);
    assert_eq!(count(BlendedConfig::flowmdm_babel(), 135), 18_263_176);
}

#[test]
fn a_text_reaches_its_own_frames_and_across_the_border_in_relative_mode_alone() {
    let (x, segments) = (random([2, CHANNELS, FRAMES], 1), two());
    let rows = texts(2);
    let other = {
        // Text 0 is the first text of the first motion and the last text of the second motion.
        let zeros = Tensor::zeros([1, 7], &Device::flex());
        Tensor::cat(vec![zeros, rows.clone().narrow(0, 1, 2)], 0)
    };
    for (relative, reach) in [([false; 2], 0), ([true; 2], 8)] {
        let a = answer(x.clone(), rows.clone(), &segments, relative);
        let b = answer(x.clone(), other.clone(), &segments, relative);
        let apart = apart(&a, &b);
        for (t, found) in apart[0].iter().enumerate().take(11) {
            // Keys do not depend on the text, so a text reaches one horizon in two layers: the sums
            // of the first layer.
            let has_text = t < 5;
            let near = t < 5 + reach;
            assert!(!has_text || *found > 1e-4, "{relative:?} {t}");
            assert!(near || *found == 0.0, "{relative:?} {t}");
        }
        assert!(reach == 0 || apart[0][5] > 1e-6);
        assert!(apart[1][13] > 1e-4 && (reach > 0 || apart[1][6] == 0.0));
    }
}

#[test]
fn modes_and_order_of_texts_matter_and_padding_does_not() {
    let (x, segments, rows) = (random([2, CHANNELS, FRAMES], 1), two(), texts(2));
    let whole = answer(x.clone(), rows.clone(), &segments, [false, true]);
    let swapped = answer(x.clone(), rows.clone(), &segments, [true, false]);
    let differs = apart(&whole, &swapped);
    assert!(differs.iter().all(|motion| motion[0] > 1e-4));
    // Noise in the first motion's padding, frames 11 to 13.
    let noise = random([2, CHANNELS, FRAMES], 9);
    let behind = Tensor::cat(vec![x.clone().narrow(2, 0, 11), noise.narrow(2, 11, 3)], 2);
    let padded = Tensor::cat(vec![behind.narrow(0, 0, 1), x.clone().narrow(0, 1, 1)], 0);
    let other = apart(
        &whole,
        &answer(padded, rows.clone(), &segments, [false, true]),
    );
    assert!(other[0][..11].iter().all(|difference| *difference == 0.0));
    // The same texts in another order.
    let segment = |text, frames| Segment { text, frames };
    let segments = TextSegments::new([
        vec![segment(1, 5), segment(0, 6)],
        vec![segment(2, 3), segment(1, 4), segment(0, 7)],
    ]);
    let turned = apart(&whole, &answer(x, rows, &segments, [false, true]));
    assert!(turned[0][..11].iter().all(|difference| *difference > 1e-5));
    assert!(turned[1].iter().all(|difference| *difference == 0.0));
}

#[test]
fn a_long_motion_is_what_its_parts_in_reach_make_of_it() {
    // In relative mode, no frame knows its index: cutting distant earlier frames changes nothing.
    let single = |frames| TextSegments::single([frames]);
    let x = random([1, CHANNELS, 60], 4);
    let rows = texts(2).narrow(0, 0, 1);
    let run = |x: Tensor<3>, frames| {
        let segments = single(frames);
        let pass = Pass {
            segments: &segments,
            is_relative: &[true],
            dropout: None,
            path: None,
            path_mask: None,
        };
        network().forward(x, &[Time(5.0)], rows.clone(), pass)
    };
    let whole = run(x.clone(), 60);
    let part = run(x.narrow(2, 20, 40), 40);
    let difference = (whole.narrow(2, 30, 25) - part.narrow(2, 10, 25))
        .abs()
        .max();
    assert!(difference.into_scalar::<f32>() < 1e-5);
}

#[test]
fn an_untrained_path_changes_no_bit_and_a_trained_one_the_frames_in_reach() {
    let (x, segments, texts) = (random([2, CHANNELS, FRAMES], 1), two(), texts(2));
    let run = |network: &BlendedTransformer, path: Option<&Tensor<3>>| {
        let pass = Pass {
            segments: &segments,
            is_relative: &[true, true],
            dropout: None,
            path,
            path_mask: None,
        };
        network.forward(x.clone(), &[Time(30.0), Time(700.0)], texts.clone(), pass)
    };
    let path = random([2, PATH_CHANNELS, FRAMES], 5);
    let base = run(&network(), None).into_data();
    assert_eq!(run(&path_conditioned(false), Some(&path)).into_data(), base);
    let trained = path_conditioned(true);
    let whole = run(&trained, Some(&path));
    assert_ne!(whole.clone().into_data(), base);
    assert_eq!(run(&trained, None).into_data(), base);
    // The motion with a masked path equals the motion without a path.
    let keep = Tensor::from_data(TensorData::new(vec![1.0f32, 0.0], [2, 1, 1]), &x.device());
    let pass = Pass {
        segments: &segments,
        is_relative: &[true, true],
        dropout: None,
        path: Some(&path),
        path_mask: Some(&keep),
    };
    let masked = trained.forward(x.clone(), &[Time(30.0), Time(700.0)], texts.clone(), pass);
    let part = |of: &Tensor<3>, motion: usize| of.clone().narrow(0, motion, 1).into_data();
    assert_eq!(part(&masked, 0), part(&whole, 0));
    assert_eq!(part(&masked, 1), part(&run(&trained, None), 1));
    // Another position in only the last frame affects frames of this motion within twice the
    // horizon.
    let last = path.clone().narrow(2, FRAMES - 1, 1);
    let other = Tensor::cat(vec![path.narrow(2, 0, FRAMES - 1), last + 1.0], 2);
    let other = Tensor::cat(
        vec![other.clone().narrow(0, 0, 1), other.narrow(0, 1, 1)],
        0,
    );
    let changed = apart(&whole, &run(&trained, Some(&other)));
    assert!(changed[1][FRAMES - 1] > 1e-5);
    let far = FRAMES - 1 - 2 * 4;
    assert!(
        changed[1][..far]
            .iter()
            .all(|difference| *difference == 0.0)
    );
}

/// A network with a path in its `tokens`; its maps of the path are random.
fn with_tokens(tokens: PathTokens) -> BlendedTransformer {
    let init = Initializer::new(3, &Device::flex());
    let config = BlendedConfig {
        path_tokens: tokens,
        ..config(true)
    };
    let network = config.init(CHANNELS, 7, &init).expect("a network");
    let mut values = parameters::export(&network);
    for (index, parameter) in (0..).zip(&mut values) {
        if parameter.info.name.ends_with("path_query.weight") {
            let key = Key::new(20 + index, Purpose::Noise);
            parameter.values = key.normals(parameter.values.len());
        }
    }
    parameters::load(network, values).expect("its own weights")
}

#[test]
fn tokens_beside_the_condition_or_in_rows_reach_the_frames_near_them() {
    let (x, segments, texts) = (random([2, CHANNELS, FRAMES], 1), two(), texts(2));
    let path = random([2, PATH_CHANNELS, FRAMES], 5);
    let keep = |values: [f32; 2]| {
        Tensor::<3>::from_data(TensorData::new(values.to_vec(), [2, 1, 1]), &x.device())
    };
    for tokens in [PathTokens::Concatenated, PathTokens::Rows] {
        let trained = with_tokens(tokens);
        for relative in [[true, true], [false, true]] {
            let run = |network: &BlendedTransformer, path, path_mask| {
                let pass = Pass {
                    segments: &segments,
                    is_relative: &relative,
                    dropout: None,
                    path,
                    path_mask,
                };
                network.forward(x.clone(), &[Time(30.0), Time(700.0)], texts.clone(), pass)
            };
            let base = run(&network(), None, None);
            assert_eq!(
                run(&trained, None, None).into_data(),
                base.into_data(),
                "{tokens:?}"
            );
            let base = run(&trained, None, None);
            let whole = run(&trained, Some(&path), None);
            assert_eq!(whole.dims(), [2, CHANNELS, FRAMES]);
            // Every frame of the text's segments reads its own token.
            let moved = apart(&whole, &base);
            assert!(
                moved[1].iter().all(|difference| *difference > 1e-6),
                "{tokens:?}"
            );
            // A motion whose path is masked is the motion without a path.
            let mask = keep([1.0, 0.0]);
            let masked = run(&trained, Some(&path), Some(&mask));
            let first = apart(&masked, &whole)[0].clone();
            assert!(
                first.iter().all(|difference| *difference == 0.0),
                "{tokens:?}"
            );
            let second = apart(&masked, &base)[1].clone();
            assert!(
                second.iter().all(|difference| *difference < 1e-5),
                "{tokens:?}"
            );
            // The last token reaches its own frame, and others within the horizons of the layers.
            let last = path.clone().narrow(2, FRAMES - 1, 1);
            let other = Tensor::cat(vec![path.clone().narrow(2, 0, FRAMES - 1), last + 1.0], 2);
            let changed = apart(&whole, &run(&trained, Some(&other), None));
            assert!(changed[1][FRAMES - 1] > 1e-6, "{tokens:?}");
            let far = FRAMES - 1 - 2 * 4;
            assert!(
                changed[1][..far]
                    .iter()
                    .all(|difference| *difference == 0.0),
                "{tokens:?}"
            );
            // Padding of the first motion, frames 11 to 13, has no reader.
            assert!(
                changed[0][..11].iter().all(|difference| *difference == 0.0),
                "{tokens:?}"
            );
        }
    }
    // An untrained concatenated path changes nothing.
    let init = Initializer::new(3, &Device::flex());
    let config = BlendedConfig {
        path_tokens: PathTokens::Concatenated,
        ..config(true)
    };
    let untrained = config.init(CHANNELS, 7, &init).expect("a network");
    let pass = |path| Pass {
        segments: &segments,
        is_relative: &[true, true],
        dropout: None,
        path,
        path_mask: None,
    };
    let time = [Time(30.0), Time(700.0)];
    let [with, without] = [Some(&path), None].map(|path| {
        untrained
            .forward(x.clone(), &time, texts.clone(), pass(path))
            .into_data()
    });
    assert_eq!(with, without);
}

#[test]
fn guidance_over_the_path_extrapolates_from_the_motion_without_it() {
    let network = path_conditioned(true);
    let (x, texts) = (random([2, CHANNELS, FRAMES], 1), texts(2));
    let path = random([2, PATH_CHANNELS, FRAMES], 5);
    let at = |path: Option<Tensor<3>>, path_guidance_scale| {
        let composed = Composed {
            network: &network,
            segments: two(),
            switch: Switch {
                bpe_denoising_step: 60,
                num_train_timesteps: 1000,
            },
            path,
            path_guidance_scale,
        };
        let cond = texts.clone().unsqueeze_dim(2);
        composed.predict(x.clone(), &[Time(30.0), Time(700.0)], &cond)
    };
    let along = at(Some(path.clone()), 1.0);
    let without = at(None, 1.0);
    let expected = without.clone() + (along.clone() - without.clone()) * 2.5;
    let found = at(Some(path.clone()), 2.5);
    assert_eq!(found.clone().into_data(), expected.into_data());
    assert_ne!(found.into_data(), along.into_data());
    assert_eq!(at(Some(path), 0.0).into_data(), without.into_data());
}

#[test]
fn adapting_trains_what_reads_the_path_and_the_last_layers() {
    let trained_of = |path_tokens, last_layers: usize| -> Vec<String> {
        // On a device that tracks gradients, with uninitialized parameters.
        let init = Initializer::new(3, &Device::flex().autodiff());
        let config = BlendedConfig {
            path_tokens,
            ..config(true)
        };
        let network = config.init(CHANNELS, 7, &init).expect("a network");
        let network = network.adapting(last_layers);
        let infos = parameters::infos(&network).into_iter();
        let trained = infos.zip(parameters::trainable(&network));
        let trained = trained.inspect(|(info, is)| {
            assert_eq!(
                network.adapts(&info.name, last_layers),
                *is,
                "{}",
                info.name
            );
        });
        let trained = trained.filter(|(_, is)| *is).map(|(info, _)| info.name);
        trained.collect()
    };
    // The four of the embedding, and the queries' map of each layer.
    assert_eq!(trained_of(PathTokens::Concatenated, 0).len(), 6);
    let trained = |last_layers| trained_of(PathTokens::Added, last_layers);
    assert!(
        trained(0)
            .iter()
            .all(|name| name.starts_with("embed_path."))
    );
    assert_eq!(trained(0).len(), 4);
    let last = trained(1);
    assert!(last.len() > 4);
    let of_last = |name: &&String| {
        ["2.", "3."]
            .iter()
            .any(|index| name.starts_with(&format!("seqTransEncoder.attn_layers.layers.{index}")))
    };
    assert_eq!(last.iter().filter(of_last).count(), last.len() - 4);
}

#[test]
fn training_leaves_sub_layers_out_by_its_key() {
    let (x, segments, rows) = (random([2, CHANNELS, FRAMES], 1), two(), texts(2));
    let run = |seed: u64| {
        let pass = Pass {
            segments: &segments,
            is_relative: &[true, false],
            dropout: Some(Key::new(seed, Purpose::Dropout)),
            path: None,
            path_mask: None,
        };
        network()
            .forward(x.clone(), &[Time(3.0); 2], rows.clone(), pass)
            .into_data()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
    let network = network();
    let left = (0..400).map(|seed| network.left_out(Some(Key::new(seed, Purpose::Dropout)), 4));
    let left: Vec<bool> = left.flatten().collect();
    let share = left.iter().filter(|left| **left).count() as f64 / left.len() as f64;
    assert!((share - 0.1).abs() < 0.03, "{share}");
}

#[test]
fn the_switch_counts_as_published() {
    let relative = |k, t| {
        let switch = Switch {
            bpe_denoising_step: k,
            num_train_timesteps: 1000,
        };
        switch.is_relative(t)
    };
    assert!(!relative(-1, 0) && relative(0, 999) && relative(1, 999));
    assert!(!relative(60, 941) && relative(60, 940));
    assert!(!relative(1000, 1) && relative(1000, 0));
}
