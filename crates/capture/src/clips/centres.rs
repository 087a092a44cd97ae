//! Joint centres from Plug-in Gait markers; the waist markers may be called `LFWT`, `RFWT`, `LBWT`
//! and `RBWT`.
//!
//! Hips follow the regression of Harrington et al., "Prediction of the hip joint centre in adults,
//! children, and patients with cerebral palsy based on magnetic resonance imaging" (J. Biomech. 40,
//! 2007), whose error is 1 to 2 cm. Knees and ankles lie half a usual width inwards of their
//! markers. Elbows lie inwards across the plane of the bent arm, and shoulders below their markers.
//! These joints may be off by 1 to 3 cm. [`Centres::limbs`] measures a part of the error: the
//! variation of bone lengths.

use std::collections::BTreeSet;
use std::ops::Range;

use kinegrad_motion::humanml::Skeleton;
use kinegrad_settings::counted;
use nalgebra::Vector3;

use crate::C3d;
use crate::error::quote;
use crate::markers::gaps::fill_gaps;

type Place = Vector3<f64>;

/// Longest gap of a marker that is filled by a straight line, in seconds.
const LONGEST_GAP_SECONDS: f64 = 0.1;
/// Metres from the marker at the outer side of a joint to its centre.
const KNEE: f64 = 0.055;
const ANKLE: f64 = 0.04;
const ELBOW: f64 = 0.04;
/// Metres from the marker on a shoulder down to its centre.
const SHOULDER: f64 = 0.045;
/// Sine of the bend from which on the plane of an elbow is well known.
const BENT: f64 = 0.15;

/// The markers that are needed, in pairs.
const MARKERS: [&str; 26] = [
    "LFWT", "RFWT", "LBWT", "RBWT", "LKNE", "RKNE", "LANK", "RANK", "LTOE", "RTOE", "T10", "STRN",
    "C7", "CLAV", "LFHD", "RFHD", "LBHD", "RBHD", "LSHO", "RSHO", "LELB", "RELB", "LWRA", "LWRB",
    "RWRA", "RWRB",
];

/// Most markers of a file in a message.
const OWN: usize = 12;

/// The names of the waist markers in Plug-in Gait.
const WAIST: [&str; 4] = ["LASI", "RASI", "LPSI", "RPSI"];

/// The joints of a take of markers.
#[derive(Clone, Debug)]
pub(super) struct Centres {
    /// `[frames, 22]`, metres, in the axes of the file.
    pub joints: Vec<[f64; 3]>,
    /// Gaps that were filled, in words.
    pub notes: Vec<String>,
}

impl Centres {
    /// The joint centres of each frame. Outside of the `used` frames, an unseen marker has its
    /// place in the nearest frame that shows it.
    pub fn of(take: &C3d, used: Range<usize>) -> Result<Self, String> {
        let mut tracks = Vec::with_capacity(MARKERS.len());
        let (mut lacking, mut several, mut notes) = (Vec::new(), BTreeSet::new(), Vec::new());
        let most = (LONGEST_GAP_SECONDS * take.rate).round() as usize;
        for (index, name) in MARKERS.into_iter().enumerate() {
            let names: Vec<&str> = [name].iter().chain(WAIST.get(index)).copied().collect();
            // Of several names that fit, the first.
            let found = names.iter().rev().map(|name| take.find(name));
            let found = found.max_by_key(|points| (points.len() == 1, points.len()));
            let Some(&[point]) = found.as_deref() else {
                let labels = found
                    .iter()
                    .flatten()
                    .map(|&point| take.labels[point].as_str());
                let subjects = labels.filter_map(|label| Some(label.rsplit_once(':')?.0));
                several.extend(subjects.map(quote));
                lacking.push(names.join(" or "));
                continue;
            };
            let label = &take.labels[point];
            let mut track = take.track(point);
            let gaps = fill_gaps(&mut track, most, label);
            if gaps.filled_frames > 0 {
                let frames = gaps.filled_frames;
                notes.push(format!("{} of {label} filled", counted(frames, "frame")));
            }
            if let Some(frame) = used.clone().find(|&t| track[t].is_none()) {
                return Err(format!(
                    "marker {label} was not seen in frame {frame} (counted from 0) and around it: \
                     leave these frames out, or fill them before"
                ));
            }
            for t in (0..used.start).rev() {
                track[t] = track[t].or(track[t + 1]);
            }
            for t in used.end..track.len() {
                track[t] = track[t].or(track[t - 1]);
            }
            let metres = |place: [f64; 3]| Place::from(place) * take.metres_per_unit;
            tracks.push(track.into_iter().flatten().map(metres).collect::<Vec<_>>());
        }
        if several.len() > 1 {
            let (first, subjects) = (several.len().min(OWN), several.len());
            let names: Vec<String> = several.into_iter().take(first).collect();
            return Err(format!(
                "it has the markers of {subjects} subjects, and one is read: {}: export one subject a \
                 file",
                names.join(", ")
            ));
        }
        if !lacking.is_empty() {
            let (count, all, names) = (lacking.len(), MARKERS.len(), lacking.join(", "));
            let own: Vec<&str> = take.labels.iter().take(OWN).map(String::as_str).collect();
            let more = match take.labels.len() - own.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            return Err(format!(
                "no marker set that is known: it lacks {count} of the {all} markers needed, or has \
                 them several times: {names}; it has {}{more}",
                own.join(", ")
            ));
        }
        let mut joints = Vec::with_capacity(take.frames() * 22);
        for t in 0..take.frames() {
            let markers: Vec<Place> = tracks.iter().map(|track| track[t]).collect();
            joints.extend(centres(&markers).map(<[f64; 3]>::from));
        }
        Ok(Self { joints, notes })
    }

    /// The lengths of the arms' and legs' bones over the `used` frames, each with the bone's end
    /// joint. Bones have constant lengths, so the deviations are errors of joint centres.
    pub fn limbs(&self, used: Range<usize>, skeleton: &Skeleton) -> Vec<Limb> {
        let description = skeleton.description();
        let limbs = ["knee", "ankle", "elbow", "wrist"];
        let bones = (0..skeleton.joints()).filter(|joint| {
            let name = &description.joint_names[*joint];
            limbs.iter().any(|limb| name.ends_with(limb))
        });
        let limb = |end: usize| {
            let start = skeleton.parents()[end].expect("a limb has a parent");
            let frames = self.joints.chunks_exact(skeleton.joints());
            let frames = frames.skip(used.start).take(used.len());
            let bone = |frame: &[[f64; 3]]| Place::from(frame[end]) - Place::from(frame[start]);
            let lengths: Vec<f64> = frames.map(|frame| bone(frame).norm()).collect();
            let count = lengths.len() as f64;
            let mean = lengths.iter().sum::<f64>() / count;
            let squares = lengths.iter().map(|length| (length - mean).powi(2));
            Limb {
                end: description.joint_names[end].clone(),
                mean,
                deviation: (squares.sum::<f64>() / count).sqrt(),
            }
        };
        bones.map(limb).collect()
    }
}

/// The length of a bone over a take.
#[derive(Clone, Debug)]
pub(super) struct Limb {
    /// The joint at its end.
    pub end: String,
    /// Mean length, metres.
    pub mean: f64,
    /// Standard deviation of the length, metres.
    pub deviation: f64,
}

impl Limb {
    /// The deviation as a part of the length.
    pub fn variation(&self) -> f64 {
        self.deviation / self.mean
    }
}

/// The joints of the skeleton in its order, from the markers in the order of [`MARKERS`].
fn centres(markers: &[Place]) -> [Place; 22] {
    let (pairs, _) = markers.as_chunks::<2>();
    let [
        fronts,
        backs,
        knees,
        ankles,
        toes,
        chest,
        neck,
        brow,
        nape,
        shoulders,
        elbows,
        left_wrist,
        right_wrist,
    ] = pairs
    else {
        unreachable!("all markers")
    };
    let middle = |[a, b]: &[Place; 2]| (a + b) / 2.0;
    let (front, back) = (middle(fronts), middle(backs));
    let left = unit((fronts[0] - fronts[1]) + (backs[0] - backs[1]));
    let forward = unit(across(front - back, left));
    let up = forward.cross(&left);
    let (width, depth) = ((fronts[0] - fronts[1]).norm(), (front - back).norm());
    let hip = |side: f64| {
        front - forward * (0.24 * depth + 0.0099) - up * (0.30 * width + 0.0109)
            + left * side * (0.33 * width + 0.0073)
    };
    let pelvis = middle(&[front, back]);
    let leg = |side: f64, knee: &Place, ankle: &Place| {
        let hip = hip(side);
        let inwards = unit(across(left * -side, unit(knee - hip)));
        let knee = knee + inwards * KNEE;
        let ankle = ankle + unit(across(inwards, unit(ankle - knee))) * ANKLE;
        (hip, knee, ankle)
    };
    let (left_hip, left_knee, left_ankle) = leg(1.0, &knees[0], &ankles[0]);
    let (right_hip, right_knee, right_ankle) = leg(-1.0, &knees[1], &ankles[1]);
    let chest = middle(chest);
    let neck = middle(neck);
    let down = unit(chest - neck);
    let head = middle(&[(brow[0] + brow[1] + nape[0] + nape[1]) / 4.0, neck]);
    let arm = |side: f64, shoulder: &Place, elbow: &Place, wrist: Place| {
        let shoulder = shoulder + down * SHOULDER;
        // Perpendicular to the bent arm: towards the body for a left arm, away from the body for a
        // right arm.
        let plane = unit(elbow - shoulder).cross(&unit(wrist - elbow));
        let elbow = elbow + plane * (side * ELBOW / (plane.norm() + BENT));
        (shoulder, elbow, wrist)
    };
    let [left_wrist, right_wrist] = [left_wrist, right_wrist].map(middle);
    let (left_shoulder, left_elbow, left_wrist) = arm(1.0, &shoulders[0], &elbows[0], left_wrist);
    let (right_shoulder, right_elbow, right_wrist) =
        arm(-1.0, &shoulders[1], &elbows[1], right_wrist);
    let collar = |shoulder: &Place| neck * 0.2 + chest * 0.4 + shoulder * 0.4;
    let spine = |part: f64| pelvis + (chest - pelvis) * part;
    [
        pelvis,
        left_hip,
        right_hip,
        spine(0.36),
        left_knee,
        right_knee,
        spine(0.8),
        left_ankle,
        right_ankle,
        chest,
        toes[0],
        toes[1],
        neck,
        collar(&left_shoulder),
        collar(&right_shoulder),
        head,
        left_shoulder,
        right_shoulder,
        left_elbow,
        right_elbow,
        left_wrist,
        right_wrist,
    ]
}

/// The vector with length 1; a zero vector is unchanged.
fn unit(vector: Place) -> Place {
    vector.try_normalize(1e-9).unwrap_or(vector)
}

/// The component of a vector perpendicular to a unit direction.
fn across(vector: Place, direction: Place) -> Place {
    vector - direction * vector.dot(&direction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UpAxis;
    use crate::c3d::tests::writer::Example;
    use crate::clips::body::Body;
    use crate::clips::tests::walking;

    /// The joint next to a marker of the left side, and the marker's offset if the body faces +z,
    /// metres.
    fn marker(name: &str) -> (&'static str, [f64; 3]) {
        match name {
            "FWT" => ("pelvis", [0.12, 0.0, 0.09]),
            "BWT" => ("pelvis", [0.05, 0.0, -0.09]),
            "KNE" => ("left_knee", [KNEE, 0.0, 0.0]),
            "ANK" => ("left_ankle", [ANKLE, 0.0, 0.0]),
            "TOE" => ("left_foot", [0.0; 3]),
            "FHD" => ("head", [0.06, 0.09, 0.14]),
            "BHD" => ("head", [0.06, 0.09, -0.04]),
            "SHO" => ("left_shoulder", [0.0, SHOULDER, 0.0]),
            "ELB" => ("left_elbow", [0.0; 3]),
            "WRA" => ("left_wrist", [0.0, 0.0, 0.03]),
            "WRB" => ("left_wrist", [0.0, 0.0, -0.03]),
            "T10" => ("spine3", [0.0, 0.0, -0.1]),
            "STRN" => ("spine3", [0.0, 0.0, 0.1]),
            "C7" => ("neck", [0.0, 0.0, -0.06]),
            "CLAV" => ("neck", [0.0, 0.0, 0.06]),
            other => panic!("{other}"),
        }
    }

    fn example(frames: usize) -> Example {
        let skeleton = Skeleton::humanml3d();
        let names = &skeleton.description().joint_names;
        let joints = walking(frames, 80.0, 1.0);
        let labels = MARKERS;
        let place = |t: usize, label: &str| {
            let (bare, side) = match (label.strip_prefix('L'), label.strip_prefix('R')) {
                (Some(bare), _) => (bare, 1.0),
                (_, Some(bare)) => (bare, -1.0),
                _ => (label, 1.0),
            };
            let (joint, [x, y, z]) = marker(bare);
            let joint = if side < 0.0 {
                joint.replace("left", "right")
            } else {
                joint.to_owned()
            };
            let at = names
                .iter()
                .position(|name| *name == joint)
                .expect("a joint");
            let [u, v, w] = joints.frame(t)[at];
            // Millimetres, +z up.
            [u + side * x, -(w + z), v + y].map(|metres| (1000.0 * metres) as f32)
        };
        let frame = |t| labels.iter().map(|label| Some(place(t, label))).collect();
        let labels: Vec<String> = labels.iter().map(|label| format!("who:{label}")).collect();
        let labels: Vec<&str> = labels.iter().map(String::as_str).collect();
        Example::new(&labels, (0..frames).map(frame).collect())
    }

    fn body(example: &Example) -> Result<Body, String> {
        let take = C3d::parse(&example.bytes(), "take.c3d").unwrap();
        let used = 0..take.frames();
        Body::of_markers(&take, used, &Skeleton::humanml3d(), take.rate, None)
    }

    #[test]
    fn joint_centres_are_near_the_joints_that_carry_the_markers() {
        let body = body(&example(40)).unwrap();
        assert_eq!((body.up, body.metres_per_unit), (UpAxis::Z, 0.001));
        let known = walking(40, 80.0, 1.0);
        let names = Skeleton::humanml3d().description().joint_names.clone();
        for t in 0..40 {
            for (joint, name) in names.iter().enumerate() {
                let apart =
                    Place::from(body.joints.frame(t)[joint]) - Place::from(known.frame(t)[joint]);
                let most = if name.ends_with("collar") {
                    0.06
                } else {
                    0.045
                };
                assert!(apart.norm() < most, "{name} of frame {t} is {apart:?} off");
            }
        }
        let note = body.notes.last().expect("a note");
        assert!(note.contains("lengths of limb bones vary by"), "{note}");
    }

    #[test]
    fn limbs_that_are_not_rigid_are_refused() {
        let mut example = example(60);
        // The left elbow is at the right one in a third of the frames.
        let at = |name: &str| MARKERS.iter().position(|marker| *marker == name).unwrap();
        for frame in &mut example.frames[20..40] {
            frame[at("LELB")] = frame[at("RELB")];
        }
        let message = body(&example).unwrap_err();
        assert!(message.contains("the bone to left_"), "{message}");
        assert!(message.contains("at most 20 % allowed"), "{message}");
        // Frames that are not used do not count.
        let take = C3d::parse(&example.bytes(), "take.c3d").unwrap();
        let skeleton = Skeleton::humanml3d();
        Body::of_markers(&take, 0..20, &skeleton, take.rate, None).unwrap();
    }

    #[test]
    fn several_subjects_are_named() {
        let mut example = example(10);
        let second = example
            .labels
            .iter()
            .map(|label| label.replace("who:", "other:"));
        let second: Vec<String> = second.collect();
        example.labels.extend(second);
        for frame in &mut example.frames {
            frame.extend_from_within(..);
        }
        let message = body(&example).unwrap_err();
        assert!(message.contains("the markers of 2 subjects"), "{message}");
        assert!(
            message.contains("`other`, `who`: export one subject"),
            "{message}"
        );
    }

    #[test]
    fn markers_that_are_missing_are_named() {
        let whole = example(60);
        let mut other = whole.clone();
        for label in &mut other.labels {
            *label = label.replace("LKNE", "LHIP").replace("T10", "T8");
        }
        let message = body(&other).unwrap_err();
        assert!(
            message.contains("lacks 2 of the 26 markers needed"),
            "{message}"
        );
        assert!(message.contains("LKNE, T10"), "{message}");
        let mut renamed = whole.clone();
        for label in &mut renamed.labels {
            *label = label.replace("LFWT", "LASI");
        }
        assert!(body(&renamed).is_ok());
        let mut gap = whole.clone();
        gap.frames[5][4] = None;
        assert!(body(&gap).unwrap().notes[0].contains("1 frame of who:LKNE filled"));
        for frame in &mut gap.frames[5..30] {
            frame[4] = None;
        }
        let message = body(&gap).unwrap_err();
        assert!(
            message.contains("who:LKNE was not seen in frame 5"),
            "{message}"
        );
        // Unused frames at either end may lack the marker.
        let skeleton = Skeleton::humanml3d();
        for used in [30..60, 0..5] {
            let take = C3d::parse(&gap.bytes(), "take.c3d").unwrap();
            let part = Body::of_markers(&take, used.clone(), &skeleton, take.rate, None).unwrap();
            let all = body(&whole).unwrap();
            for t in used {
                assert_eq!(part.joints.frame(t), all.joints.frame(t));
            }
        }
    }
}
