//! Resolving the takes of a plan to existing files.

use std::path::{Path, PathBuf};

use kinegrad_data::{MAX_FRAMES, check_id};

use crate::plan::{Plan, TakePlan};
use crate::prepare::files::{matching, named};

/// Extensions of songs; a `*` in a song's name matches only files with these extensions.
const SONGS: [&str; 5] = ["mp3", "wav", "flac", "ogg", "oga"];

/// A take with its files.
#[derive(Clone, Debug)]
pub(super) struct Take {
    pub name: String,
    /// The take's part of the plan, with the files that matched patterns.
    pub plan: TakePlan,
    /// The capture file of a whole take.
    pub motion: Option<PathBuf>,
    pub audio: Option<PathBuf>,
}

/// The takes of a plan, with resolved patterns in file names. Names must differ.
pub(super) fn resolve(plan: &Plan, takes: Vec<TakePlan>) -> Result<Vec<Take>, String> {
    let mut resolved: Vec<Take> = Vec::new();
    for take in takes {
        let name = take.name.as_deref().unwrap_or_default();
        take.check()
            .map_err(|refused| format!("take `{name}`: {refused}"))?;
        let motions: Vec<Option<PathBuf>> = match &take.motion {
            None => vec![None],
            Some(pattern) => {
                let found = matching(&plan.resolve(pattern), &[])?;
                found.into_iter().map(Some).collect()
            }
        };
        let segments = take.segments.iter().map(|s| Path::new(&s.motion));
        let captures = motions.iter().flatten().map(PathBuf::as_path);
        let captures: Vec<&Path> = captures.chain(segments).collect();
        if let Err(problem) = take.check_kinds(&captures) {
            let label = take.name.as_deref().or(take.motion.as_deref());
            return Err(format!("take `{}`: {problem}", label.unwrap_or_default()));
        }
        for motion in &motions {
            let stem = motion.as_deref().and_then(Path::file_stem);
            let stem = stem.unwrap_or_default().to_string_lossy();
            let name = take.name.as_deref().unwrap_or("{name}");
            let name = name.replace("{name}", &stem);
            let longest_id = format!("{name}_{MAX_FRAMES}");
            check_id(&longest_id).map_err(|error| error.to_string())?;
            if resolved.iter().any(|other| other.name == name) {
                return Err(format!(
                    "two takes have the name `{name}`: give one another `name`"
                ));
            }
            let audio = match take.audio.as_str() {
                "none" => None,
                pattern => {
                    let path = plan.resolve(&pattern.replace("{name}", &stem));
                    let mut found = matching(&path, &SONGS)?;
                    if found.len() > 1 {
                        let (count, path) = (found.len(), path.display());
                        return Err(format!("take `{name}`: {count} songs match {path}"));
                    }
                    found.pop()
                }
            };
            let mut plan_of_take = take.clone();
            if let (Some(pattern), Some(found)) = (&take.motion, motion) {
                plan_of_take.motion = Some(named(pattern, found));
            }
            if let Some(found) = &audio {
                plan_of_take.audio = named(&take.audio.replace("{name}", &stem), found);
            }
            resolved.push(Take {
                name,
                plan: plan_of_take,
                motion: motion.clone(),
                audio,
            });
        }
    }
    Ok(resolved)
}
