//! Previews: samples during training.

use std::path::Path;

use kinegrad_data::write_whole;
use kinegrad_report::scene::{Floor, Scene};
use kinegrad_report::{body_panels, draw_png, viewer};
use kinegrad_train::checkpoint::{SavedCheckpoint, Weights};
use kinegrad_train::run::preview_page;
use kinegrad_train::sampling::{self, Conditions, Contents, Drawn, Receiver, Request};
use kinegrad_train::systems::Systems;
use kinegrad_train::{Error, Preview};

use crate::scene;

/// Number of previews if `sampling.count_at_end` is 0.
const COUNT: usize = 4;

/// Size of a panel in a picture, pixels.
const PANEL: (u32, u32) = (420, 240);

/// Curves beside the path of a motion without a body.
const CURVES: usize = 3;

/// Samples a checkpoint's averaged weights for the first held-out items, writes them as a page into
/// the run's folder, and returns a picture of each.
///
/// # Errors
/// If they cannot be sampled or written; no page is left then.
pub fn draw(systems: Systems<'_>, checkpoint: &Path, step: u64) -> Result<Vec<Preview>, Error> {
    let saved = SavedCheckpoint::read(checkpoint)?;
    let trained = systems.trained(saved, &[], Weights::Ema, None)?;
    let count = match trained.config().sampling.count_at_end {
        0 => COUNT,
        count => count,
    };
    let request = Request {
        conditions: Conditions {
            held_out: Some(count),
            ..Conditions::default()
        },
        count: 1,
        seed: trained.config().run.seed,
        ..Request::default()
    };
    let mut drawn = Scenes {
        systems,
        scene: Scene {
            title: format!("{}: step {step}", trained.config().run.name),
            ..Scene::default()
        },
    };
    sampling::sample(systems, &trained, &request, &mut drawn)?;
    let run = checkpoint.parent().and_then(Path::parent);
    let page = preview_page(run.unwrap_or(checkpoint), step);
    write_whole(&page, viewer::page(&drawn.scene).as_bytes())?;
    let previews = drawn.scene.figures.iter().filter_map(|figure| {
        let mut panels = body_panels(figure, &Floor::default());
        if panels.len() == 1 {
            panels.extend(scene::curve_panels(figure).take(CURVES));
        }
        let png = draw_png(&panels, 2, PANEL)?;
        Some(Preview {
            name: figure.name.clone(),
            width: png.width,
            height: png.height,
            png: png.bytes,
        })
    });
    Ok(previews.collect())
}

/// Collects samples as figures.
struct Scenes<'a> {
    systems: Systems<'a>,
    scene: Scene,
}

impl Receiver for Scenes<'_> {
    fn stepped(&mut self, _stage: &'static str, _done: usize, _all: usize) {}

    fn drawn(&mut self, drawn: Drawn) -> Result<(), Error> {
        // The motion itself comes first.
        let Some((_, Contents::Array { shape, values })) = drawn.files.first() else {
            return Ok(());
        };
        let path = Path::new(&drawn.name);
        let representation = self.systems.representation_of(path, shape, values)?;
        let figure = scene::of(&*representation, values, drawn.name.clone());
        self.scene
            .figures
            .push(figure.ok_or(Error::SampleNotFinite { sample: drawn.name })?);
        Ok(())
    }
}
