//! `kinegrad view`

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_report::viewer;
use kinegrad_train::Error;
use kinegrad_train::systems::Systems;

use crate::args::ViewArguments;
use crate::scene::{self, Music, Reading};

/// Reads the motions as one scene and writes what is asked for of it.
pub fn run(systems: Systems<'_>, arguments: ViewArguments) -> Result<ExitCode, Error> {
    let motions = scene::motions(&arguments.motions, arguments.raw)?;
    let page = page_path(&arguments, &motions[0])?;
    let reading = Reading {
        units: arguments.units,
        up: arguments.up,
        fps: arguments.fps,
        title: arguments.title,
        goal: arguments.goal,
        music: arguments.audio.map(|song| Music {
            song,
            start: arguments.start,
        }),
    };
    let scene = scene::read(systems, &motions, &reading)?;
    write(&page, viewer::page(&scene).as_bytes())?;
    say!("{}", page.display());
    Ok(ExitCode::SUCCESS)
}

/// Where the page goes.
fn page_path(arguments: &ViewArguments, first: &Path) -> Result<PathBuf, Error> {
    let page = match &arguments.out {
        Some(out) => out.clone(),
        None => first.with_extension("html"),
    };
    if !page
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("html"))
    {
        return Err(Error::usage(
            format!("`--out {}` does not end in .html", page.display()),
            format!(
                "the page is HTML: `--out {}`",
                page.with_extension("html").display()
            ),
        ));
    }
    if page.exists() && !arguments.overwrite {
        return Err(Error::usage(
            format!("{} exists already", page.display()),
            "replace it with `--overwrite`, or name another page with `--out`",
        ));
    }
    Ok(page)
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let failed = |error| Error::io("write", path)(error);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    let temporary = path.with_added_extension(format!("{}.tmp", std::process::id()));
    let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
    written.map_err(|error| {
        let _ = fs::remove_file(&temporary);
        failed(error)
    })
}
