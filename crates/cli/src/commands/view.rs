//! `kinegrad view`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_data::write_whole;
use kinegrad_report::{ExportError, gif, glb, mp4, must_be_exportable, viewer};
use kinegrad_train::{Error, Systems};

use crate::args::ViewArguments;
use crate::io::{has_extension, must_be_new};
use crate::output::unusable;
use crate::progress::Count;
use crate::scene::{self, Music, Reading};
use crate::{folder, interrupt};

/// Kinds of output.
#[derive(Clone, Copy, Eq, PartialEq)]
enum Kind {
    Page,
    Gif,
    Mp4,
    Glb,
    Bvh,
}

impl Kind {
    /// Its option and the ending of its files.
    fn names(self) -> [&'static str; 2] {
        match self {
            Self::Page => ["--out", "html"],
            Self::Gif => ["--gif", "gif"],
            Self::Mp4 => ["--mp4", "mp4"],
            Self::Glb => ["--glb", "glb"],
            Self::Bvh => ["--bvh", "bvh"],
        }
    }
}

/// Reads the motions as one scene and writes it.
pub fn run(systems: Systems<'_>, arguments: ViewArguments) -> Result<ExitCode, Error> {
    interrupt::end_between_files();
    let motions = scene::motions(&arguments.motions, arguments.raw)?;
    let outputs = outputs(&arguments, &motions)?;
    let sounds = outputs
        .iter()
        .any(|(kind, _)| matches!(kind, Kind::Page | Kind::Mp4));
    let reading = Reading {
        title: arguments.title,
        goal: arguments.goal,
        music: match arguments.audio {
            Some(song) => Some(Music {
                song,
                start: arguments.start,
            }),
            None => Some(&motions)
                .filter(|_| sounds)
                .and_then(|motions| scene::recorded(motions)),
        },
        ..Reading::of(&arguments.reading)
    };
    let scene = scene::read(systems, &motions, &reading)?;
    // All files are written, or none.
    for (kind, path) in &outputs {
        if !matches!(kind, Kind::Page | Kind::Bvh) {
            must_be_exportable(&scene, path).map_err(unusable)?;
        }
        if *kind == Kind::Mp4 {
            mp4::must_have_encoder(path).map_err(unusable)?;
        }
    }
    let mut bvh = None;
    if let Some(out) = &arguments.bvh {
        let lock_feet = arguments.lock_feet;
        bvh = Some(scene::bvh_text(
            systems,
            &motions[0],
            &reading.bvh,
            out,
            lock_feet,
        )?);
    }
    for (_, path) in &outputs {
        folder::must_be_writable(path)?;
    }
    for (kind, path) in outputs {
        let written = match kind {
            Kind::Page | Kind::Bvh => {
                let text = match kind {
                    Kind::Page => viewer::page(&scene),
                    _ => bvh.take().unwrap_or_default(),
                };
                interrupt::not_during(|| write_whole(&path, text.as_bytes()))?;
                Ok(())
            }
            Kind::Gif | Kind::Mp4 => interrupt::stoppable(|stop| {
                let count = Count::new("pictures drawn");
                let stop = |done: usize, total: usize| {
                    count.show(done, total);
                    stop()
                };
                match kind {
                    Kind::Gif => gif::write(&scene, &path, &stop),
                    _ => mp4::write(&scene, &path, &stop),
                }
            }),
            Kind::Glb => interrupt::not_during(|| glb::write(&scene, &path)),
        };
        match written {
            Err(ExportError::Interrupted { .. }) => {
                tell!("\ninterrupted");
                return Ok(ExitCode::from(130));
            }
            written => written.map_err(unusable)?,
        }
        say!("{}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// The files to write.
fn outputs(arguments: &ViewArguments, motions: &[PathBuf]) -> Result<Vec<(Kind, PathBuf)>, Error> {
    let named = [
        (Kind::Page, &arguments.out),
        (Kind::Gif, &arguments.gif),
        (Kind::Mp4, &arguments.mp4),
        (Kind::Glb, &arguments.glb),
        (Kind::Bvh, &arguments.bvh),
    ];
    let named = named.into_iter();
    let named = named.filter_map(|(kind, path)| Some((kind, path.clone()?)));
    let mut outputs: Vec<(Kind, PathBuf)> = named.collect();
    if outputs.is_empty() {
        outputs.push((Kind::Page, motions[0].with_extension("html")));
    }
    for (kind, path) in &outputs {
        must_have_ending(*kind, path)?;
        must_be_new([path], motions, arguments.overwrite, kind.names()[0])?;
    }
    let bvh = outputs.iter().any(|(kind, _)| *kind == Kind::Bvh);
    if bvh && motions.len() > 1 {
        return Err(Error::usage(
            format!("`--bvh` with {} motions", motions.len()),
            "a BVH file contains one motion: write one at a time",
        ));
    }
    Ok(outputs)
}

fn must_have_ending(kind: Kind, path: &Path) -> Result<(), Error> {
    let [option, ending] = kind.names();
    match has_extension(path, ending) {
        true => Ok(()),
        false => Err(Error::usage(
            format!("`{option} {}` does not end in .{ending}", path.display()),
            format!("`{option} {}`", path.with_extension(ending).display()),
        )),
    }
}
