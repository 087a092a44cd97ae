//! The text-motion evaluator against the same networks in PyTorch, with small random weights.
//!
//! `data_fixtures/gmd/README.md` describes the file.

use burn::tensor::Device;
use kinegrad_data::humanml::{Caption, Clip, ClipLabels};
use kinegrad_golden::{Golden, bound, differences, workspace};
use kinegrad_models::Initializer;
use kinegrad_models::parameters::{self, HostParameter};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{FeatureLayout, Features, Root};
use kinegrad_motion::metrics::text_motion::{TextMotionReport, Token, WordVectors};
use kinegrad_tests::weights;
use kinegrad_text_motion::TextMotion;
use kinegrad_text_motion::network::{PARTS, TextMotionConfig, TextMotionEncoders};
use kinegrad_train::Error;
use kinegrad_train::clips::evaluator::TextMotionEvaluator as _;

/// Absolute, for embeddings and metrics.
const TOLERANCE: f64 = 1e-5;

/// The file of weights, inputs and outputs.
struct Fixture {
    file: Golden,
    config: serde_json::Value,
}

impl Fixture {
    fn open() -> Self {
        let path = workspace().join("data_fixtures/gmd/text_motion_tiny.safetensors");
        let file = Golden::read(&path);
        let config = serde_json::from_str(file.metadata("config")).expect("config is JSON");
        Self { file, config }
    }

    fn values(&self, name: &str) -> Vec<f32> {
        self.file.get(name).f32s()
    }

    fn wide(&self, name: &str) -> Vec<f64> {
        self.file.get(name).values
    }

    /// The rows of a tensor `[n, width]`.
    fn rows(&self, name: &str) -> Vec<Vec<f64>> {
        let tensor = self.file.get(name);
        let rows = tensor.values.chunks_exact(tensor.shape[1]);
        rows.map(<[f64]>::to_vec).collect()
    }

    fn strings(&self, key: &str) -> Vec<String> {
        serde_json::from_value(self.config[key].clone()).expect("a list of strings")
    }

    fn weights(&self) -> Vec<HostParameter> {
        let part = |part: &str| {
            let mut weights = weights(&self.file, &format!("{part}."));
            for weight in &mut weights {
                weight.info.name = format!("{part}.{}", weight.info.name);
            }
            weights
        };
        PARTS.into_iter().flat_map(part).collect()
    }

    fn statistics(&self) -> Statistics {
        let (mean, std) = (self.wide("in.mean"), self.wide("in.std"));
        Statistics::new(mean, std, Some(Root::Relative)).expect("statistics")
    }

    fn evaluator(&self) -> TextMotion {
        let encoders = encoders(self.weights()).expect("weights fit");
        TextMotion::new(
            encoders,
            self.statistics(),
            self.vectors(),
            196,
            &Device::flex(),
        )
        .expect("parts of one evaluator")
    }

    fn clips(&self) -> Vec<Features> {
        let count = self.config["clips"].as_u64().expect("number of clips");
        let channels = self.statistics().channels();
        let layout = FeatureLayout::of_channels(channels).expect("a layout");
        (0..count)
            .map(|i| self.values(&format!("in.clip{i}")))
            .map(|values| Features::new(values, layout, Root::Relative).expect("features"))
            .collect()
    }

    fn vectors(&self) -> WordVectors {
        WordVectors::new(self.strings("words"), self.values("in.vectors")).expect("word vectors")
    }

    fn captions(&self) -> Vec<Vec<Token>> {
        let captions = self.strings("captions");
        captions.iter().map(|text| Token::parse_all(text)).collect()
    }
}

/// The encoders of these weights.
fn encoders(weights: Vec<HostParameter>) -> Result<TextMotionEncoders, kinegrad_models::Error> {
    let config = TextMotionConfig::of_weights(|name| {
        let weight = weights.iter().find(|weight| weight.info.name == name);
        Some(&weight?.info.shape)
    });
    parameters::load(config.init(&Initializer::new(0, &Device::flex())), weights)
}

/// Bounds the largest difference.
fn compare(what: &str, found: &[f64], reference: &[f64]) {
    let error = differences(what, found, reference).fold(0.0, f64::max);
    bound(&format!("text_motion_tiny {what}"), error, TOLERANCE);
}

fn slices<T>(lists: &[Vec<T>]) -> Vec<&[T]> {
    lists.iter().map(Vec::as_slice).collect()
}

#[test]
fn fixture_embeddings_of_clips_are_those_of_pytorch() {
    let fixture = Fixture::open();
    let clips = fixture.clips();
    let evaluator = fixture.evaluator();
    let found = evaluator
        .motion_embeddings(&clips.iter().collect::<Vec<_>>())
        .expect("clips are encoded");
    compare("motions", &found.concat(), &fixture.wide("out.motion"));
    // One by one, and many at once: only rounding differs.
    for (clip, together) in clips.iter().zip(&found) {
        let alone = evaluator.motion_embeddings(&[clip]).expect("one clip");
        compare("a motion alone", &alone[0], together);
    }
    let many: Vec<&Features> = clips.iter().cycle().take(70).collect();
    let many = evaluator.motion_embeddings(&many).expect("many clips");
    compare("the 69th motion", &many[68], &found[68 % found.len()]);
}

#[test]
fn fixture_embeddings_of_captions_are_those_of_pytorch() {
    let fixture = Fixture::open();
    let captions = fixture.captions();
    let found = fixture.evaluator().text_embeddings(&slices(&captions));
    compare("captions", &found.concat(), &fixture.wide("out.text"));
}

#[test]
fn fixture_metrics_are_those_of_pytorch() {
    let fixture = Fixture::open();
    let [texts, motions, real] = ["in.texts", "in.motions", "in.real"].map(|of| fixture.rows(of));
    let report = TextMotionReport::compute(&texts, &motions, &real, 0);
    let top = [
        report.r_precision_top1,
        report.r_precision_top2,
        report.r_precision_top3,
    ];
    let number = |value: Option<f64>| value.expect("can be computed");
    let expected = |name: &str| fixture.wide(&format!("out.{name}"));
    compare("R-precision", &top.map(number), &expected("r_precision"));
    let distance = [number(report.multimodal_distance)];
    compare("distance", &distance, &expected("multimodal_distance"));
    let frechet = [number(report.frechet_distance)];
    compare("FID", &frechet, &expected("frechet_distance"));
}

#[test]
fn pools_are_drawn_at_random() {
    let fixture = Fixture::open();
    let evaluator = fixture.evaluator();
    let (features, captions) = (fixture.clips(), fixture.strings("captions"));
    // Two kinds of clips, one after the other: in pools of neighbours all captions are equal, so
    // every motion matches every caption.
    let top = |of_caption: [usize; 2], seed| {
        let motions = [0, 1].map(|kind| vec![features[of_caption[kind]].clone(); 32]);
        let clips = [0, 1].map(|kind| {
            let clip = |number| Clip {
                id: format!("{kind}_{number}"),
                features: features[kind].clone(),
                captions: vec![Caption {
                    text: captions[kind].clone(),
                    tokens: Token::parse_all(&captions[kind]),
                    seconds: None,
                    embedding: None,
                }],
            };
            (0..32).map(clip).collect::<Vec<Clip>>()
        });
        let (motions, clips) = (motions.concat(), clips.concat());
        let clips: Vec<&Clip> = clips.iter().collect();
        let reports = evaluator.reports(&motions, &motions, &clips, &ClipLabels::new(), seed);
        let report = reports.expect("clips are encoded").sampled;
        report.r_precision_top1.expect("two pools")
    };
    for seed in 0..3 {
        let (one, other) = (top([0, 1], seed), top([1, 0], seed));
        assert!(one.min(other) < 1.0, "{one}, {other}");
    }
}

#[test]
fn an_absolute_root_is_read_as_a_relative_one() {
    let fixture = Fixture::open();
    let evaluator = fixture.evaluator();
    let clip = &fixture.clips()[0];
    let absolute = clip.to_absolute();
    let embedding = |clip: &Features| evaluator.motion_embeddings(&[clip]).expect("one clip");
    assert_eq!(embedding(&absolute), embedding(&absolute.to_relative()));
}

#[test]
fn weights_that_are_not_the_networks_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut HostParameter)| {
        let mut weights = Fixture::open().weights();
        weights.iter_mut().for_each(change);
        encoders(weights).unwrap_err().to_string()
    };
    let message = refused(&|weight| {
        weight.info.name = weight.info.name.replace("main.3.bias", "main.6.bias");
    });
    assert_eq!(
        message,
        "the weights do not fit: missing: `movement_encoder.main.3.bias` [5]; \
         not known: `movement_encoder.main.6.bias`"
    );
    let message = refused(&|weight| {
        if weight.info.name == "motion_encoder.input_emb.weight" {
            weight.info.shape = vec![7, 4];
        }
    });
    assert_eq!(
        message,
        "the weights do not fit: `motion_encoder.input_emb.weight` has shape [7, 4], [7, 5] needed"
    );
    // Settings that weights do not determine are as published.
    let message = refused(&|weight| {
        weight.info.name = weight.info.name.replace("text_encoder.hidden", "h");
    });
    for part in [
        "missing: `text_encoder.hidden` [2, 1, 512]",
        "not known: `h`",
    ] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let fixture = Fixture::open();
    let evaluator = |statistics, words| {
        let encoders = encoders(fixture.weights()).expect("weights fit");
        TextMotion::new(encoders, statistics, words, 196, &Device::flex())
    };
    let refused = |statistics, words| match evaluator(statistics, words) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("they belong together"),
    };
    let other = Statistics::new(vec![0.0; 263], vec![1.0; 263], Some(Root::Relative));
    assert_eq!(
        refused(other.expect("statistics"), fixture.vectors()),
        "a frame without contact flags has width 259, but `movement_encoder` needs 19"
    );
    let vectors = WordVectors::new(vec!["unk".into()], vec![0.5; 300]).expect("vectors");
    assert_eq!(
        refused(fixture.statistics(), vectors),
        "a word vector has width 300, but `text_encoder` needs 4"
    );
    let relative = fixture.statistics();
    let (mean, std) = (relative.mean, relative.std);
    let absolute = Statistics::new(mean, std, Some(Root::Absolute)).expect("statistics");
    let refused = evaluator(absolute, fixture.vectors());
    assert!(matches!(refused, Err(Error::Features(_))));
}

#[test]
fn clips_that_cannot_be_encoded_are_refused() {
    let fixture = Fixture::open();
    let evaluator = fixture.evaluator();
    let clips = fixture.clips();
    let short = clips[0].slice(0..3);
    let mut many = vec![&clips[0]; 40];
    many.push(&short);
    let refused = evaluator
        .motion_embeddings(&many)
        .expect_err("a short clip");
    assert_eq!(
        refused.to_string(),
        "clip 40 (counted from 0) has 3 frames, at least 4 needed"
    );
    let layout = FeatureLayout::of_joints(3).expect("a layout");
    let other = vec![0.0; 8 * layout.channels()];
    let other = Features::new(other, layout, Root::Relative).expect("features");
    let refused = evaluator.motion_embeddings(&[&other]);
    assert!(matches!(refused, Err(Error::Features(_))));
    let nothing = evaluator.motion_embeddings(&[]).expect("no clips");
    assert!(nothing.is_empty());
}
