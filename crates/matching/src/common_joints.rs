//! Examples of different skeletons on the joints that they have in common.

use std::collections::{BTreeMap, HashMap, HashSet};

use kinegrad_capture::clips::JointMap;
use kinegrad_capture::{Bvh, UpAxis, bare_name};
use kinegrad_motion::vector::{length, minus, plus};
use kinegrad_settings::read_toml;
use serde::{Deserialize, Serialize};

use crate::parts::{by_name, subtree};
use crate::{Error, Example};

mod retarget;
#[cfg(test)]
mod tests;

use retarget::{CommonSkeleton, Skeleton};

/// Most joints named in a message.
const SHOWN: usize = 8;
/// Fewest joints of a common skeleton.
const LEAST: usize = 2;
/// The remedy for skeletons that differ.
const HINT: &str =
    "name the joints that correspond in a TOML file, option `joint_map`: docs/matching.md";

/// The names of joints in files of other skeletons, from a TOML file.
#[derive(Clone, Debug)]
pub struct JointNames {
    file: String,
    /// Names in other files by the name in the first example; an empty list leaves a joint out.
    joints: BTreeMap<String, Vec<String>>,
}

/// A file of joint names.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    joints: BTreeMap<String, Names>,
}

/// One name or several.
#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a name or a list of names")]
enum Names {
    One(String),
    Several(Vec<String>),
}

/// The joints that motions of different skeletons have in common.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CommonJoints {
    /// Their names in the first example.
    pub joints: Vec<String>,
    /// The joints of each file that are left out.
    pub left_out: BTreeMap<String, Vec<String>>,
}

impl JointNames {
    /// Reads the table `[joints]`: a joint of the first example and its name, or the list of its
    /// names, in the other files. An empty list leaves the joint out.
    ///
    /// # Errors
    /// Fails for a malformed file and for a name of two joints.
    pub fn read(text: &str, file: &str) -> Result<Self, Error> {
        let hint = "docs/matching.md describes maps of joints";
        let document: Document = read_toml(text, file, hint)?;
        let joints = document
            .joints
            .into_iter()
            .map(|(joint, names)| match names {
                Names::One(name) => (joint, vec![name]),
                Names::Several(names) => (joint, names),
            });
        let joints: BTreeMap<String, Vec<String>> = joints.collect();
        let mut seen = HashSet::new();
        if let Some(name) = joints.values().flatten().find(|name| !seen.insert(*name)) {
            let problem = format!("two joints are called `{name}`");
            return Err(Error::file(file, problem, hint));
        }
        Ok(Self {
            file: file.to_string(),
            joints,
        })
    }

    /// The names of a joint of the first example in other files.
    fn of(&self, joint: &str) -> Option<&Vec<String>> {
        let found = self.joints.get(joint);
        found.or_else(|| self.joints.get(bare_name(joint)))
    }

    /// Checks that every name is that of a joint.
    fn must_be_known(&self, first: &Example, others: &[&mut Example]) -> Result<(), Error> {
        let own = by_name(first.bvh.joints());
        if let Some(unknown) = self
            .joints
            .keys()
            .find(|key| !own.contains_key(key.as_str()))
        {
            let problem = format!("{} has no joint `{unknown}`", first.file);
            let hint = format!(
                "joints: {}",
                listed(first.bvh.joints().iter().map(|j| &j.name))
            );
            return Err(Error::file(&self.file, problem, hint));
        }
        let all = || others.iter().flat_map(|other| other.bvh.joints());
        let known = all().flat_map(|joint| [joint.name.as_str(), bare_name(&joint.name)]);
        let known: HashSet<&str> = known.collect();
        let mut names = self.joints.values().flatten();
        match names.find(|name| !known.contains(name.as_str())) {
            None => Ok(()),
            Some(unknown) => {
                let problem = format!("no other file has a joint `{unknown}`");
                let hint = format!("joints: {}", listed(all().map(|joint| &joint.name)));
                Err(Error::file(&self.file, problem, hint))
            }
        }
    }
}

/// Brings motions of different skeletons onto the joints that all have, with the names and bones of
/// the first. `None`, without a change, if all have one skeleton.
///
/// Joints correspond by `names`, by the built-in joint maps of `kinegrad data prepare` if two
/// skeletons have different ones, or by their names without prefixes.
///
/// # Errors
/// Fails if, without `names` and maps, each of two skeletons has a joint that the other lacks; if the
/// order of corresponding joints along a limb differs; or without a common root.
pub(crate) fn unify(
    motions: &mut [&mut Example],
    names: Option<&JointNames>,
    up: UpAxis,
) -> Result<Option<CommonJoints>, Error> {
    let Some((first, others)) = motions.split_first_mut() else {
        return Ok(None);
    };
    let is_same = |other: &Example| same_joints(&first.bvh, &other.bvh);
    if names.is_none() && others.iter().all(|other| is_same(other)) {
        return Ok(None);
    }
    if let Some(names) = names {
        names.must_be_known(first, others)?;
    }
    let pairs = others.iter().map(|other| counterparts(first, other, names));
    let pairs: Vec<Vec<Option<usize>>> = pairs.collect();
    let own = first.bvh.joints().len();
    let is_left_out = |joint: usize| {
        let of = names.and_then(|names| names.of(&first.bvh.joints()[joint].name));
        of.is_some_and(Vec::is_empty)
    };
    let is_common =
        |joint: &usize| !is_left_out(*joint) && pairs.iter().all(|pairs| pairs[*joint].is_some());
    let common: Vec<usize> = (0..own).filter(is_common).collect();
    if common.len() == own && others.iter().all(|other| is_same(other)) {
        return Ok(None);
    }
    for (other, pairs) in others.iter().zip(&pairs) {
        let is_known = names.is_some() || by_body(&first.bvh, &other.bvh).is_some();
        must_share_enough(first, other, pairs, is_known)?;
    }
    if common.len() < LEAST {
        let problem = "no two of its joints are in all files";
        return Err(Error::file(&first.file, problem, HINT));
    }
    let target = CommonSkeleton::new(first, &common)?;
    let mut left_out = BTreeMap::new();
    let mut leave_out = |example: &Example, used: &[usize]| {
        let used: HashSet<usize> = used.iter().copied().collect();
        let joints = example.bvh.joints().iter().enumerate();
        let unused = joints.filter(|(index, _)| !used.contains(index));
        let unused: Vec<String> = unused.map(|(_, joint)| joint.name.clone()).collect();
        if !unused.is_empty() {
            left_out.insert(example.file.clone(), unused);
        }
    };
    leave_out(first, &common);
    let reference = Skeleton::new(first, common.clone());
    let mut retargeted = Vec::with_capacity(others.len());
    for (other, pairs) in others.iter().zip(&pairs) {
        let of: Vec<usize> = common.iter().filter_map(|&joint| pairs[joint]).collect();
        leave_out(other, &of);
        let source = Skeleton::new(other, of);
        target.must_have_order_of(&source, first)?;
        retargeted.push(match is_same(other) {
            true => target.reduce(&source)?,
            false => target.retarget(&source, &reference, up)?,
        });
    }
    let reduced = target.reduce(&reference)?;
    for (other, bvh) in others.iter_mut().zip(retargeted) {
        other.bvh = bvh;
    }
    first.bvh = reduced;
    let joints = first.bvh.joints().iter().map(|joint| joint.name.clone());
    Ok(Some(CommonJoints {
        joints: joints.collect(),
        left_out,
    }))
}

/// True for the same joints in the same order, apart from the prefixes of their names.
fn same_joints(one: &Bvh, other: &Bvh) -> bool {
    let key = |bvh: &Bvh| -> Vec<(String, Option<usize>)> {
        let joints = bvh.joints().iter();
        let key = joints.map(|joint| (bare_name(&joint.name).to_string(), joint.parent));
        key.collect()
    };
    key(one) == key(other)
}

/// The joint of `other` for each joint of `first`, by index.
fn counterparts(
    first: &Example,
    other: &Example,
    names: Option<&JointNames>,
) -> Vec<Option<usize>> {
    let (own, joints) = (first.bvh.joints(), other.bvh.joints());
    if same_joints(&first.bvh, &other.bvh) {
        return (0..own.len()).map(Some).collect();
    }
    let by_name = by_name(joints);
    let mut used = HashSet::new();
    let mut take = |found: usize| used.insert(found).then_some(found);
    let given = own.iter().map(|joint| {
        let names = names?.of(&joint.name)?.iter();
        let found = names.filter_map(|name| by_name.get(name.as_str())).next();
        take(*found?)
    });
    let mut found: Vec<Option<usize>> = given.collect();
    let by_body = by_body(&first.bvh, &other.bvh);
    for (index, joint) in own.iter().enumerate() {
        if found[index].is_none() {
            let same = match &by_body {
                Some(pairs) => pairs.get(&index),
                None => by_name.get(bare_name(&joint.name)),
            };
            found[index] = same.copied().and_then(&mut take);
        }
    }
    found
}

/// Corresponding joints of two captures with different built-in joint maps.
fn by_body(first: &Bvh, other: &Bvh) -> Option<HashMap<usize, usize>> {
    let [own, others] = [first, other].map(|bvh| JointMap::fitting(bvh).ok());
    let (own, others) = (own?, others?);
    if own.name == others.name {
        return None;
    }
    let others: HashMap<&str, &str> = others.named_joints().collect();
    let pairs = own
        .named_joints()
        .filter_map(|(body, name)| Some((first.joint(name)?, other.joint(others.get(body)?)?)));
    Some(pairs.collect())
}

/// Checks that every joint of one skeleton is in the other, unless `names` or the built-in joint maps
/// say which joints correspond.
fn must_share_enough(
    first: &Example,
    other: &Example,
    pairs: &[Option<usize>],
    is_known: bool,
) -> Result<(), Error> {
    let shared = pairs.iter().flatten().count();
    let joints = [first, other].map(|example| example.bvh.joints());
    let is_contained = shared == joints[0].len().min(joints[1].len());
    if shared >= LEAST && (is_known || is_contained) {
        return Ok(());
    }
    let used: HashSet<usize> = pairs.iter().copied().flatten().collect();
    let lacking = joints[0]
        .iter()
        .zip(pairs)
        .filter(|(_, pair)| pair.is_none());
    let unknown = joints[1].iter().enumerate();
    let unknown = unknown.filter(|(index, _)| !used.contains(index));
    let problem = format!(
        "the skeletons differ: {} of its joints are not in {} ({}), and {} the other way round ({})",
        unknown.clone().count(),
        first.file,
        listed(unknown.map(|(_, joint)| &joint.name)),
        lacking.clone().count(),
        listed(lacking.map(|(joint, _)| &joint.name)),
    );
    Err(Error::file(&other.file, problem, HINT))
}

/// Some names for a message.
fn listed<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    match names.len() {
        0 => "none".to_string(),
        all if all > SHOWN => {
            format!("{} and {} more", names[..SHOWN].join(", "), all - SHOWN)
        }
        _ => names.join(", "),
    }
}

/// The end of the furthest bone below a joint, relative to it; none without bones. `rest`: the
/// places of all joints without rotations.
fn furthest_end(bvh: &Bvh, rest: &[[f64; 3]], joint: usize) -> Option<[f64; 3]> {
    let joints = bvh.joints();
    let below = subtree(joints, joint);
    let ends = below.flat_map(|index| {
        let own = minus(rest[index], rest[joint]);
        let sites = joints[index].end_sites.iter();
        sites.map(move |&end| plus(own, end)).chain([own])
    });
    let ends = ends.filter(|&end| length(end) > 0.0);
    ends.max_by(|a, b| length(*a).total_cmp(&length(*b)))
}
