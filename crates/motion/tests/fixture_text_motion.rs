//! The text-motion evaluator against the same networks in PyTorch, with small random weights.
//!
//! `data_fixtures/gmd/README.md` says what the file holds and how it was made.

use kinegrad_golden::{Golden, bound, differences, workspace};
use kinegrad_motion::Statistics;
use kinegrad_motion::humanml::{FeatureLayout, Features, Root};
use kinegrad_motion::metrics::text_motion::{
    EvaluatorWeights, NamedArrays, TextMotionError, TextMotionEvaluator, TextMotionReport, Token,
    WordVectors,
};

/// Of embeddings and metrics, absolute.
const TOLERANCE: f64 = 1e-5;

/// The file of weights, inputs and answers.
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

    /// All tensors whose name begins with `prefix`, by the rest of the name.
    fn under(&self, prefix: &str) -> NamedArrays {
        let names = self.file.names_under(prefix).into_iter();
        let load = |name: String| {
            let tensor = self.file.get(&format!("{prefix}{name}"));
            let values = tensor.f32s();
            (name, (tensor.shape, values))
        };
        names.map(load).collect()
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

    fn weights(&self) -> EvaluatorWeights {
        EvaluatorWeights {
            movement_encoder: self.under("movement_encoder."),
            motion_encoder: self.under("motion_encoder."),
            text_encoder: self.under("text_encoder."),
        }
    }

    fn statistics(&self) -> Statistics {
        let (mean, std) = (self.wide("in.mean"), self.wide("in.std"));
        Statistics::new(mean, std, Some(Root::Relative)).expect("statistics")
    }

    fn evaluator(&self) -> TextMotionEvaluator {
        TextMotionEvaluator::new(&self.weights(), self.statistics()).expect("weights fit")
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
    assert_eq!(found[0].len(), evaluator.width());
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
    let found = fixture
        .evaluator()
        .text_embeddings(&slices(&captions), &fixture.vectors())
        .expect("captions are encoded");
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
fn an_absolute_root_is_read_as_a_relative_one() {
    let fixture = Fixture::open();
    let evaluator = fixture.evaluator();
    let clip = &fixture.clips()[0];
    let absolute = clip.to_absolute();
    let expected = evaluator.motion_embeddings(&[&absolute.to_relative()]);
    assert_eq!(evaluator.motion_embeddings(&[&absolute]), expected);
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let fixture = Fixture::open();
    let refused = |weights: &EvaluatorWeights| {
        let evaluator = TextMotionEvaluator::new(weights, fixture.statistics());
        evaluator.unwrap_err().to_string()
    };
    let mut weights = fixture.weights();
    weights.movement_encoder.remove("main.3.bias");
    let empty = (vec![1], vec![0.0]);
    weights.movement_encoder.insert("main.6.bias".into(), empty);
    assert_eq!(
        refused(&weights),
        "the weights of `movement_encoder` do not fit: `main.3.bias` is missing; `main.6.bias` is \
         not one of its arrays"
    );
    let mut weights = fixture.weights();
    std::mem::swap(&mut weights.motion_encoder, &mut weights.text_encoder);
    let message = refused(&weights);
    assert!(message.contains("`pos_emb.bias` is not"), "{message}");
    let mut weights = fixture.weights();
    weights.motion_encoder = weights.text_encoder.clone();
    weights
        .motion_encoder
        .retain(|name, _| !name.starts_with("pos_emb"));
    assert_eq!(
        refused(&weights),
        "a movement is 5 numbers wide where `motion_encoder` takes 4"
    );
    let absolute = fixture.statistics();
    let (mean, std) = (absolute.mean, absolute.std);
    let absolute = Statistics::new(mean, std, Some(Root::Absolute)).expect("statistics");
    let refused = TextMotionEvaluator::new(&fixture.weights(), absolute);
    assert!(matches!(refused, Err(TextMotionError::Features(_))));
    let other = Statistics::new(vec![0.0; 263], vec![1.0; 263], Some(Root::Relative));
    let refused = TextMotionEvaluator::new(&fixture.weights(), other.expect("statistics"));
    let message = refused.unwrap_err().to_string();
    assert_eq!(
        message,
        "a frame without contact flags is 259 numbers wide where `movement_encoder` takes 19"
    );
}

#[test]
fn clips_and_words_that_cannot_be_encoded_are_refused() {
    let fixture = Fixture::open();
    let evaluator = fixture.evaluator();
    let clips = fixture.clips();
    let short = clips[0].slice(0..3);
    let mut many = vec![&clips[0]; 40];
    many.push(&short);
    let expected = TextMotionError::TooShort {
        clip: 40,
        found: 3,
        needed: 4,
    };
    assert_eq!(evaluator.motion_embeddings(&many), Err(expected));
    let layout = FeatureLayout::of_joints(3).expect("a layout");
    let other = vec![0.0; 8 * layout.channels()];
    let other = Features::new(other, layout, Root::Relative).expect("features");
    assert!(matches!(
        evaluator.motion_embeddings(&[&other]),
        Err(TextMotionError::Features(_))
    ));
    let vectors = WordVectors::new(vec!["unk".into()], vec![0.5; 300]).expect("vectors");
    let message = evaluator.text_embeddings(&[&[]], &vectors).unwrap_err();
    assert_eq!(
        message.to_string(),
        "a word vector is 300 numbers wide where `text_encoder` takes 4"
    );
    assert_eq!(evaluator.motion_embeddings(&[]), Ok(Vec::new()));
}
