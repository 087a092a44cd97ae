//! An external system: points on circles, three numbers a frame, with its own network,
//! representation, dataset and sampler. One registration makes it available in every command.

use std::borrow::Cow;
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_data::{
    AUDIO, Batch, ConditionRows, Dataset, Item, ItemSet, Loader, SampleShape, Samples, read_array,
    write_values,
};
use kinegrad_diffusion::Time;
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::{Representation, Statistics};
use kinegrad_random::{Key, Purpose};
use kinegrad_systems::BUILT_IN;
use kinegrad_train::TrainedModel;
use kinegrad_train::config::{Config, ConfigError, OwnTables, SystemTables};
use kinegrad_train::denoising::{HeldOut, Inputs};
use kinegrad_train::evaluation::{Evaluation, EvaluationRequest, Group, Metrics, Number, Results};
use kinegrad_train::run::{Outcome, RunContext, TrainingData};
use kinegrad_train::sampling::{Generated, Job, Request, Run, SampleSink, Sampler, Summary};
use kinegrad_train::{Error, Loss, Measured, Observer, ParameterCount, Recipe, StepKey};
use kinegrad_train::{RecipeInfo, System, Systems};
use serde::{Deserialize, Serialize};
use toml::Table;

/// Channels of a point: x, y, z.
const CHANNELS: usize = 3;

/// The representation of a circle: a point in metres, ten times a second.
#[derive(Clone, Copy, Debug)]
struct Point;

impl Representation for Point {
    fn name(&self) -> String {
        "point".to_owned()
    }

    fn channels(&self) -> usize {
        CHANNELS
    }

    fn fps(&self) -> f64 {
        10.0
    }

    fn channel_name(&self, channel: usize) -> String {
        ["x", "y", "z"][channel].to_owned()
    }

    fn joints(&self, rows: &[f32]) -> Option<Joints> {
        Joints::from_f32(rows, 1).ok()
    }
}

/// One round of a circle at the height of its radius, which is the condition.
#[derive(Clone, Debug)]
struct Circle {
    id: String,
    radius: f32,
    rows: Vec<f32>,
}

impl Circle {
    fn new(index: usize, frames: usize) -> Arc<Self> {
        let radius = 0.5 + 0.1 * index as f32;
        let point = |t: usize| {
            let angle = (TAU * t as f64 / frames as f64) as f32;
            [radius * angle.cos(), radius, radius * angle.sin()]
        };
        Arc::new(Self {
            id: format!("circle_{index}"),
            radius,
            rows: (0..frames).flat_map(point).collect(),
        })
    }
}

/// The normalised radius: mean about 0, deviation about 1.
fn condition(radius: f32) -> f32 {
    (radius - 0.75) / 0.2
}

impl Item for Circle {
    const KIND: &'static str = "circle";

    type Representation = Point;

    fn id(&self) -> &str {
        &self.id
    }

    fn frames(&self) -> usize {
        self.rows.len() / CHANNELS
    }

    fn bytes(&self) -> usize {
        4 * self.rows.len()
    }

    fn rows(&self, _: &Point) -> Cow<'_, [f32]> {
        Cow::Borrowed(&self.rows)
    }
}

/// Complete circles with two conditions: the radius, and a sound that grows with it.
#[derive(Clone)]
struct CircleSamples {
    circles: ItemSet<Circle>,
    statistics: Arc<Statistics>,
    frames: usize,
}

impl Samples for CircleSamples {
    type Item = Circle;
    type Read = Arc<Circle>;

    fn items(&self) -> &ItemSet<Circle> {
        &self.circles
    }

    fn shape(&self) -> SampleShape {
        SampleShape {
            channels: CHANNELS,
            frames: self.frames,
            conditions: vec![("radius", 1, 1), (AUDIO, 1, self.frames)],
        }
    }

    fn read(&self, position: usize) -> Result<Arc<Circle>, kinegrad_data::Error> {
        self.circles.get(position)
    }

    fn push(&self, batch: &mut Batch, circle: &Arc<Circle>, _: Option<u64>) {
        let frames = circle.frames().min(self.frames);
        let sound = vec![circle.radius; frames];
        let conditions = [
            ConditionRows {
                values: &[condition(circle.radius)],
                frames: 1,
                range: 0..1,
            },
            ConditionRows {
                values: &sound,
                frames,
                range: 0..frames,
            },
        ];
        let rows = &circle.rows[..frames * CHANNELS];
        batch.push(&circle.id, rows, &self.statistics, &conditions);
    }
}

/// A matrix for a point, plus terms of time and radius.
#[derive(Module, Debug)]
struct Network {
    matrix: Param<Tensor<2>>,
    of_time: Param<Tensor<1>>,
    of_radius: Param<Tensor<1>>,
}

impl Network {
    fn new(device: &Device) -> Self {
        let zeros = || Param::from_tensor(Tensor::<1>::zeros([CHANNELS], device));
        Self {
            matrix: Param::from_tensor(Tensor::zeros([CHANNELS, CHANNELS], device)),
            of_time: zeros(),
            of_radius: zeros(),
        }
    }

    /// The predicted clean motion of `x`, `[batch, 3, time]`, at `time` given `radius`, `[batch, 1,
    /// 1]`.
    fn forward(&self, x: Tensor<3>, time: &[Time], radius: Tensor<3>) -> Tensor<3> {
        let times: Vec<f32> = time.iter().map(|time| time.0 as f32).collect();
        let times = TensorData::new(times, [time.len(), 1, 1]);
        let times = Tensor::<3>::from_data(times, &x.device());
        let channels = |tensor: Tensor<1>| tensor.reshape([1, CHANNELS, 1]);
        self.matrix.val().unsqueeze::<3>().matmul(x)
            + channels(self.of_time.val()) * times
            + channels(self.of_radius.val()) * radius
    }
}

/// Euler steps along straight lines from noise to the predicted clean motion.
fn euler(network: &Network, mut x: Tensor<3>, radius: &Tensor<3>, steps: usize) -> Tensor<3> {
    for step in 0..steps {
        let time = vec![Time(step as f64 / steps as f64); x.dims()[0]];
        let clean = network.forward(x.clone(), &time, radius.clone());
        x = x.clone() + (clean - x) / (steps - step) as f64;
    }
    x
}

/// The system's own tables.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct ToyConfig {
    circles: CircleConfig,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct CircleConfig {
    count: usize,
    frames: usize,
}

impl Default for CircleConfig {
    fn default() -> Self {
        Self {
            count: 6,
            frames: 20,
        }
    }
}

impl SystemTables for ToyConfig {}

/// Squared error of the clean motion at a random place of the straight line from noise to it.
struct ToyRecipe(HeldOut);

impl ToyRecipe {
    fn error(model: &Network, inputs: &Inputs, noise: Tensor<3>, time: f64) -> Tensor<1> {
        let x = inputs.x_start.clone() * time + noise * (1.0 - time);
        let times = vec![Time(time); x.dims()[0]];
        let found = model.forward(x, &times, inputs.cond.get("radius").clone());
        let error = (found - inputs.x_start.clone()).powi_scalar(2);
        (error * inputs.mask.clone().unsqueeze_dim::<3>(1)).mean()
    }
}

impl Recipe for ToyRecipe {
    type Model = Network;
    type Pending = ();

    fn loss(&self, model: &Network, batch: &Batch, key: StepKey, device: &Device) -> Loss {
        let inputs = Inputs::new(batch, device);
        let shape = inputs.x_start.dims();
        let noise = kinegrad_train::denoising::noise(key.of(Purpose::Noise), shape, device);
        let time = f64::from(key.of(Purpose::Timesteps).uniforms(1)[0]);
        let total = Self::error(model, &inputs, noise, time);
        Loss {
            terms: vec![("line", total.clone())],
            probes: Vec::new(),
            total,
            pending: (),
        }
    }

    fn validation_loss(&self, model: &Network, device: &Device) -> Measured {
        self.0.mean_terms(|range, batch| {
            let inputs = Inputs::new(&batch, device);
            let noise = self.0.noise(range, 0, &inputs.x_start);
            vec![("line", Self::error(model, &inputs, noise, 0.5))]
        })
    }
}

struct Toy;

fn dataset(config: &Config) -> Result<Dataset<Circle>, Error> {
    let CircleConfig { count, frames } = config.own::<ToyConfig>().circles;
    let mut circles: Vec<_> = (0..count).map(|index| Circle::new(index, frames)).collect();
    let held_out = circles.split_off(count - count / 3);
    Ok(Dataset::of_items(circles, held_out, Point))
}

/// Mean height of points.
fn height(rows: &[f32]) -> f64 {
    let points = rows.chunks(CHANNELS);
    let count = points.len() as f64;
    points.map(|point| f64::from(point[1])).sum::<f64>() / count
}

/// Rows of sampled circles, one for each radius.
fn draw(trained: &TrainedModel, radii: &[f32], seed: u64) -> Result<Vec<Vec<f32>>, Error> {
    let network = trained.load(Network::new(&trained.device))?;
    let frames = trained.config().own::<ToyConfig>().circles.frames;
    let shape = [radii.len(), CHANNELS, frames];
    let key = Key::new(seed, Purpose::Sampling);
    let noise = kinegrad_train::denoising::noise(key, shape, &trained.device);
    let given: Vec<f32> = radii.iter().copied().map(condition).collect();
    let radius = TensorData::new(given, [radii.len(), 1, 1]);
    let radius = Tensor::from_data(radius, &trained.device);
    let steps = trained.config().sampling.sampler.num_inference_steps;
    let drawn = euler(&network, noise, &radius, steps);
    let values = drawn.try_into_vec_as::<f32>().expect("float32");
    let statistics = trained.saved.state.statistics_of(&Point)?;
    let each = values.chunks(CHANNELS * frames);
    Ok(each.map(|values| statistics.denormalize(values)).collect())
}

/// A request for circles.
struct ToySampler<'a> {
    trained: &'a TrainedModel,
    radii: Vec<f32>,
    jobs: [Job; 1],
}

impl Sampler for ToySampler<'_> {
    fn jobs(&self) -> &[Job] {
        &self.jobs
    }

    fn extensions(&self) -> &'static [&'static str] {
        Generated::ROWS
    }

    fn sample(&self, run: &mut Run<'_>) -> Result<Option<Summary>, Error> {
        let circles = draw(self.trained, &self.radii, run.request.seed)?;
        for (index, values) in circles.into_iter().enumerate() {
            let shape = vec![values.len() / CHANNELS, CHANNELS];
            let record = run.record(0, index);
            run.pass(0, index, Generated::Rows { shape, values }, record)?;
        }
        Ok(None)
    }
}

/// The metrics of circles.
struct Heights {
    /// Mean height, metres.
    mean: f64,
}

impl Heights {
    fn of<'a>(circles: impl ExactSizeIterator<Item = &'a Vec<f32>>) -> Self {
        let count = circles.len() as f64;
        let sum: f64 = circles.map(|rows| height(rows)).sum();
        Self { mean: sum / count }
    }
}

impl Metrics for Heights {
    fn rows(&self) -> Vec<Number> {
        vec![Number::new("height", Some(self.mean), " (m)")]
    }
}

impl System for Toy {
    fn name(&self) -> &'static str {
        "toy"
    }

    fn recipes(&self) -> &'static [RecipeInfo] {
        &[RecipeInfo {
            name: "circles",
            groups: &["network"],
        }]
    }

    fn representations(&self) -> Vec<Box<dyn Representation>> {
        vec![Box::new(Point)]
    }

    fn defaults(&self, _: &RecipeInfo, _: &Table) -> Table {
        "data.kind = \"synthetic\"".parse().expect("TOML")
    }

    fn complete(
        &self,
        tables: &Table,
        place: &dyn Fn(&str) -> String,
    ) -> Result<OwnTables, ConfigError> {
        Ok(OwnTables::new(ToyConfig::read(tables, place)?))
    }

    fn validate(&self, _: &Config) -> Result<Vec<String>, Error> {
        Ok(Vec::new())
    }

    fn parameters(&self, _: &Config) -> Result<ParameterCount, Error> {
        let all = CHANNELS * CHANNELS + 2 * CHANNELS;
        Ok(ParameterCount {
            all,
            trained: all,
            ..ParameterCount::default()
        })
    }

    fn accepts(&self, _: &str) -> &'static [&'static str] {
        &["radius"]
    }

    fn sampler<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &'a Request,
        _: &mut dyn SampleSink,
    ) -> Result<Box<dyn Sampler + 'a>, Error> {
        let given = request.other("radius");
        let radii = match given.map(|value| value.as_f64().filter(|radius| *radius > 0.0)) {
            None => (0..request.count).map(|i| 0.6 + 0.2 * i as f32).collect(),
            Some(Some(radius)) => vec![radius as f32; request.count],
            Some(None) => {
                let message = format!("option `condition radius={}`", given.expect("just read"));
                return Err(Error::usage(message, "give a positive number"));
            }
        };
        let job = Job {
            name: None,
            caption: None,
            conditions: request.conditions.clone(),
            frames: trained.config().own::<ToyConfig>().circles.frames,
        };
        Ok(Box::new(ToySampler {
            trained,
            radii,
            jobs: [job],
        }))
    }

    fn evaluate<'a>(
        &self,
        trained: &'a TrainedModel,
        request: &EvaluationRequest,
    ) -> Result<Evaluation<'a>, Error> {
        let held_out = dataset(trained.config())?.validation.load()?;
        let seed = request.seed;
        Ok(Evaluation {
            report: "eval-circles",
            memory: 0,
            memory_hint: "",
            remarks: Vec::new(),
            measure: Box::new(move |_| {
                let radii: Vec<f32> = held_out.iter().map(|circle| circle.radius).collect();
                let samples = Heights::of(draw(trained, &radii, seed)?.iter());
                let real = Heights::of(held_out.iter().map(|circle| &circle.rows));
                let count = Some(held_out.len() as u64);
                Ok(Results {
                    json: serde_json::json!({ "height": samples.mean }),
                    facts: vec![("circles", [count; 2])],
                    samples: Some(vec![Group::new("circles", "", &samples)]),
                    real: vec![Group::new("circles", "", &real)],
                    verdict: Vec::new(),
                    remarks: Vec::new(),
                })
            }),
        })
    }

    fn train(&self, context: RunContext, observer: &mut dyn Observer) -> Result<Outcome, Error> {
        let context = context.with_gradients(false);
        let dataset = dataset(&context.config)?;
        context.must_be_same_dataset(dataset.digest)?;
        let statistics = match &context.checkpoint {
            Some(checkpoint) => checkpoint.state.statistics_of(&Point)?.clone(),
            None => dataset.statistics()?,
        };
        let frames = context.config.own::<ToyConfig>().circles.frames;
        let samples = |circles| CircleSamples {
            circles,
            statistics: Arc::new(statistics.clone()),
            frames,
        };
        let held_out = samples(dataset.validation.clone());
        let train = samples(dataset.train.clone());
        let training_data = TrainingData {
            train: dataset.train.len(),
            validation: dataset.validation.len(),
            skipped: dataset.skipped,
            digest: dataset.digest,
            loader: Box::new(move |config, share| {
                Loader::of_share(train, &config.data, config.run.seed, share)
            }),
            statistics,
            network_statistics: None,
        };
        let recipe = ToyRecipe(HeldOut::new(held_out, &context.config.validation));
        let model = Network::new(&context.device);
        context.train(training_data, recipe, model, observer)
    }
}

const CONFIG: &str = r#"
[run]
name = "toy"
device = "cpu"
[circles]
count = 9
[data]
batch_size = 4
[optim]
lr_schedule = "constant"
warmup_steps = 0
learning_rate = 0.05
[train]
recipe = "circles"
max_steps = 60
[ema]
decay = 0.5
update_every = 1
[checkpoint]
every_steps = 10
[validation]
every_steps = 20
[sampling.sampler]
num_inference_steps = 8
"#;

/// Runs a command line with all systems, including this one; `@` is replaced by `folder`.
fn kinegrad(folder: &Path, line: &str) {
    kinegrad_ends(folder, line, 0);
}

/// As [`kinegrad`], with the exit code that is expected.
fn kinegrad_ends(folder: &Path, line: &str, expected: u8) {
    let all: Vec<&dyn System> = BUILT_IN
        .0
        .iter()
        .copied()
        .chain([&Toy as &dyn System])
        .collect();
    let here = folder.display().to_string();
    let words = line.split_whitespace().map(|word| word.replace('@', &here));
    let arguments = ["kinegrad".to_owned()].into_iter().chain(words);
    let code = kinegrad_cli::run(Systems(&all), arguments);
    let expected = ExitCode::from(expected);
    assert_eq!(format!("{code:?}"), format!("{expected:?}"), "{line}");
}

#[test]
fn a_system_of_ones_own_has_every_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = folder.path();
    fs::write(here.join("c.toml"), CONFIG).expect("a config");
    kinegrad(here, "train @/c.toml --runs-dir @/whole");
    kinegrad(
        here,
        "train @/c.toml --runs-dir @/halves --set train.max_steps=30",
    );
    kinegrad(
        here,
        "train @/c.toml --runs-dir @/halves --set train.max_steps=60 --resume",
    );
    let weights = |runs: &str| {
        let checkpoint = here.join(runs).join("toy/checkpoints/step-00000060");
        let found = fs::read_dir(&checkpoint).is_ok();
        assert!(found, "no {}", checkpoint.display());
        ["model", "ema", "optimizer"]
            .map(|name| fs::read(checkpoint.join(format!("{name}.safetensors"))).expect("weights"))
    };
    assert!(weights("whole") == weights("halves"), "resumed");

    kinegrad(here, "sample @/whole/toy --count 3 --out @/drawn.npy");
    let drawn = |index: usize| {
        let array = read_array(&here.join(format!("drawn-{index:03}.npy"))).expect("an array");
        assert_eq!(array.shape, [20, CHANNELS]);
        array.values
    };
    for (index, radius) in [0.6, 0.8, 1.0].into_iter().enumerate() {
        let found = height(&drawn(index));
        assert!((found - radius).abs() < 0.05, "{found} at radius {radius}");
    }
    // A condition of its own.
    kinegrad(
        here,
        "sample @/whole/toy --condition radius=0.9 --out @/asked",
    );
    let asked = read_array(&here.join("asked.npy")).expect("an array");
    let found = height(&asked.values);
    assert!((found - 0.9).abs() < 0.05, "{found} at radius 0.9");
    let record = fs::read_to_string(here.join("asked.json")).expect("a record");
    let record: serde_json::Value = serde_json::from_str(&record).expect("JSON");
    assert_eq!(record["condition"]["radius"], 0.9);
    for bad in ["radius=-1", "radius=wide", "width=2"] {
        let line = format!("sample @/whole/toy --condition {bad} --out @/bad");
        kinegrad_ends(here, &line, 2);
    }

    kinegrad(here, "eval @/whole/toy --out @/evaluated");
    let report = fs::read_to_string(here.join("evaluated/eval-circles.json")).expect("a report");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let found = report["evaluations"][0]["height"].as_f64();
    // The held-out circles are the three largest of nine: 1.1, 1.2 and 1.3 metres.
    assert!((found.expect("a height") - 1.2).abs() < 0.1, "{report}");

    // So short a training makes no smooth circle.
    kinegrad_ends(here, "check @/drawn-000.npy", 1);
    // A real circle is as smooth as those that were trained on; every frame by itself is not.
    let smooth = Circle::new(2, 20).rows.clone();
    let mut jerky = smooth.clone();
    jerky.iter_mut().step_by(2).for_each(|value| *value += 0.3);
    for (name, rows, expected) in [("smooth", smooth, 0), ("jerky", jerky, 1)] {
        write_values(&here.join(format!("{name}.npy")), &[20, CHANNELS], &rows).expect("a file");
        let line = format!("check @/{name}.npy --profile strict --run @/whole/toy");
        kinegrad_ends(here, &line, expected);
    }
    kinegrad(here, "plot @/drawn-000.npy --out @/drawn.svg");
    let picture = fs::read_to_string(here.join("drawn.svg")).expect("a picture");
    assert!(picture.contains("root path, top view") && picture.contains("height (m)"));
    kinegrad(here, "plot @/whole/toy --out @/losses.svg");
    kinegrad(here, "config show @/c.toml");
}
