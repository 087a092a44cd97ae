//! Skeleton joints that lie between two joints of a capture, and on a chain's last bone.

use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::vector::length;

use super::body::Body;
use super::map::JointMap;
use super::tests::{body_of, capture, walking};
use crate::Bvh;

#[test]
fn joints_that_are_lacking_lie_between_others() {
    let text = include_str!("maps/mixamo.toml").replace(
        "spine2 = \"Spine1\"",
        "spine2 = { from = \"Spine\", to = \"Spine2\", at = 0.25 }",
    );
    let skeleton = Skeleton::humanml3d();
    let map = JointMap::parse("own", &text, &skeleton).unwrap();
    let capture = capture(&walking(3, 30.0, 1.0), "mixamo", 30.0);
    let body = body_of(&capture, &map).unwrap();
    for t in 0..3 {
        let frame = body.joints.frame(t);
        let between = [0, 1, 2].map(|axis| 0.75 * frame[3][axis] + 0.25 * frame[9][axis]);
        let apart = [0, 1, 2].map(|axis| frame[6][axis] - between[axis]);
        assert!(length(apart) < 1e-9, "{apart:?}");
    }
    for (broken, part) in [
        (
            text.replace("head = \"Head\"\n", ""),
            "joints.head is missing",
        ),
        (
            text.replace("head = ", "nose = \"Head\"\nhead = "),
            "joints.nose",
        ),
        (
            text.replace("head = \"Head\"", "head = 3"),
            "the name of a joint",
        ),
        (text.replace(", at = 0.25", ""), "without one of its keys"),
        (
            text.replace("at = 0.25", "part = 0.25"),
            "found part = 0.25",
        ),
        (
            text.replace("head = \"Head\"", "head = { end_site = \"Head\" }"),
            "without one of its keys",
        ),
        (
            text.replace("{ from =", "{ end_site = \"Head\", from ="),
            "end_site together with from",
        ),
        (
            text.replace(
                "head = \"Head\"",
                "head = { end_site = \"Head\", at = 1e9 }",
            ),
            "found at = 1000000000, allowed: -1 to 2",
        ),
        (
            text.replace("head = \"Head\"", "head = true"),
            "own:18: `joints.head`: ",
        ),
        (text + "\n[odd]\n", ": unknown key `odd`"),
    ] {
        let message = JointMap::parse("own", &broken, &skeleton).unwrap_err();
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = JointMap::built_in("dragon").unwrap_err();
    assert!(
        message.contains("bandai, cmu, humanml3d, mixamo, xsens, forefoot"),
        "{message}"
    );
}

#[test]
fn toes_that_are_end_sites_lie_on_the_last_bone() {
    let joints = walking(12, 30.0, 1.0);
    // Without joints of the toes: their places are End Sites of the ankles, further ahead.
    let mut text = capture(&joints, "mixamo", 30.0);
    let toes = |text: &str, side: &str| {
        let start = text.find(&format!("JOINT rig:{side}ToeBase")).unwrap();
        let end = start + text[start..].find("End Site").unwrap();
        (start, end)
    };
    let mut columns = Vec::new();
    for side in ["Left", "Right"] {
        let (start, _) = toes(&text, side);
        let channels: usize = text[..start]
            .lines()
            .filter_map(|line| line.trim().strip_prefix("CHANNELS "))
            .map(|channels| {
                channels
                    .split(' ')
                    .next()
                    .unwrap()
                    .parse::<usize>()
                    .unwrap()
            })
            .sum();
        columns.push(channels);
    }
    for side in ["Right", "Left"] {
        let (start, end) = toes(&text, side);
        let offset = text[start..end]
            .lines()
            .find(|line| line.contains("OFFSET"));
        let offset: Vec<f64> = offset
            .unwrap()
            .split_whitespace()
            .skip(1)
            .map(|value| value.parse::<f64>().unwrap() / 0.6)
            .collect();
        let close = end + text[end..].find('}').unwrap();
        let close = close + 1 + text[close + 1..].find('}').unwrap() + 1;
        let site = format!(
            "End Site\n{{\nOFFSET {} {} {}\n}}",
            offset[0], offset[1], offset[2]
        );
        text.replace_range(start..close, &site);
    }
    let (body, frames) = text.split_once("MOTION").unwrap();
    let frames: Vec<String> = frames
        .lines()
        .enumerate()
        .map(|(line, values)| match line > 2 {
            true => {
                let values = values.split_whitespace().enumerate();
                let values = values.filter(|(column, _)| {
                    columns
                        .iter()
                        .all(|first| !(*first..first + 3).contains(column))
                });
                values.map(|(_, value)| value).collect::<Vec<_>>().join(" ")
            }
            false => values.to_owned(),
        })
        .collect();
    let text = format!("{body}MOTION{}\n", frames.join("\n"));
    let own = |at: f64| {
        let mut map = include_str!("maps/mixamo.toml").to_owned();
        for side in ["Left", "Right"] {
            let site = format!("{{ end_site = \"{side}Foot\", at = {at} }}");
            map = map.replace(&format!("\"{side}ToeBase\""), &site);
        }
        JointMap::parse("own", &map, &Skeleton::humanml3d()).unwrap()
    };
    let toes = |body: &Body, t: usize| [10, 11].map(|joint| body.joints.frame(t)[joint]);
    let (right, far) = (body_of(&text, &own(0.6)), body_of(&text, &own(1.0)));
    let (right, far) = (right.unwrap(), far.unwrap());
    for t in 0..12 {
        for (joint, (found, further)) in toes(&right, t).iter().zip(toes(&far, t)).enumerate() {
            let expected = joints.frame(t)[10 + joint];
            let ankle = joints.frame(t)[7 + joint];
            for axis in 0..3 {
                let apart = expected[axis] - ankle[axis];
                assert!((found[axis] - expected[axis]).abs() < 1e-3, "{t} {axis}");
                let missed = further[axis] - ankle[axis] - apart / 0.6;
                assert!(missed.abs() < 1e-3, "{t} {axis}: {missed}");
            }
        }
    }
    // A joint without an End Site, and a missing joint.
    for (joint, part) in [
        (
            "LeftLeg",
            "an End Site of LeftLeg that is not at the joint (left_foot)",
        ),
        ("Paw", "Paw (left_foot)"),
    ] {
        let map = include_str!("maps/mixamo.toml");
        let site = format!("{{ end_site = \"{joint}\", at = 1 }}");
        let map = map.replace("\"LeftToeBase\"", &site);
        let map = JointMap::parse("own", &map, &Skeleton::humanml3d()).unwrap();
        let bvh = Bvh::parse(text.as_bytes(), "take.bvh").unwrap();
        let message = map.joints_of(&bvh).unwrap_err();
        assert!(message.contains(part), "{message}");
    }
}
