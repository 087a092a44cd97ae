//! Joint maps from the joints of a capture to the joints of the clips' skeleton.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use kinegrad_motion::humanml::Skeleton;
use kinegrad_settings::read_toml;
use serde::{Deserialize, Serialize};

use crate::{Bvh, RootPose};

const BUILT_IN: [(&str, &str); 6] = [
    ("bandai", include_str!("maps/bandai.toml")),
    ("cmu", include_str!("maps/cmu.toml")),
    ("humanml3d", include_str!("maps/humanml3d.toml")),
    ("mixamo", include_str!("maps/mixamo.toml")),
    ("xsens", include_str!("maps/xsens.toml")),
    // Last, because the first of equally fitting maps is taken.
    ("forefoot", include_str!("maps/forefoot.toml")),
];

/// Range of `at`, which may extrapolate the bone.
const PARTS: std::ops::RangeInclusive<f64> = -1.0..=2.0;

/// Most missing joints in a message.
const SHOWN: usize = 8;

/// The place of each joint of a skeleton in a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMap {
    /// The name of a built-in map, or the stem of the map's file.
    pub name: String,
    /// Sources of the skeleton's joints, in its order.
    joints: Vec<(String, Source)>,
}

/// The place of a joint of the skeleton in a capture.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(try_from = "toml::Value")]
enum Source {
    /// A joint of the capture.
    Joint(String),
    /// A fraction `at` of the line between two joints.
    Between { from: String, to: String, at: f64 },
    /// A fraction `at` of the line from a joint to its first End Site that is not at the joint.
    EndSite { end_site: String, at: f64 },
}

impl TryFrom<toml::Value> for Source {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        let allowed = "the name of a joint, { from = \"JOINT\", to = \"JOINT\", at = PART }, or \
                       { end_site = \"JOINT\", at = PART }";
        let (mut from, mut to, mut end_site, mut at) = (None, None, None, None);
        let table = match value {
            toml::Value::String(joint) => return Ok(Self::Joint(joint)),
            toml::Value::Table(table) => table,
            other => return Err(format!("found {}, allowed: {allowed}", other.type_str())),
        };
        for (key, value) in table {
            match (key.as_str(), value) {
                ("from", toml::Value::String(joint)) => from = Some(joint),
                ("to", toml::Value::String(joint)) => to = Some(joint),
                ("end_site", toml::Value::String(joint)) => end_site = Some(joint),
                ("at", toml::Value::Float(part)) if part.is_finite() => at = Some(part),
                ("at", toml::Value::Integer(part)) => at = Some(part as f64),
                (key, value) => return Err(format!("found {key} = {value}, allowed: {allowed}")),
            }
        }
        if let Some(at) = at.filter(|at| !PARTS.contains(at)) {
            let (least, most) = (PARTS.start(), PARTS.end());
            return Err(format!("found at = {at}, allowed: {least} to {most}"));
        }
        match (from, to, end_site, at) {
            (Some(from), Some(to), None, Some(at)) => Ok(Self::Between { from, to, at }),
            (None, None, Some(end_site), Some(at)) => Ok(Self::EndSite { end_site, at }),
            (from, to, Some(_), _) if from.is_some() || to.is_some() => {
                let odd = "found end_site together with from or to";
                Err(format!("{odd}, allowed: {allowed}"))
            }
            _ => Err(format!(
                "found a table without one of its keys, allowed: {allowed}"
            )),
        }
    }
}

impl Source {
    fn names(&self) -> Vec<&str> {
        match self {
            Self::Joint(joint) => vec![joint],
            Self::Between { from, to, .. } => vec![from, to],
            Self::EndSite { end_site, .. } => vec![end_site],
        }
    }

    /// The joint or End Site that the capture lacks, in words.
    fn lacks(&self, bvh: &Bvh) -> Option<String> {
        let names = self.names();
        if let Some(absent) = names.iter().find(|name| bvh.joint(name).is_none()) {
            return Some((*absent).to_owned());
        }
        let lacks = self.place(bvh).is_none();
        lacks.then(|| format!("an End Site of {} that is not at the joint", names[0]))
    }

    /// The source's place in a capture, `None` if missing.
    fn place(&self, bvh: &Bvh) -> Option<Place> {
        Some(match self {
            Self::Joint(joint) => Place::on(bvh.joint(joint)?, [0.0; 3]),
            Self::Between { from, to, at } => Place {
                from: bvh.joint(from)?,
                to: bvh.joint(to)?,
                at: *at,
                offset: [0.0; 3],
            },
            Self::EndSite { end_site, at } => {
                let joint = bvh.joint(end_site)?;
                let mut ends = bvh.joints()[joint].end_sites.iter();
                // An End Site without a length has no direction.
                let end = ends.find(|end| end.iter().any(|&value| value != 0.0))?;
                Place::on(joint, end.map(|value| at * value))
            }
        })
    }
}

/// The file of a map.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct MapFile {
    joints: BTreeMap<String, Source>,
}

/// A place on a body of a capture.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// The joint that the place moves with.
    from: usize,
    /// Another joint, and the fraction of the line towards it.
    to: usize,
    at: f64,
    /// Offset from the first joint, rotating with that joint, in file units.
    offset: [f64; 3],
}

impl Place {
    fn on(joint: usize, offset: [f64; 3]) -> Self {
        Self {
            from: joint,
            to: joint,
            at: 0.0,
            offset,
        }
    }

    /// The place in a frame with the joint poses `world`.
    fn at(&self, world: &[RootPose]) -> [f64; 3] {
        let (from, to) = (&world[self.from], &world[self.to]);
        let turned = from.orientation.rotate(self.offset);
        [0, 1, 2].map(|axis| {
            let apart = to.position[axis] - from.position[axis];
            from.position[axis] + self.at * apart + turned[axis]
        })
    }
}

impl JointMap {
    /// The map in the TOML text of `file`; the file's stem is the map's name.
    pub fn parse(file: &str, text: &str, skeleton: &Skeleton) -> Result<Self, String> {
        let map = read_toml::<MapFile>(text, file, "docs/dataset.md describes joint maps");
        let mut sources = map.map_err(|error| error.to_string())?.joints;
        let names = &skeleton.description().joint_names;
        let joints = names.iter().map(|joint| {
            let source = sources.remove(joint);
            source.map(|source| (joint.clone(), source)).ok_or_else(|| {
                format!(
                    "{file}: joints.{joint} is missing; a joint that the captures lack lies between \
                         two others: {joint} = {{ from = \"JOINT\", to = \"JOINT\", at = 0.5 }}"
                )
            })
        });
        let joints = joints.collect::<Result<_, _>>()?;
        if let Some((odd, _)) = sources.pop_first() {
            return Err(format!(
                "{file}: joints.{odd}: no joint of {}; allowed: {}",
                skeleton.description().name,
                names.join(", ")
            ));
        }
        let name = Path::new(file).file_stem().unwrap_or_default();
        let name = name.to_string_lossy().into_owned();
        Ok(Self { name, joints })
    }

    /// The built-in map of this name.
    pub fn built_in(name: &str) -> Result<Self, String> {
        let mut maps = Self::all_built_in().into_iter();
        maps.find(|map| map.name == name).ok_or_else(|| {
            let names = BUILT_IN.map(|(name, _)| name).join(", ");
            format!("there is no joint map `{name}`, allowed: {names}, or a file ending in .toml")
        })
    }

    fn all_built_in() -> Vec<Self> {
        let skeleton = Skeleton::humanml3d();
        let maps = BUILT_IN.iter();
        maps.map(|(name, text)| Self::parse(name, text, &skeleton).expect("the maps are sound"))
            .collect()
    }

    /// The built-in map that fits a capture; of several maps, the one that names most joints.
    pub fn fitting(bvh: &Bvh) -> Result<Self, String> {
        let named = |map: &Self| {
            let names = map.joints.iter().flat_map(|(_, source)| source.names());
            names.collect::<BTreeSet<_>>().len()
        };
        let mut maps = Self::all_built_in();
        maps.sort_by_key(|map| (map.missing(bvh).len(), std::cmp::Reverse(named(map))));
        let best = maps.swap_remove(0);
        match best.missing(bvh).is_empty() {
            true => Ok(best),
            false => Err(format!(
                "no built-in joint map fits: {} (name joints of your own with `map = \
                 \"FILE.toml\"`)",
                best.lacking(bvh)
            )),
        }
    }

    /// The joints of a capture that are joints of the skeleton, by the skeleton's joint.
    pub fn named_joints(&self) -> impl Iterator<Item = (&str, &str)> {
        self.joints
            .iter()
            .filter_map(|(joint, source)| match source {
                Source::Joint(name) => Some((joint.as_str(), name.as_str())),
                _ => None,
            })
    }

    /// A text that changes with the content of the map.
    pub fn fingerprint(&self) -> String {
        format!("{:?}", self.joints)
    }

    /// The skeleton's joints that a capture lacks, each with the missing joint of the capture.
    fn missing(&self, bvh: &Bvh) -> Vec<(&str, String)> {
        let joints = self.joints.iter();
        let lacking =
            joints.filter_map(|(joint, source)| Some((joint.as_str(), source.lacks(bvh)?)));
        lacking.collect()
    }

    /// The joints that a capture lacks, in words.
    fn lacking(&self, bvh: &Bvh) -> String {
        let missing = self.missing(bvh);
        let name = |(joint, name): &(&str, String)| format!("{name} ({joint})");
        let mut names: Vec<String> = missing.iter().take(SHOWN).map(name).collect();
        if missing.len() > SHOWN {
            names.push(format!("{} more", missing.len() - SHOWN));
        }
        let (count, all, name) = (missing.len(), self.joints.len(), &self.name);
        let names = names.join(", ");
        format!("it lacks {count} of the {all} joints of `{name}`: {names}")
    }

    /// The skeleton's joints in each frame of a capture, `[frames, J]`, in its units and axes.
    pub fn joints_of(&self, bvh: &Bvh) -> Result<Vec<[f64; 3]>, String> {
        let places = self.joints.iter().map(|(_, source)| source.place(bvh));
        let places: Option<Vec<Place>> = places.collect();
        let places = places.ok_or_else(|| self.lacking(bvh))?;
        let frames = (0..bvh.frames()).flat_map(|t| {
            let world = bvh.world(t);
            let joint = |place: &Place| place.at(&world);
            places.iter().map(joint).collect::<Vec<_>>()
        });
        Ok(frames.collect())
    }
}
