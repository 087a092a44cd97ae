//! BVH files as figures, with a guess of their units and of the axis that points up.

use std::path::Path;

use kinegrad_capture::prepare::Units;
use kinegrad_capture::{Bvh, UpAxis};
use kinegrad_data::file::read_file;
use kinegrad_data::read_array;
use kinegrad_motion::humanml::Joints;
use kinegrad_motion::{Motion, Phrases, Representation};
use kinegrad_report::scene::Figure;
use kinegrad_train::Error;
use kinegrad_train::systems::Systems;

use super::{Reading, body, is_bvh, not_finite};
use crate::commands::files::{self, CENTIMETRES};
use crate::output::unusable;

/// Largest file that is read, bytes.
const LARGEST: u64 = 1 << 30;

/// Height of a person's joints, metres: what the unit is guessed by.
const PERSON: f64 = 1.6;

/// A BVH file, the metres of its unit, and its vertical.
struct Capture {
    bvh: Bvh,
    metres: f64,
    up: UpAxis,
}

/// Reads a BVH file; says how it is understood where that is a guess.
fn open(path: &Path, reading: &Reading) -> Result<Capture, Error> {
    let bytes = read_file(path, LARGEST).map_err(Error::io("read", path))?;
    let bvh = Bvh::parse(&bytes, &path.display().to_string()).map_err(unusable)?;
    let first = bvh.world(0).into_iter().map(|pose| pose.position);
    let first: Vec<[f64; 3]> = first.collect();
    let up = reading.up.unwrap_or_else(|| guess_up(&names(&bvh), &first));
    let units = reading.units.unwrap_or_else(|| guess_units(&first, up));
    if reading.units.is_none() || reading.up.is_none() {
        let axis = if up == UpAxis::Y { "y" } else { "z" };
        tell!(
            "note: {} is read in {} with {axis} up; `--units` and `--up` say otherwise",
            path.display(),
            in_words(units)
        );
    }
    let metres = units.metres();
    Ok(Capture { bvh, metres, up })
}

fn names(bvh: &Bvh) -> Vec<String> {
    let joints = bvh.joints().iter();
    joints.map(|joint| joint.name.clone()).collect()
}

/// The figure of a BVH file.
pub fn figure(path: &Path, name: String, reading: &Reading) -> Result<Figure, Error> {
    let Capture { bvh, metres, up } = open(path, reading)?;
    let places = (0..bvh.frames()).flat_map(|t| bvh.world(t));
    let places = places.map(|pose| up.to_y_up(pose.position.map(|value| value * metres)));
    let joints = Joints::new(places.collect(), bvh.joints().len())?;
    let parents = bvh.joints().iter().map(|joint| joint.parent).collect();
    let fps = 1.0 / bvh.frame_time();
    Ok(body(name, fps, &joints, names(&bvh), parents, None))
}

/// A motion as BVH in centimetres with +y up, which will be at `out`: what it cannot hold is said.
/// With `lock_feet`, feet are held where they stand.
///
/// # Errors
/// If it cannot be read, or its skeleton is not known; or if feet are to be held that are not joints
/// of a known skeleton.
pub fn as_bvh(
    systems: Systems<'_>,
    path: &Path,
    reading: &Reading,
    out: &Path,
    lock_feet: bool,
) -> Result<Bvh, Error> {
    let no_legs = |what: &str| {
        Error::usage(
            format!("{}: `--lock-feet` with {what}", path.display()),
            "leave it out: joint features and joint positions of 22 or 21 joints have legs that are \
             known",
        )
    };
    if lock_feet && is_bvh(path) {
        return Err(no_legs("a BVH file"));
    }
    if is_bvh(path) {
        let Capture { bvh, metres, up } = open(path, reading)?;
        return bvh.converted(CENTIMETRES * metres, up).map_err(unusable);
    }
    let array = read_array(path)?;
    let representation = systems.representation_of(path, &array.shape, &array.values)?;
    if representation.name() == Phrases.name() {
        if lock_feet {
            return Err(no_legs("a phrase, which has no body"));
        }
        let phrase = Motion::new(array.values)?;
        return Bvh::from_phrase(&phrase, CENTIMETRES).map_err(unusable);
    }
    match (
        representation.joints(&array.values),
        representation.skeleton(),
    ) {
        (Some(joints), Some(skeleton)) => {
            let bvh = files::bvh(&joints, skeleton)?;
            files::note_deviation(out, &bvh, &joints, skeleton);
            match lock_feet {
                true => files::with_locked_feet(out, &bvh, &joints, skeleton),
                false => Ok(bvh),
            }
        }
        (None, _) => Err(not_finite(path)),
        (_, None) => Err(Error::usage(
            format!(
                "{}: a {} has no skeleton",
                path.display(),
                representation.name()
            ),
            "phrases, joint features and joint positions of 22 or 21 joints are written as BVH",
        )),
    }
}

/// The axis along which feet are further below the body's middle; y where no joint is named as a
/// foot. The root is no measure: some files leave it at the origin.
pub fn guess_up(names: &[String], places: &[[f64; 3]]) -> UpAxis {
    let feet = names
        .iter()
        .zip(places)
        .filter(|(name, _)| body::is_foot(name));
    let middle = |axis: usize| {
        let mut along: Vec<f64> = places.iter().map(|place| place[axis]).collect();
        along.sort_by(f64::total_cmp);
        along[along.len() / 2]
    };
    let drop = |axis: usize| {
        feet.clone()
            .map(|(_, place)| middle(axis) - place[axis])
            .sum::<f64>()
    };
    match drop(2) > 1.5 * drop(1).max(0.0) && drop(2) > 0.0 {
        true => UpAxis::Z,
        false => UpAxis::Y,
    }
}

/// The unit in which the figure is most nearly as tall as a person. It stands on the ground, at 0,
/// unless it reaches below: one without legs is as tall as it reaches above.
pub fn guess_units(places: &[[f64; 3]], up: UpAxis) -> Units {
    let heights = || places.iter().map(|place| up.to_y_up(*place)[1]);
    let tall = heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(0.0, f64::min);
    let off = |units: &Units| (tall * units.metres() / PERSON).ln().abs();
    let known = [Units::Cm, Units::M, Units::Mm, Units::Inch, Units::Cmu];
    let best = known.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)));
    best.filter(|units| off(units).is_finite())
        .unwrap_or_default()
}

fn in_words(units: Units) -> &'static str {
    match units {
        Units::M => "metres",
        Units::Cm => "centimetres",
        Units::Mm => "millimetres",
        Units::Inch => "inches",
        Units::Cmu => "units of the CMU database",
        Units::Metres(_) => "the given unit",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_and_axis_are_those_of_a_person() {
        let names = ["Hips", "Head", "LeftFoot", "RightFoot"].map(String::from);
        let standing = |scale: f64, up: usize| -> Vec<[f64; 3]> {
            let heights = [0.95, 1.6, 0.05, 0.08];
            let place = |height: f64| {
                let mut place = [0.3 * scale; 3];
                place[up] = height * scale;
                place
            };
            heights.map(place).to_vec()
        };
        for units in [Units::M, Units::Cm, Units::Mm, Units::Inch, Units::Cmu] {
            for (axis, up) in [(1, UpAxis::Y), (2, UpAxis::Z)] {
                let places = standing(1.0 / units.metres(), axis);
                assert_eq!(guess_up(&names, &places), up);
                assert_eq!(guess_units(&places, up), units);
            }
        }
        // A root at the origin, far from the body.
        let mut afar = standing(100.0, 1);
        afar.iter_mut().for_each(|place| place[2] -= 400.0);
        afar.insert(0, [0.0; 3]);
        let named: Vec<String> = ["Root".to_string()].into_iter().chain(names).collect();
        assert_eq!(guess_up(&named, &afar), UpAxis::Y);
        assert_eq!(guess_units(&[[0.0; 3]], UpAxis::Y), Units::Cm);
        // Hips and head alone, in centimetres.
        let bust = [[0.0, 90.0, 0.0], [0.0, 102.0, 0.0]];
        assert_eq!(guess_units(&bust, UpAxis::Y), Units::Cm);
        // The hips are the origin, and feet are below.
        let hung = [[0.0; 3], [0.0, 24.0, 0.0], [0.0, -37.0, 0.0]];
        assert_eq!(guess_units(&hung, UpAxis::Y), Units::Inch);
    }
}
