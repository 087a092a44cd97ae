//! Previews: samples during training.

use std::path::Path;

use kinegrad_data::write_whole;
use kinegrad_report::scene::{Floor, Scene};
use kinegrad_report::{body_panels, draw_png, viewer};
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::run::preview_page;
use kinegrad_train::sampling::{Contents, Request, Sample, SampleSink};
use kinegrad_train::{Error, Preview, Systems};

use crate::scene;

/// Number of previews if `sampling.count_at_end` is 0.
const COUNT: usize = 4;

/// Size of a panel in a picture, pixels.
const PANEL: (u32, u32) = (420, 240);

/// Curves beside the path of a motion without a body.
const CURVES: usize = 3;

/// Samples a checkpoint's averaged weights for the first held-out items, writes a page of the
/// samples into the run's folder, and returns one picture per sample. Fails without leaving a page
/// if sampling or writing fails.
pub fn write(systems: Systems<'_>, checkpoint: &Path, step: u64) -> Result<Vec<Preview>, Error> {
    let saved = SavedCheckpoint::read(checkpoint)?;
    let trained = systems.trained(saved, &[], Weights::Ema, None)?;
    let count = match trained.config().sampling.count_at_end {
        0 => COUNT,
        count => count,
    };
    let request = Request::held_out(count, trained.config().run.seed);
    let mut scenes = Scenes {
        systems,
        scene: Scene {
            title: format!("{}: step {step}", trained.config().run.name),
            ..Scene::default()
        },
    };
    systems.sample(&trained, &request, &mut scenes)?;
    let run = checkpoint.parent().and_then(Path::parent);
    let page = preview_page(run.unwrap_or(checkpoint), step);
    write_whole(&page, viewer::page(&scenes.scene).as_bytes())?;
    let previews = scenes.scene.objects.iter().filter_map(|figure| {
        let mut panels = body_panels(figure, &Floor::default());
        if panels.len() == 1 {
            panels.extend(scene::curve_panels(figure).take(CURVES));
        }
        let (png, (width, height)) = draw_png(&panels, 2, PANEL)?;
        Some(Preview {
            name: figure.name.clone(),
            width,
            height,
            png,
        })
    });
    Ok(previews.collect())
}

/// Collects samples as figures.
struct Scenes<'a> {
    systems: Systems<'a>,
    scene: Scene,
}

impl SampleSink for Scenes<'_> {
    fn stepped(&mut self, _stage: &'static str, _done: usize, _all: usize) {}

    fn sample(&mut self, sample: Sample) -> Result<(), Error> {
        // The motion itself comes first.
        let Some((_, Contents::Array { shape, values })) = sample.files.first() else {
            return Ok(());
        };
        let path = Path::new(&sample.name);
        let representation = self.systems.representation_of(path, shape, values)?;
        let figure = scene::of(&*representation, values, sample.name.clone());
        let sample = sample.name;
        let figure = figure.ok_or(Error::SampleNotFinite { sample })?;
        self.scene.objects.push(figure);
        Ok(())
    }
}
