//! Builds a [`Scene`] from files: motions of every representation, BVH files, goals and songs.

mod body;
mod music;
mod origins;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use kinegrad_capture::Bvh;
use kinegrad_motion::goal::{Goal, Obstacle};
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::phrase::QUATERNION;
use kinegrad_motion::{CHANNELS, Phrase, Phrases, Quaternion, Representation};
use kinegrad_report::Panel;
use kinegrad_report::scene::{Curves, Floor, Hierarchy, Scene, SceneObject};
use kinegrad_train::clips::read_goal;
use kinegrad_train::{Error, Systems};

use crate::args::BvhArguments;
use crate::io::{
    BvhReading, CENTIMETRES, Capture, Motion, bvh_file, file_stem, is_bvh, motion_files,
    names as joint_names, not_finite, with_raw,
};
use crate::output::unusable;

use body::figure as body;
pub use music::{Music, recorded, song};

/// Largest number of figures in a scene.
const MOST_FIGURES: usize = 16;

/// Facts that motion files do not contain, and other contents of the scene.
#[derive(Debug, Default)]
pub struct Reading {
    /// Unit and vertical of BVH files.
    pub bvh: BvhReading,
    /// Title; the names of the motions if absent.
    pub title: Option<String>,
    /// Goal on the floor.
    pub goal: Option<PathBuf>,
    /// Song to play.
    pub music: Option<Music>,
}

impl Reading {
    /// The reading options of the command line.
    pub fn of(arguments: &BvhArguments) -> Self {
        Self {
            bvh: BvhReading::of(arguments),
            ..Self::default()
        }
    }
}

/// The motion files at `paths`; with `raw`, each file is followed by its raw model output. Fails if
/// a path has no motion, or for too many files.
pub fn motions(paths: &[PathBuf], raw: bool) -> Result<Vec<PathBuf>, Error> {
    let mut files = motion_files(paths, &["npy", "bvh"])?;
    if raw {
        warn_of_no_raw(&files);
        files = with_raw(files);
    }
    if files.len() > MOST_FIGURES {
        let (count, first) = (files.len(), files[0].display());
        return Err(Error::usage(
            format!("{count} motions, at most {MOST_FIGURES} fit on a page"),
            format!("name some of them, the first is {first}"),
        ));
    }
    Ok(files)
}

/// Warns of motions without raw model output.
fn warn_of_no_raw(files: &[PathBuf]) {
    let is_raw = |file: &Path| file.to_string_lossy().ends_with(".raw.npy");
    let mut without: Vec<&PathBuf> = files.iter().collect();
    without.retain(|file| !is_raw(file) && !file.with_extension("raw.npy").is_file());
    let Some(first) = without.first() else {
        return;
    };
    let others = match without.len() {
        1 => String::new(),
        all => format!(", nor beside {} others", all - 1),
    };
    tell!(
        "warning: `--raw`: there is no {} beside {}{others}; `kinegrad sample` writes raw output of \
         phrases, not of clips",
        first.with_extension("raw.npy").display(),
        first.display()
    );
}

/// The scene of `motions`, with one figure per motion, or per ROOT of a BVH file. Fails if a motion,
/// the goal or the song cannot be read.
pub fn read(systems: Systems<'_>, motions: &[PathBuf], reading: &Reading) -> Result<Scene, Error> {
    let figures = motions.iter().zip(names(motions));
    let figures = figures
        .map(|(path, name)| figures_of(systems, path, name, reading))
        .collect::<Result<Vec<_>, Error>>()?
        .concat();
    let floor = match &reading.goal {
        Some(path) => floor(&read_goal(path)?.0),
        None => Floor::default(),
    };
    let seconds = figures.iter().map(SceneObject::seconds).fold(0.0, f64::max);
    let music = reading.music.as_ref();
    let names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    Ok(Scene {
        title: reading.title.clone().unwrap_or_else(|| names.join(", ")),
        floor,
        song: music.map(|music| song(music, seconds)).transpose()?,
        objects: figures,
    })
}

/// A name for each file: its stem, the folder of `ID/trajectory.npy` in datasets, or both if names
/// are equal.
fn names(paths: &[PathBuf]) -> Vec<String> {
    let folder = |path: &Path| file_stem(path.parent().unwrap_or(Path::new("")));
    let short = |path: &PathBuf| match file_stem(path) {
        stem if stem == "trajectory" && !folder(path).is_empty() => folder(path),
        stem => stem,
    };
    let different: HashSet<String> = paths.iter().map(short).collect();
    let name = |path: &PathBuf| match different.len() == paths.len() {
        true => short(path),
        false => format!("{}/{}", folder(path), file_stem(path)),
    };
    paths.iter().map(name).collect()
}

/// The figures in a file, the first with the source frames of a matched motion.
fn figures_of(
    systems: Systems<'_>,
    path: &Path,
    name: String,
    reading: &Reading,
) -> Result<Vec<SceneObject>, Error> {
    let motions = match is_bvh(path) {
        true => {
            let captures = Capture::read_figures(path, &reading.bvh)?.into_iter();
            captures.map(Motion::Bvh).collect()
        }
        false => vec![Motion::read(systems, path, &reading.bvh)?],
    };
    let several = motions.len() > 1;
    let figures = motions.iter().enumerate().map(|(index, motion)| {
        let name = match several {
            true => format!("{name} {}", index + 1),
            false => name.clone(),
        };
        of_motion(motion, name)
    });
    let mut figures: Vec<SceneObject> = figures.collect::<Result<_, _>>()?;
    figures[0].origins = origins::beside(path, figures[0].frames());
    Ok(figures)
}

/// The figure of a motion.
pub fn of_motion(motion: &Motion, name: String) -> Result<SceneObject, Error> {
    match motion {
        Motion::Array(array) => {
            of(&*array.representation, &array.values, name).ok_or_else(|| not_finite(&array.path))
        }
        Motion::Points(joints, fps, _) => Ok(points(joints, name, *fps)),
        Motion::Bvh(capture) => {
            let joints = capture.bvh.joints().iter();
            let parents = joints.map(|joint| joint.parent).collect();
            let fps = 1.0 / capture.bvh.frame_time();
            let places = capture.joints()?;
            let names = joint_names(&capture.bvh);
            Ok(SceneObject {
                hierarchy: Some(hierarchy(&capture.in_metres()?)),
                ..body(name, fps, &places, names, parents, None)
            })
        }
    }
}

/// Rest pose and rotations of a file in metres with +y up.
fn hierarchy(bvh: &Bvh) -> Hierarchy {
    let poses = || (0..bvh.frames()).flat_map(|t| bvh.local_poses(t));
    let single = |place: [f64; 3]| place.map(|value| value as f32);
    let parts = |q: Quaternion| [q.w, q.x, q.y, q.z].map(|part| part as f32);
    Hierarchy {
        offsets: bvh
            .joints()
            .iter()
            .map(|joint| single(joint.offset))
            .collect(),
        translations: poses().map(|pose| single(pose.position)).collect(),
        rotations: poses().map(|pose| parts(pose.orientation)).collect(),
    }
}

/// The error of feet that cannot be locked.
fn no_legs(path: &Path, what: &str) -> Error {
    Error::usage(
        format!("{}: `--lock-feet` with {what}", path.display()),
        "leave it out: only joint features and joint positions of 22 or 21 joints have known legs",
    )
}

/// A motion as the text of a BVH file in centimeters with +y up, for the file `out`. `lock_feet` locks
/// standing feet. Fails if the motion cannot be read, or its skeleton is unknown.
pub fn bvh_text(
    systems: Systems<'_>,
    path: &Path,
    reading: &BvhReading,
    out: &Path,
    lock_feet: bool,
) -> Result<String, Error> {
    if is_bvh(path) {
        if lock_feet {
            return Err(no_legs(path, "a BVH file"));
        }
        let captures = Capture::read_figures(path, reading)?;
        let figures = captures.iter().map(Capture::in_centimetres);
        let figures: Vec<Bvh> = figures.collect::<Result<_, _>>()?;
        return Ok(Bvh::figures_to_text(&figures));
    }
    let array = match Motion::read(systems, path, reading)? {
        Motion::Array(array) => array,
        Motion::Points(_, _, error) => return Err(error),
        Motion::Bvh(_) => unreachable!("BVH files end in .bvh"),
    };
    if array.representation.name() == Phrases.name() {
        if lock_feet {
            return Err(no_legs(path, "a phrase, which has no body"));
        }
        let phrase = Phrase::new(array.values)?;
        let phrase = Bvh::from_phrase(&phrase, CENTIMETRES).map_err(unusable)?;
        return Ok(phrase.to_text());
    }
    let (joints, skeleton) = array.body()?;
    Ok(bvh_file(out, &joints, &skeleton, lock_feet)?.to_text())
}

/// The figure of rows of a representation; none if a position is not finite.
pub fn of(representation: &dyn Representation, rows: &[f32], name: String) -> Option<SceneObject> {
    let joints = representation.joints(rows)?;
    let fps = representation.fps();
    let curves = representation.curves(rows).into_iter().map(|curves| {
        let series = curves.series.into_iter();
        let single = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect();
        let series = series.map(|(name, values)| (name, single(values)));
        Curves {
            title: curves.title,
            series: series.collect(),
        }
    });
    let curves = curves.collect();
    let Some(skeleton) = representation.skeleton() else {
        let is_phrase = representation.name() == Phrases.name();
        return Some(SceneObject {
            name,
            fps,
            positions: joints.to_f32(),
            joint_names: vec!["root".to_string()],
            parents: vec![None],
            orientations: is_phrase.then(|| orientations(rows)),
            curves,
            ..SceneObject::default()
        });
    };
    let feet = skeleton.contact_joints();
    let parents = skeleton.parents().to_vec();
    let joint_names = skeleton.description().joint_names.clone();
    let shown = body(name, fps, &joints, joint_names, parents, Some(&feet));
    Some(SceneObject { curves, ..shown })
}

/// The curves of a figure, each as a panel.
pub fn curve_panels(figure: &SceneObject) -> impl Iterator<Item = Panel> {
    figure.curves.iter().map(|curves| {
        let series = curves.series.iter().map(|(name, values)| {
            let values = values.iter().map(|&value| value.into()).collect();
            (name.as_str(), values)
        });
        Panel::over_time(curves.title.clone(), figure.fps, series)
    })
}

/// Unit quaternions of phrases; a zero quaternion takes the previous frame's quaternion.
fn orientations(rows: &[f32]) -> Vec<[f32; 4]> {
    let mut last = [1.0, 0.0, 0.0, 0.0];
    let frames = rows.chunks_exact(CHANNELS).map(|frame| {
        let found: [f32; 4] = std::array::from_fn(|i| frame[QUATERNION][i]);
        let norm = found.iter().map(|value| value * value).sum::<f32>().sqrt();
        if norm.is_finite() && norm > 1e-6 {
            last = found.map(|value| value / norm);
        }
        last
    });
    frames.collect()
}

/// Joints of an unknown skeleton.
fn points(places: &Joints, name: String, fps: f64) -> SceneObject {
    let joints = places.joints();
    let joint_names = (0..joints).map(|joint| format!("joint_{joint}")).collect();
    let parents = vec![None; joints];
    body(name, fps, places, joint_names, parents, Some(&[]))
}

/// A goal on the floor.
pub fn floor(goal: &Goal) -> Floor {
    let single = |place: [f64; 2]| place.map(|value| value as f32);
    let path = goal.trajectory.iter().flat_map(|path| &path.points);
    let keyframes = goal.keyframes.iter();
    let keyframes = keyframes.map(|keyframe| (keyframe.frame, single(keyframe.position())));
    let mut floor = Floor {
        path: path.map(|point| single(*point)).collect(),
        keyframes: keyframes.collect(),
        ..Floor::default()
    };
    for obstacle in &goal.obstacles {
        match obstacle {
            &Obstacle::Disc { x, z, radius } => {
                floor.obstacles.push((single([x, z]), radius as f32));
            }
            Obstacle::Polygon { vertices } => {
                let corners = vertices.iter().map(|corner| single(*corner));
                floor.polygons.push(corners.collect());
            }
        }
    }
    floor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_stems_unless_those_are_alike() {
        let paths = |names: [&str; 2]| names.map(PathBuf::from);
        assert_eq!(names(&paths(["x/a.npy", "x/b.raw.npy"])), ["a", "b.raw"]);
        assert_eq!(names(&paths(["x/a.npy", "y/a.npy"])), ["x/a", "y/a"]);
        let of_dataset = paths(["d/motion/one/trajectory.npy", "d/motion/two/trajectory.npy"]);
        assert_eq!(names(&of_dataset), ["one", "two"]);
    }

    #[test]
    fn a_quaternion_of_zeros_keeps_the_orientation_before_it() {
        let mut rows = vec![0.0f32; 2 * CHANNELS];
        rows[QUATERNION.start + 2] = 2.0;
        assert_eq!(orientations(&rows), [[0.0, 0.0, 1.0, 0.0]; 2]);
    }
}
