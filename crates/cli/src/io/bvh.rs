//! Reads BVH files, with a guess of their unit and vertical axis, and writes them in centimeters.

use std::path::Path;

use kinegrad_capture::{Bvh, Units, UpAxis, bare_name, clips};
use kinegrad_data::file::read_file;
use kinegrad_motion::feet::{ContactRule, Planted, lock_joints};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_train::Error;

use super::find::has_extension;
use crate::args::BvhArguments;
use crate::output::unusable;

/// Largest file that is read, bytes.
const LARGEST: u64 = 1 << 30;

/// Height of a person's joints in meters, for guessing the unit.
const PERSON: f64 = 1.6;

/// Units per meter in a written BVH file.
pub const CENTIMETRES: f64 = 100.0;

/// Largest deviation of a BVH file from its motion without a note, meters.
const EXACT: f64 = 1e-3;

/// Largest distance of a locked foot from its place that causes no warning, meters.
pub const LEGS_SHORT: f64 = 0.02;

/// True for the name of a BVH file.
pub fn is_bvh(path: &Path) -> bool {
    has_extension(path, "bvh")
}

/// Reads a BVH file of one figure. Fails if the file cannot be read or is not BVH.
pub fn read_bvh(path: &Path) -> Result<Bvh, Error> {
    let (file, bytes) = read_bytes(path)?;
    let bvh = Bvh::parse(&bytes, &file).map_err(unusable)?;
    tell_notes(&file, &bvh);
    Ok(bvh)
}

/// Reads the figures of a BVH file, one or more. Fails like [`read_bvh`].
pub fn read_figures(path: &Path) -> Result<Vec<Bvh>, Error> {
    let (file, bytes) = read_bytes(path)?;
    let figures = Bvh::parse_figures(&bytes, &file).map_err(unusable)?;
    tell_notes(&file, &figures[0]);
    Ok(figures)
}

fn read_bytes(path: &Path) -> Result<(String, Vec<u8>), Error> {
    let file = path.display().to_string();
    let bytes = read_file(path, LARGEST).map_err(|error| {
        let message = format!("{file} cannot be read: {error}");
        Error::usage(message, "give a BVH file that is there")
    })?;
    Ok((file, bytes))
}

fn tell_notes(file: &str, bvh: &Bvh) {
    for note in bvh.notes() {
        tell!("note: {file}: {note}");
    }
}

/// The body of a BVH file as joints of the HumanML3D skeleton ([`clips::read_body`]); prints notes.
pub fn read_body(path: &Path, reading: &BvhReading, retarget: bool) -> Result<Joints, Error> {
    let file = path.display().to_string();
    let body = clips::read_body(&read_bvh(path)?, &file, reading.units, reading.up, retarget);
    let (joints, notes) = body.map_err(unusable)?;
    for note in notes {
        tell!("note: {file}: {note}");
    }
    Ok(joints)
}

/// How a motion file is read: the unit and vertical axis of BVH files, where absent values are
/// guessed from the body; and the motion.
#[derive(Clone, Copy, Debug, Default)]
pub struct BvhReading {
    /// Length of a unit.
    pub units: Option<Units>,
    /// Axis that points up.
    pub up: Option<UpAxis>,
    /// Number of the motion in a file of several.
    pub index: Option<usize>,
    /// Frames per second of an array.
    pub fps: Option<f64>,
}

impl BvhReading {
    /// The options of the command line.
    pub fn of(arguments: &BvhArguments) -> Self {
        Self {
            units: arguments.units,
            up: arguments.up,
            index: arguments.index,
            fps: arguments.fps,
        }
    }

    /// Refuses options that BVH files make superfluous.
    pub fn must_suit_bvh(&self, path: &Path) -> Result<(), Error> {
        let (path, hint) = (path.display(), "leave it out");
        if let Some(index) = self.index.filter(|index| *index > 0) {
            let message = format!("option `index {index}`, and {path} has one motion");
            return Err(Error::usage(message, hint));
        }
        if let Some(fps) = self.fps {
            let message = format!("option `fps {fps}`, and {path} has its own rate");
            return Err(Error::usage(message, hint));
        }
        Ok(())
    }
}

/// A BVH file, its unit in meters, and its vertical axis.
pub struct Capture {
    /// The motion in the file's own units and axes.
    pub bvh: Bvh,
    /// Length of the file's unit, meters.
    pub metres: f64,
    /// The axis that points up.
    pub up: UpAxis,
}

impl Capture {
    /// Reads a BVH file. Prints its unit and its vertical axis unless both are given.
    pub fn read(path: &Path, reading: &BvhReading) -> Result<Self, Error> {
        Ok(Self::of(read_bvh(path)?, path, reading))
    }

    /// Reads the figures of a BVH file, all in the unit and axis of the first.
    pub fn read_figures(path: &Path, reading: &BvhReading) -> Result<Vec<Self>, Error> {
        let mut figures = read_figures(path)?.into_iter();
        let first = figures.next().expect("one figure or more");
        let first = Self::of(first, path, reading);
        let (metres, up) = (first.metres, first.up);
        let others = figures.map(|bvh| Self { bvh, metres, up });
        Ok(std::iter::once(first).chain(others).collect())
    }

    /// A file that was read.
    fn of(bvh: Bvh, path: &Path, reading: &BvhReading) -> Self {
        let (metres, up) = unit_and_axis(&bvh, reading.units, reading.up);
        if reading.units.is_none() || reading.up.is_none() {
            let axis = if up == UpAxis::Y { "y" } else { "z" };
            tell!(
                "note: {} is read in {} with {axis} up; set `--units` and `--up` to change that",
                path.display(),
                in_words(metres)
            );
        }
        Self { bvh, metres, up }
    }

    /// Joint positions in meters with +y up.
    pub fn joints(&self) -> Result<Joints, Error> {
        let world = (0..self.bvh.frames()).flat_map(|t| self.bvh.world(t));
        let metres = |place: [f64; 3]| self.up.to_y_up(place.map(|value| value * self.metres));
        let places = world.map(|pose| metres(pose.position));
        Ok(Joints::new(places.collect(), self.bvh.joints().len())?)
    }

    /// The same motion in centimeters with +y up.
    pub fn in_centimetres(&self) -> Result<Bvh, Error> {
        self.converted(CENTIMETRES)
    }

    /// The same motion in metres with +y up.
    pub fn in_metres(&self) -> Result<Bvh, Error> {
        self.converted(1.0)
    }

    fn converted(&self, units_per_metre: f64) -> Result<Bvh, Error> {
        let converted = self.bvh.converted(units_per_metre * self.metres, self.up);
        converted.map_err(unusable)
    }
}

/// Joint positions as the text of a BVH file, in centimeters.
///
/// # Errors
/// If the positions cannot be written as BVH.
pub fn bvh_text(joints: &Joints, skeleton: &Skeleton) -> Result<String, Error> {
    Ok(as_bvh(joints, skeleton)?.to_text())
}

/// Joint positions as BVH, in centimeters.
pub fn as_bvh(joints: &Joints, skeleton: &Skeleton) -> Result<Bvh, Error> {
    Bvh::from_joints(joints, skeleton, CENTIMETRES).map_err(unusable)
}

/// Joint positions as the BVH file `path`, in centimeters; prints the file's deviation from the
/// positions. `lock_feet` locks standing feet.
pub fn bvh_file(
    path: &Path,
    joints: &Joints,
    skeleton: &Skeleton,
    lock_feet: bool,
) -> Result<Bvh, Error> {
    let bvh = as_bvh(joints, skeleton)?;
    note_deviation(path, &bvh, joints, skeleton);
    match lock_feet {
        true => with_locked_feet(path, &bvh, joints, skeleton),
        false => Ok(bvh),
    }
}

/// Prints a note if a BVH file deviates noticeably from its motion.
fn note_deviation(path: &Path, bvh: &Bvh, joints: &Joints, skeleton: &Skeleton) {
    let deviation = bvh.deviation(joints, skeleton, CENTIMETRES);
    if let Some(worst) = deviation.filter(|worst| worst.metres > EXACT) {
        tell!(
            "note: {}: joints are up to {:.3} m from the motion's (`{}` in frame {}), because its bones \
             change their lengths and those of BVH cannot; `kinegrad view MOTION.npy --glb FILE.glb` \
             is exact",
            path.display(),
            worst.metres,
            worst.joint,
            worst.frame
        );
    }
}

/// `bvh`, made from `joints` for the file `path`, with locked feet; prints the sliding speeds.
fn with_locked_feet(
    path: &Path,
    bvh: &Bvh,
    joints: &Joints,
    skeleton: &Skeleton,
) -> Result<Bvh, Error> {
    // BVH has constant bone lengths: feet locked before the conversion would slide again.
    let rigid = bvh.joints_of(skeleton, CENTIMETRES);
    let rigid = rigid.expect("a file of these joints");
    let locked = lock_joints(
        &rigid,
        joints,
        skeleton,
        &ContactRule::default(),
        Planted::Still,
        0.0,
    )?;
    let missed = Some(locked.missed).filter(|missed| *missed > LEGS_SHORT);
    let short = missed.map(|missed| {
        format!("; feet slide by up to {missed:.2} m in a contact, because the legs do not reach")
    });
    let short = short.unwrap_or_default();
    tell!(
        "note: {}: feet stand in {:.0} % of the frames and slid by {:.2} m/s meanwhile, now by {:.2} \
         m/s{short}",
        path.display(),
        100.0 * locked.in_contact,
        locked.before,
        locked.after
    );
    as_bvh(&locked.joints, skeleton)
}

/// The unit of a BVH file, metres, and the axis that points up. What is not given is that of
/// [`clips::Body`] if the joints are known, else a guess.
pub fn unit_and_axis(bvh: &Bvh, units: Option<Units>, up: Option<UpAxis>) -> (f64, UpAxis) {
    if let Ok(body) = clips::Body::of_bvh(bvh, units, up) {
        return (body.metres_per_unit, body.up);
    }
    let up = up.unwrap_or_else(|| guess_up(bvh));
    let units = units.unwrap_or_else(|| guess_units(bvh, up));
    (units.metres(), up)
}

/// The axis along which feet are further below the median joint; y if no joint has a foot's name.
/// The root counts only towards the median, because some files leave it at the origin.
fn guess_up(bvh: &Bvh) -> UpAxis {
    up_of(&names(bvh), &first_frame(bvh))
}

fn up_of(names: &[String], places: &[[f64; 3]]) -> UpAxis {
    let feet = names.iter().zip(places).filter(|(name, _)| is_foot(name));
    let middle = |axis: usize| {
        let mut along: Vec<f64> = places.iter().map(|place| place[axis]).collect();
        along.sort_by(f64::total_cmp);
        along[along.len() / 2]
    };
    let drop = |axis: usize| {
        let drops = feet.clone().map(|(_, place)| middle(axis) - place[axis]);
        drops.sum::<f64>()
    };
    let is_z = drop(2) > 1.5 * drop(1).max(0.0) && drop(2) > 0.0;
    if is_z { UpAxis::Z } else { UpAxis::Y }
}

/// The unit in which the body's height is nearest to a person's. The ground is at 0, or at a lower
/// lowest joint.
fn guess_units(bvh: &Bvh, up: UpAxis) -> Units {
    units_of(&first_frame(bvh), up)
}

fn units_of(places: &[[f64; 3]], up: UpAxis) -> Units {
    let heights = || places.iter().map(|place| up.to_y_up(*place)[1]);
    let tall = heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(0.0, f64::min);
    let off = |units: &Units| (tall * units.metres() / PERSON).ln().abs();
    let known = [Units::Cm, Units::M, Units::Mm, Units::Inch, Units::Cmu];
    let best = known.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)));
    let best = best.filter(|units| off(units).is_finite());
    best.unwrap_or_default()
}

/// A unit of so many meters.
fn in_words(metres: f64) -> String {
    let known = [
        (Units::M, "metres"),
        (Units::Cm, "centimetres"),
        (Units::Mm, "millimetres"),
        (Units::Inch, "inches"),
        (Units::Cmu, "units of the CMU database"),
    ];
    let name = known.iter().find(|(units, _)| units.metres() == metres);
    match name {
        Some((_, name)) => (*name).to_owned(),
        None => format!("units of {metres:.5} m"),
    }
}

/// True for the name of a foot or toe joint that is not an end effector.
pub fn is_foot(name: &str) -> bool {
    let name = bare_name(name).to_lowercase();
    (name.contains("foot") || name.contains("toe")) && !name.ends_with("end")
}

/// Names of the joints.
pub fn names(bvh: &Bvh) -> Vec<String> {
    let joints = bvh.joints().iter();
    joints.map(|joint| joint.name.clone()).collect()
}

fn first_frame(bvh: &Bvh) -> Vec<[f64; 3]> {
    let world = bvh.world(0).into_iter();
    world.map(|pose| pose.position).collect()
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
                assert_eq!(up_of(&names, &places), up);
                assert_eq!(units_of(&places, up), units);
            }
        }
        // A root at the origin, far from the body.
        let mut afar = standing(100.0, 1);
        afar.iter_mut().for_each(|place| place[2] -= 400.0);
        afar.insert(0, [0.0; 3]);
        let named: Vec<String> = ["Root".to_string()].into_iter().chain(names).collect();
        assert_eq!(up_of(&named, &afar), UpAxis::Y);
        assert_eq!(units_of(&[[0.0; 3]], UpAxis::Y), Units::Cm);
        // Hips and head alone, in centimeters.
        let bust = [[0.0, 90.0, 0.0], [0.0, 102.0, 0.0]];
        assert_eq!(units_of(&bust, UpAxis::Y), Units::Cm);
        // The hips are at the origin, and the feet below.
        let hung = [[0.0; 3], [0.0, 24.0, 0.0], [0.0, -37.0, 0.0]];
        assert_eq!(units_of(&hung, UpAxis::Y), Units::Inch);
    }

    #[test]
    fn feet_are_known_by_their_names() {
        for (name, is) in [
            ("left_foot", true),
            ("RightToeBase", true),
            ("LeftToe_End", false),
            ("Hips", false),
        ] {
            assert_eq!(is_foot(name), is, "{name}");
        }
    }
}
