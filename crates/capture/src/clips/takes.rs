//! The takes of a plan with their files, joint maps and tables of captions.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use kinegrad_data::check_id;
use kinegrad_motion::humanml::Skeleton;

use super::labels::CaptionTable;
use super::map::JointMap;
use super::take::Take;
use crate::plan::{CapturePlan, Plan};
use crate::prepare::files::{matching, named};

/// The tables of captions of a plan, by their names in the plan.
pub(super) type Tables = HashMap<String, CaptionTable>;

/// The takes of a plan: patterns resolved, joint maps read.
pub(super) fn takes(plan: &Plan) -> Result<Vec<Take>, String> {
    let mut names = BTreeSet::new();
    let mut takes = Vec::new();
    for capture in &plan.captures {
        let map = capture.map.as_deref();
        let map = map.map(|map| read_map(plan, map)).transpose()?;
        for motion in matching(&plan.resolve(&capture.motion), &["bvh", "c3d"])? {
            let ending = motion.extension().unwrap_or_default();
            let is = |known: &str| ending.eq_ignore_ascii_case(known);
            if !is("bvh") && !is("c3d") {
                return Err(format!("{}: .bvh and .c3d files allowed", motion.display()));
            }
            let map_key = capture.map.as_ref().map(|_| "map");
            let key = map_key.or(capture.units.map(|_| "units"));
            if let Some(key) = key.filter(|_| is("c3d")) {
                let (capture, file) = (&capture.motion, motion.display());
                let problem = format!("`{key}` is for .bvh files, and {file} is none");
                return Err(format!("capture `{capture}`: {problem}"));
            }
            let stem = motion.file_stem().unwrap_or_default().to_string_lossy();
            let name = capture.name.as_deref().unwrap_or("{name}");
            let name = name.replace("{name}", &stem);
            check_id(&format!("M{name}_00000")).map_err(|error| error.to_string())?;
            if !names.insert(name.clone()) {
                return Err(format!(
                    "two takes have the name `{name}`: give one another `name`"
                ));
            }
            takes.push(Take {
                name,
                capture: CapturePlan {
                    motion: named(&capture.motion, &motion),
                    ..capture.clone()
                },
                motion,
                map: map.clone(),
            });
        }
    }
    let image = |name: &&String| names.contains(&format!("M{name}"));
    if plan.clips().mirror
        && let Some(name) = names.iter().find(image)
    {
        return Err(format!(
            "a take `M{name}` beside `{name}`: M begins the ids of mirrored clips; give one another \
             `name`, or set clips.mirror = false"
        ));
    }
    Ok(takes)
}

fn read_map(plan: &Plan, map: &str) -> Result<JointMap, String> {
    let ending = Path::new(map).extension();
    if ending.is_none_or(|ending| ending != "toml") {
        return JointMap::built_in(map);
    }
    let path = plan.resolve(map);
    let file = path.display().to_string();
    let text = kinegrad_data::file::read_text(&path).map_err(|e| format!("{file}: {e}"))?;
    JointMap::parse(&file, &text, &Skeleton::humanml3d())
}

pub(super) fn tables(plan: &Plan) -> Result<Tables, String> {
    let mut tables = Tables::new();
    for file in plan.captures.iter().filter_map(|c| c.captions.as_ref()) {
        if !tables.contains_key(file) {
            tables.insert(file.clone(), CaptionTable::read(&plan.resolve(file))?);
        }
    }
    Ok(tables)
}
