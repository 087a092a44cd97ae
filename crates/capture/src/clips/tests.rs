//! Bodies of small captures that are written here.

use std::fs;
use std::path::PathBuf;

use kinegrad_data::humanml::{FEATURES, parse_features, read_labels};
use kinegrad_data::{Store, StoreConfig};
use kinegrad_motion::Quaternion;
use kinegrad_motion::humanml::walk::{self, Course};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::vector::length;

use super::body::Body;
use super::map::JointMap;
use super::*;
use crate::{Bvh, UpAxis};

/// Stops nothing.
struct Unwatched;

impl PrepareObserver for Unwatched {
    fn done(&self, _takes: usize, _total: usize) {}

    fn stop_requested(&self) -> bool {
        false
    }
}

/// A walk along +z at `speed` metres per second, `[frames, 22]` at `rate` frames per second.
pub(super) fn walking(frames: usize, rate: f64, speed: f64) -> Joints {
    let skeleton = Skeleton::humanml3d();
    let fps = skeleton.description().fps;
    let course = Course {
        speed: Box::new(move |_| speed * fps / rate),
        turning: Box::new(|_| 0.0),
    };
    Joints::new(walk::joints(&course, &skeleton, frames), 22).unwrap()
}

/// The name of a skeleton joint in the captures of a map.
fn named_as(map: &str, joint: &str) -> String {
    let text = match map {
        "mixamo" => include_str!("maps/mixamo.toml"),
        "xsens" => include_str!("maps/xsens.toml"),
        _ => panic!("a map without joints between others"),
    };
    let line = text
        .lines()
        .find(|line| line.starts_with(&format!("{joint} = ")));
    let name = line.and_then(|line| line.split('"').nth(1));
    name.expect("a joint of the map").to_owned()
}

/// The BVH text of joints, in centimetres, with the names of the captures of `map`, at `rate` frames
/// per second.
pub(super) fn capture(joints: &Joints, map: &str, rate: f64) -> String {
    let skeleton = Skeleton::humanml3d();
    let text = Bvh::from_joints(joints, &skeleton, 100.0)
        .unwrap()
        .to_text();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for line in &mut lines {
        for joint in &skeleton.description().joint_names {
            for keyword in ["JOINT", "ROOT"] {
                if line.trim() == format!("{keyword} {joint}") {
                    *line = line.replace(joint.as_str(), &format!("rig:{}", named_as(map, joint)));
                }
            }
        }
        if line.starts_with("Frame Time:") {
            *line = format!("Frame Time: {}", 1.0 / rate);
        }
    }
    lines.join("\n") + "\n"
}

pub(super) fn body_of(text: &str, map: &JointMap) -> Result<Body, String> {
    let bvh = Bvh::parse(text.as_bytes(), "take.bvh").unwrap();
    let rate = 1.0 / bvh.frame_time();
    let places = map.joints_of(&bvh)?;
    Body::of_places(places, &Skeleton::humanml3d(), rate, None, None)
}

#[test]
fn a_single_capture_gives_the_joints_of_its_body() {
    let joints = walking(31, 20.0, 1.2);
    // Half a metre above the floor.
    let raised = joints.as_slice().iter().map(|[x, y, z]| [*x, y + 0.5, *z]);
    let raised = Joints::new(raised.collect(), 22).unwrap();
    let text = capture(&raised, "mixamo", 20.0);
    let bvh = Bvh::parse(text.as_bytes(), "take.bvh").unwrap();
    for retarget in [false, true] {
        let (found, notes) = read_body(&bvh, "take.bvh", None, None, retarget).unwrap();
        assert_eq!((found.frames(), notes.len()), (31, 0));
        for t in 0..31 {
            for (a, b) in found.frame(t).iter().zip(joints.frame(t)) {
                let apart = length([0, 1, 2].map(|axis| a[axis] - b[axis]));
                assert!(apart < 0.03, "frame {t}: {apart} m");
            }
        }
    }
    let crab = text.replace("LeftLeg", "Claw");
    let crab = Bvh::parse(crab.as_bytes(), "take.bvh").unwrap();
    let message = read_body(&crab, "crab.bvh", None, None, false)
        .unwrap_err()
        .to_string();
    assert!(
        message.starts_with("crab.bvh: no built-in joint map fits"),
        "{message}"
    );
}

#[test]
fn a_body_is_where_its_joints_were_with_unit_and_axis_found() {
    let joints = walking(31, 30.0, 1.2);
    for map in ["mixamo", "xsens"] {
        let text = capture(&joints, map, 30.0);
        let bvh = Bvh::parse(text.as_bytes(), "take.bvh").unwrap();
        let found = JointMap::fitting(&bvh).unwrap();
        assert_eq!(found.name, map);
        // The file in inches and with +z up is the same body.
        let inches = bvh.converted(1.0 / 2.54, UpAxis::Y).unwrap();
        for (bvh, metres) in [(&bvh, 0.01), (&inches, 0.0254)] {
            let places = found.joints_of(bvh).unwrap();
            let skeleton = Skeleton::humanml3d();
            let body = Body::of_places(places, &skeleton, 30.0, None, None).unwrap();
            assert_eq!((body.metres_per_unit, body.up), (metres, UpAxis::Y));
            assert_eq!(body.notes, Vec::<String>::new());
            for t in 0..31 {
                for (a, b) in body.joints.frame(t).iter().zip(joints.frame(t)) {
                    let apart = length([0, 1, 2].map(|axis| a[axis] - b[axis]));
                    assert!(apart < 1e-3, "{map}, frame {t}: {apart} m");
                }
            }
        }
    }
}

#[test]
fn the_axis_that_points_up_is_where_the_head_is() {
    let text = capture(&walking(12, 30.0, 1.0), "mixamo", 30.0);
    let turned = |turn: Quaternion| {
        // A joint above the root turns the whole body.
        let frames = text.split_once("MOTION").unwrap().1;
        let [x, y, z] = turn.to_rotation_vector().map(f64::to_degrees);
        let frames: Vec<String> = frames
            .lines()
            .enumerate()
            .map(|(line, text)| match line > 2 && !text.is_empty() {
                true => format!("{x} {y} {z} {text}"),
                false => text.to_owned(),
            })
            .collect();
        let body = text
            .split_once("MOTION")
            .unwrap()
            .0
            .replace("HIERARCHY", "");
        let body = body.replace("ROOT", "JOINT");
        format!(
            "HIERARCHY\nROOT all\n{{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation \
             Zrotation\n{body}\n}}\nMOTION{}\n",
            frames.join("\n")
        )
    };
    let map = JointMap::built_in("mixamo").unwrap();
    let quarter = std::f64::consts::FRAC_PI_2;
    let z_up = turned(Quaternion::from_rotation_vector([quarter, 0.0, 0.0]));
    let body = body_of(&z_up, &map).unwrap();
    assert_eq!(body.up, UpAxis::Z);
    let y_up = body_of(&turned(Quaternion::IDENTITY), &map).unwrap();
    for (a, b) in body.joints.as_slice().iter().zip(y_up.joints.as_slice()) {
        let apart = length([0, 1, 2].map(|axis| a[axis] - b[axis]));
        assert!(apart < 1e-3, "{apart}");
    }
    let down = turned(Quaternion::from_rotation_vector([2.0 * quarter, 0.0, 0.0]));
    assert!(body_of(&down, &map).unwrap_err().contains("state `up`"));
}

#[test]
fn legs_of_no_known_unit_are_taken_for_usual_ones() {
    let text = capture(&walking(12, 30.0, 1.0), "mixamo", 30.0);
    let bvh = Bvh::parse(text.as_bytes(), "take.bvh").unwrap();
    let map = JointMap::built_in("mixamo").unwrap();
    let odd = bvh.converted(2.0, UpAxis::Y).unwrap();
    let skeleton = Skeleton::humanml3d();
    let body = Body::of_places(map.joints_of(&odd).unwrap(), &skeleton, 30.0, None, None).unwrap();
    assert!((body.metres_per_unit - 0.005).abs() < 1e-5);
    assert!(body.notes[0].contains("state `units`"), "{:?}", body.notes);
    let stated = Some(crate::Units::Cm);
    let body =
        Body::of_places(map.joints_of(&odd).unwrap(), &skeleton, 30.0, stated, None).unwrap();
    assert_eq!((body.metres_per_unit, body.notes.len()), (0.01, 0));
}

#[test]
fn what_lacks_joints_or_has_its_sides_exchanged_is_refused() {
    let joints = walking(12, 30.0, 1.0);
    let text = capture(&joints, "mixamo", 30.0);
    let crab = text
        .replace("LeftLeg", "Claw1")
        .replace("RightLeg", "Claw2");
    let bvh = Bvh::parse(crab.as_bytes(), "crab.bvh").unwrap();
    let message = JointMap::fitting(&bvh).unwrap_err();
    for part in [
        "lacks 2 of the 22 joints of `mixamo`",
        "LeftLeg (left_knee)",
        "RightLeg",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let stated = JointMap::built_in("mixamo").unwrap();
    assert!(
        stated
            .joints_of(&bvh)
            .unwrap_err()
            .contains("LeftLeg (left_knee)")
    );
    let exchanged = text
        .replace("rig:Left", "rig:Middle")
        .replace("rig:Right", "rig:Left")
        .replace("rig:Middle", "rig:Right");
    let message = body_of(&exchanged, &stated).unwrap_err();
    assert!(message.contains("toes point backwards"), "{message}");
    let slow = capture(&joints, "mixamo", 1.0);
    let message = body_of(&slow, &stated).unwrap_err();
    assert!(message.contains("state `fps`"), "{message}");
}

#[test]
fn another_rate_keeps_the_motion() {
    let map = JointMap::built_in("mixamo").unwrap();
    let body = body_of(&capture(&walking(61, 30.0, 1.3), "mixamo", 30.0), &map).unwrap();
    let resampled = body.at_rate(20.0);
    assert_eq!(resampled.frames(), 41);
    let apart = |a: [f64; 3], b: [f64; 3]| length([0, 1, 2].map(|axis| a[axis] - b[axis]));
    let mut furthest = 0.0f64;
    for t in 0..41usize {
        // Every second frame is a capture frame; the others lie midway between two capture frames.
        let (before, after) = (3 * t / 2, (3 * t).div_ceil(2));
        for joint in 0..22 {
            let [a, b] = [before, after].map(|frame| body.joints.frame(frame)[joint]);
            let middle = [0, 1, 2].map(|axis| (a[axis] + b[axis]) / 2.0);
            let found = apart(resampled.frame(t)[joint], middle);
            assert!(
                found < if t % 2 == 0 { 1e-9 } else { 0.01 },
                "{t} {joint}: {found}"
            );
            furthest = furthest.max(found);
        }
    }
    // These frames are not simply midpoints: the path is curved.
    assert!(furthest > 1e-4, "{furthest}");
    // Files state their frame time with about six digits.
    for rate in [1.0 / 0.0333333, 1.0 / 0.033333] {
        let rounded = Body {
            rate,
            ..body.clone()
        };
        assert_eq!(rounded.at_rate(20.0).frames(), 41);
    }
}

/// A folder with captures and a plan.
struct Captures {
    folder: tempfile::TempDir,
}

impl Captures {
    /// Walks of 3 seconds, `walk_happy_001` to `_005`, and one of 1.5 seconds.
    fn new() -> Self {
        let captures = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        for take in 1..=5 {
            let joints = walking(91, 30.0, 1.0 + 0.1 * f64::from(take));
            let name = format!("a_walk-left_happy_{take:03}.bvh");
            captures.write(&name, &capture(&joints, "mixamo", 30.0));
        }
        let short = walking(46, 30.0, 1.0);
        captures.write("a_walk-left_sad_001.bvh", &capture(&short, "mixamo", 30.0));
        captures
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn prepare(&self, plan: &str) -> Result<ClipsReport, Error> {
        self.write("plan.toml", plan);
        let path = self.path("plan.toml");
        let plan = Plan::read(&path)?;
        assert!(plan.is_of_clips());
        let report = super::prepare(&plan, &path, PrepareOptions::default(), &Unwatched)?;
        Ok(report.expect("nobody stopped it"))
    }

    fn refused(&self, plan: &str) -> String {
        self.write("plan.toml", plan);
        let path = self.path("plan.toml");
        let options = PrepareOptions::default();
        let made = Plan::read(&path)
            .and_then(|plan| super::prepare(&plan, &path, options, &Unwatched).map(|_| ()));
        made.unwrap_err().to_string()
    }
}

const PLAN: &str = "output = \"set\"\n\
    [split]\nfraction = 0.2\ntest_fraction = 0.2\n\
    [captions]\ntemplates = [\"a person {content} {style}\"]\n\
    words.content = { walk-left = [\"walks to the left\", \"goes left\"] }\n\
    words.style = { happy = \"happily\" }\n\
    [[capture]]\nmotion = \"*.bvh\"\nlabels.name = \"*_{content}_{style}_{take}\"\n";

#[test]
fn captures_become_clips_with_captions_lists_and_labels() {
    let captures = Captures::new();
    let report = captures.prepare(PLAN).unwrap();
    // 91 frames at 30 a second are 61 at 20, of which 60 have a next frame.
    assert_eq!(report.clips, 10);
    let short = report.takes.iter().find(|take| take.clips == 0).unwrap();
    assert_eq!(
        (short.name.as_str(), &short.failure),
        ("a_walk-left_sad_001", &None)
    );
    assert!(
        short.skipped[0].reason.contains("30 frames (1.50 s)"),
        "{short:?}"
    );
    let set = captures.path("set");
    let list = |name: &str| fs::read_to_string(set.join(name)).unwrap();
    assert_eq!(
        list("test.txt"),
        "Ma_walk-left_happy_005_00000\na_walk-left_happy_005_00000\n"
    );
    assert_eq!(
        list("val.txt"),
        "Ma_walk-left_happy_004_00000\na_walk-left_happy_004_00000\n"
    );
    assert_eq!(list("train.txt").lines().count(), 6);
    assert_eq!(
        list("texts/a_walk-left_happy_001_00000.txt")
            .lines()
            .collect::<Vec<_>>(),
        [
            "a person walks to the left happily#a/OTHER person/OTHER walks/OTHER to/OTHER \
             the/OTHER left/OTHER happily/OTHER#0.0#0.0",
            "a person goes left happily#a/OTHER person/OTHER goes/OTHER left/OTHER \
             happily/OTHER#0.0#0.0",
        ]
    );
    let image = list("texts/Ma_walk-left_happy_001_00000.txt");
    assert!(
        image.starts_with("a person walks to the right happily#"),
        "{image}"
    );
    let store = Store::open(&set.display().to_string(), &StoreConfig::default()).unwrap();
    let labels = read_labels(&store).unwrap().unwrap();
    assert_eq!(labels.len(), 10);
    assert_eq!(
        labels["a_walk-left_happy_001_00000"]["content"],
        "walk-left"
    );
    assert_eq!(
        labels["Ma_walk-left_happy_001_00000"]["content"],
        "walk-right"
    );
    assert_eq!(labels["Ma_walk-left_happy_001_00000"]["style"], "happy");
    for name in ["Mean.npy", "Std.npy", "Mean_abs_3d.npy", "Std_abs_3d.npy"] {
        let bytes = fs::read(set.join(name)).unwrap();
        let array = kinegrad_data::parse_array(&bytes, name).unwrap();
        assert_eq!(array.shape, [263]);
        assert!(array.values.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn a_clip_walks_where_it_faces_on_the_floor_and_its_image_is_mirrored() {
    let captures = Captures::new();
    captures.prepare(PLAN).unwrap();
    let skeleton = Skeleton::humanml3d();
    let clip = |id: &str| {
        let path = captures
            .path("set")
            .join(FEATURES)
            .join(format!("{id}.npy"));
        parse_features(&fs::read(path).unwrap(), id, &skeleton).unwrap()
    };
    let one = clip("a_walk-left_happy_003_00000");
    assert_eq!(one.frames(), 60);
    let path = one.to_absolute().root_positions();
    // 1.3 m/s for 59 steps of a twentieth of a second, scaled with the legs, which are of equal
    // length.
    let [x, _, z] = path[59];
    assert!(
        (z - 1.3 * 59.0 / 20.0).abs() < 0.1 && x.abs() < 0.1,
        "{x} {z}"
    );
    let joints = one.joints();
    let lowest = joints.as_slice().iter().map(|place| place[1]);
    assert!(lowest.fold(f64::INFINITY, f64::min).abs() < 0.01);
    let image = clip("Ma_walk-left_happy_003_00000");
    assert_eq!(image, one.mirror(&skeleton).unwrap());
    assert_ne!(image, one);
}

#[test]
fn what_is_done_is_kept_and_what_has_changed_is_made_again() {
    let captures = Captures::new();
    captures.prepare(PLAN).unwrap();
    let again = captures.prepare(PLAN).unwrap();
    assert_eq!(again.kept, 6);
    let features = captures.path("set/new_joint_vecs/a_walk-left_happy_002_00000.npy");
    let whole = fs::read(&features).unwrap();
    fs::write(&features, b"damaged").unwrap();
    assert_eq!(captures.prepare(PLAN).unwrap().kept, 5);
    assert_eq!(fs::read(&features).unwrap(), whole);
    let reworded = PLAN.replace("\"happily\"", "\"with joy\"");
    // The short take has no happy caption and stays unchanged.
    assert_eq!(captures.prepare(&reworded).unwrap().kept, 1);
    fs::remove_file(captures.path("a_walk-left_happy_005.bvh")).unwrap();
    let fewer = captures.prepare(&reworded).unwrap();
    assert_eq!((fewer.clips, fewer.stale, fewer.kept), (8, 2, 5));
    let list = fs::read_to_string(captures.path("set/test.txt")).unwrap();
    assert!(
        list.contains("happy_004") && !list.contains("happy_005"),
        "{list}"
    );
}

#[test]
fn takes_that_fail_say_why_and_leave_the_rest_alone() {
    let captures = Captures::new();
    let crab = capture(&walking(91, 30.0, 1.0), "mixamo", 30.0).replace("LeftLeg", "Claw");
    captures.write("a_walk-left_happy_009.bvh", &crab);
    captures.write("misnamed.bvh", &crab);
    let report = captures.prepare(PLAN).unwrap();
    assert_eq!(report.clips, 10);
    let failure = |name: &str| {
        let take = report.takes.iter().find(|take| take.name == name).unwrap();
        take.failure.clone().unwrap()
    };
    assert!(failure("a_walk-left_happy_009").contains("LeftLeg (left_knee)"));
    assert!(failure("misnamed").contains("does not fit labels.name"));
    let alone = "output = \"other\"\n[[capture]]\nmotion = \"misnamed.bvh\"\n";
    let message = captures.refused(alone);
    assert!(
        message.contains("no take gave a clip; misnamed"),
        "{message}"
    );
    assert!(message.contains("LeftLeg (left_knee)"), "{message}");
    assert!(!captures.path("other").exists());
}

#[test]
fn plans_that_cannot_be_followed_are_refused_with_their_key() {
    let captures = Captures::new();
    for (plan, part) in [
        (
            format!("{PLAN}[phrases]\nframes = 60\n"),
            "`phrases` is for phrases and `clips`",
        ),
        (
            format!("{PLAN}[[take]]\nmotion = \"a\"\naudio = \"none\"\n"),
            "write two plans",
        ),
        (
            format!("{PLAN}map = \"dragon\"\n"),
            "there is no joint map `dragon`",
        ),
        (format!("{PLAN}map = \"own.toml\"\n"), "own.toml: "),
        (
            format!("{PLAN}fps = 0\n"),
            "plan.toml:12: `capture[0].fps` is 0, allowed: 0.1 to",
        ),
        (format!("{PLAN}captions = \"none.csv\"\n"), "none.csv"),
        (
            format!("{PLAN}motion_end_seconds = 0\n"),
            "a moment after `motion_start_seconds`",
        ),
        (
            format!("{PLAN}labels.fixed = {{ split = \"a\" }}\n"),
            "a label called `split`",
        ),
        (
            PLAN.replace("{content} {style}", "{content"),
            "`captions.templates[0]`",
        ),
        (PLAN.replace("words.style", "words.mood"), "none has {mood}"),
        (
            PLAN.replace("[split]", "[clips]\nmin_frames = 300\n[split]"),
            "`clips.max_frames` is 196, allowed: 300 to",
        ),
        (
            PLAN.replace("test_fraction = 0.2", "test_fraction = 1.0"),
            "`split.test_fraction` is 1, allowed: 0 to below 1",
        ),
        (
            PLAN.replace(
                "fraction = 0.2\ntest_fraction = 0.2",
                "validation = [\"*\"]",
            ),
            "every take",
        ),
        (PLAN.replace("*.bvh", "none/*.bvh"), "none"),
        (
            "output = \"set\"\n[clips]\n".to_owned(),
            "nothing to prepare",
        ),
    ] {
        // The two kinds' keys are named in the order of their lists.
        let part = part.replace("and `clips`", "and `captions`");
        let message = captures.refused(&plan);
        assert!(message.contains(&part), "{part}: {message}");
        assert!(!captures.path("set").exists(), "{part}");
    }
}
