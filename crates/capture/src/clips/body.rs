//! A captured body: the joints of the skeleton at the capture's own rate, in metres and y-up.

use std::ops::Range;

use kinegrad_motion::humanml::bone_rotations::{Across, forward};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::time_stretch::spline;
use kinegrad_motion::vector::{length, minus, plus};

use super::centres::{Centres, Limb};
use super::map::JointMap;
use crate::plan::Units;
use crate::{Bvh, C3d, UpAxis};

/// Usual length of a leg, hip to ankle, metres.
const LEGS: std::ops::RangeInclusive<f64> = 0.5..=1.1;

/// The units that the length of legs can identify; no two units fit the same leg.
const UNITS: [Units; 5] = [Units::M, Units::Cm, Units::Mm, Units::Inch, Units::Cmu];

/// Largest standard deviation of the length of a limb's bone, as a part of its length. Estimated
/// joint centres are off by 1 to 3 cm, a twelfth of the shortest of these bones.
const MOST_VARIATION: f64 = 0.2;

/// Lowest frame rate of a capture: at lower rates, motion between frames is unknown.
const SLOWEST: f64 = 10.0;

/// The joints of a body over a take.
#[derive(Clone, Debug)]
pub struct Body {
    /// Joint positions, `[frames, J]`, metres, +y up.
    pub joints: Joints,
    /// Frames per second.
    pub rate: f64,
    /// Length of the file's unit, metres.
    pub metres_per_unit: f64,
    /// The axis of the file that points up.
    pub up: UpAxis,
    /// Doubts about the capture, in words.
    pub notes: Vec<String>,
}

impl Body {
    /// The 22 joints of HumanML3D in a BVH capture, by the built-in joint map that fits. By default
    /// `units` follow from the length of the legs, and `up` follows from the place of the head.
    ///
    /// # Errors
    /// If no map fits, the frame rate is below 10, or unit or axis are not found.
    pub fn of_bvh(bvh: &Bvh, units: Option<Units>, up: Option<UpAxis>) -> Result<Self, String> {
        let map = JointMap::fitting(bvh).map_err(|_| "no built-in joint map fits".to_owned())?;
        let places = map.joints_of(bvh)?;
        let skeleton = Skeleton::humanml3d();
        Self::of_places(places, &skeleton, 1.0 / bvh.frame_time(), units, up)
    }

    /// The body of a capture of markers, with estimated joint centres ([`Centres`]). Every marker
    /// must be seen in the frames that are `used`, and limbs must be rigid there.
    pub(super) fn of_markers(
        take: &C3d,
        used: Range<usize>,
        skeleton: &Skeleton,
        rate: f64,
        up: Option<UpAxis>,
    ) -> Result<Self, String> {
        let centres = Centres::of(take, used.clone())?;
        let limbs = centres.limbs(used, skeleton);
        let mean = limbs.iter().map(|limb| limb.deviation).sum::<f64>() / limbs.len() as f64;
        let is_rigid = |limb: &&Limb| limb.variation() <= MOST_VARIATION;
        if let Some(limb) = limbs.iter().find(|limb| !is_rigid(limb)) {
            return Err(format!(
                "the bone to {} is {:.0} cm long and varies by {:.0} % (standard deviation), at most \
                 {:.0} % allowed: a marker jumps, or markers are exchanged; repair the markers, or leave \
                 these frames out",
                limb.end,
                100.0 * limb.mean,
                100.0 * limb.variation(),
                100.0 * MOST_VARIATION
            ));
        }
        let worst = limbs
            .iter()
            .max_by(|a, b| a.deviation.total_cmp(&b.deviation));
        let Limb { end, deviation, .. } = worst.expect("limbs");
        let note = format!(
            "joint centres are estimated from markers, within about 1 to 3 cm: lengths of limb bones \
             vary by {:.1} cm (standard deviation, mean), that to {end} most, by {:.1} cm",
            100.0 * mean,
            100.0 * deviation
        );
        let metres = Some(Units::M);
        let mut body = Self::of_places(centres.joints, skeleton, rate, metres, up)?;
        body.metres_per_unit = take.metres_per_unit;
        body.notes.extend(centres.notes);
        body.notes.push(note);
        Ok(body)
    }

    /// The body with its joints at `places`, `[frames, J]`, in units and axes of a file. By default
    /// `units` follow from the length of the legs, and `up` follows from the place of the head.
    pub(super) fn of_places(
        places: Vec<[f64; 3]>,
        skeleton: &Skeleton,
        rate: f64,
        units: Option<Units>,
        up: Option<UpAxis>,
    ) -> Result<Self, String> {
        if rate < SLOWEST * (1.0 - 1e-4) {
            return Err(format!(
                "it has {rate:.1} frames per second: at least {SLOWEST} are needed; where the file's frame \
                 time is wrong, state `fps`"
            ));
        }
        let raw = Joints::new(places, skeleton.joints()).map_err(|e| e.to_string())?;
        let mut notes = Vec::new();
        let up = match up {
            Some(up) => up,
            None => upward(&raw, skeleton)?,
        };
        let metres_per_unit = match units {
            Some(units) => units.metres(),
            None => {
                let legs = legs(&raw, skeleton);
                let fits = |units: &Units| LEGS.contains(&(units.metres() * legs));
                match UNITS.into_iter().find(fits) {
                    Some(units) => units.metres(),
                    None if legs > 0.0 => {
                        let skeleton = skeleton.description();
                        let rest = |joint: usize| length(skeleton.rest_offsets[joint]);
                        let metres = skeleton.leg_joints.map(rest).iter().sum::<f64>() / legs;
                        notes.push(format!(
                            "the length of its legs, {legs:.3} units, fits no known unit: one unit is \
                             taken as {metres:.5} metres (state `units`)"
                        ));
                        metres
                    }
                    None => return Err("its legs have no length".to_owned()),
                }
            }
        };
        let places = raw.as_slice().iter();
        let places = places.map(|place| up.to_y_up(place.map(|value| value * metres_per_unit)));
        let joints = Joints::new(places.collect(), skeleton.joints()).map_err(|e| e.to_string())?;
        let [left, right] = toes_ahead(&joints, skeleton);
        if left + right < 0.0 {
            let problem = "its toes point backwards: left and right joints are exchanged, in the \
                           map or in the file";
            return Err(problem.to_owned());
        }
        if left.min(right) < 0.0 {
            let side = if left < 0.0 { "left" } else { "right" };
            notes.push(format!(
                "its {side} toes point backwards where the foot stands: is `{side}_foot` of its map right?"
            ));
        }
        Ok(Self {
            joints,
            rate,
            metres_per_unit,
            up,
            notes,
        })
    }

    /// The joints at `fps` frames per second, by cubic splines through the frames of the capture.
    /// Nothing is extrapolated beyond the last frame.
    pub fn at_rate(&self, fps: f64) -> Joints {
        let (frames, count) = (self.joints.frames(), self.joints.joints());
        // Rounding may put the last moment just beyond the end: files have frame times of six
        // digits.
        let last = (frames - 1) as f64;
        let resampled = (last / self.rate * fps + 0.01).floor() as usize + 1;
        let moment = |t: usize| (t as f64 / fps * self.rate).min(last);
        let moments: Vec<f64> = (0..resampled).map(moment).collect();
        let mut places = vec![[0.0; 3]; resampled * count];
        for joint in 0..count {
            let track = self.joints.track(joint);
            for axis in 0..3 {
                let values: Vec<f64> = track.iter().map(|place| place[axis]).collect();
                for (t, value) in spline(&values, &moments).into_iter().enumerate() {
                    places[t * count + joint][axis] = value;
                }
            }
        }
        Joints::new(places, count).expect("splines through finite places")
    }
}

/// The axis along which the head is above the ankles.
fn upward(raw: &Joints, skeleton: &Skeleton) -> Result<UpAxis, String> {
    let [left, _, right, _] = skeleton.contact_joints();
    let head = named(skeleton, "head");
    let mut sum = [0.0; 3];
    for t in 0..raw.frames() {
        let frame = raw.frame(t);
        let ankles = plus(frame[left], frame[right]).map(|value| value / 2.0);
        sum = plus(sum, minus(frame[head], ankles));
    }
    let [x, y, z] = sum;
    let least = x.abs().max(0.5 * length(sum));
    match (y, z) {
        _ if y > least && y > z.abs() => Ok(UpAxis::Y),
        _ if z > least && z > y.abs() => Ok(UpAxis::Z),
        _ => Err("its head is above its feet along neither +y nor +z: state `up`".to_owned()),
    }
}

/// Mean length of both legs in the first frame, hip to knee to ankle.
fn legs(raw: &Joints, skeleton: &Skeleton) -> f64 {
    let frame = raw.frame(0);
    let bone =
        |a: &str, b: &str| length(minus(frame[named(skeleton, a)], frame[named(skeleton, b)]));
    let leg = |side: &str| {
        let [hip, knee, ankle] = ["hip", "knee", "ankle"].map(|joint| format!("{side}_{joint}"));
        bone(&hip, &knee) + bone(&knee, &ankle)
    };
    (leg("left") + leg("right")) / 2.0
}

/// Mean distance of each foot's toes ahead of its ankle, in the direction of hips and shoulders,
/// over the quarter of the frames in which the foot is lowest: a raised foot may trail.
fn toes_ahead(joints: &Joints, skeleton: &Skeleton) -> [f64; 2] {
    let [left_ankle, left_toes, right_ankle, right_toes] = skeleton.contact_joints();
    let of_foot = |(ankle, toes): (usize, usize)| {
        let of_frame = |t: usize| {
            let frame = joints.frame(t);
            let facing = forward(skeleton, frame, Across::Consistent);
            let foot = minus(frame[toes], frame[ankle]);
            let ahead = facing[0] * foot[0] + facing[2] * foot[2];
            (frame[ankle][1], ahead)
        };
        let mut feet: Vec<(f64, f64)> = (0..joints.frames()).map(of_frame).collect();
        feet.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let standing = &feet[..feet.len().div_ceil(4)];
        standing.iter().map(|(_, ahead)| ahead).sum::<f64>() / standing.len() as f64
    };
    [(left_ankle, left_toes), (right_ankle, right_toes)].map(of_foot)
}

fn named(skeleton: &Skeleton, joint: &str) -> usize {
    let names = &skeleton.description().joint_names;
    let place = names.iter().position(|name| name == joint);
    place.expect("a joint of the skeleton")
}
