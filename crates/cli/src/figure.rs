//! Figures of motion files.

use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::{CHANNELS, Motion, Representation};
use kinegrad_report::scene::{Contact, Curves, Figure};

/// Metres per second below which a foot stands on the ground: HumanML3D's threshold of 0.002 square
/// metres between two frames at 20 frames per second.
const STANDING: f64 = 0.894;

/// The figure of rows in a representation; `None` if a value is not finite.
pub fn of(name: &str, representation: &dyn Representation, rows: &[f32]) -> Option<Figure> {
    let joints = representation.joints(rows)?;
    let fps = representation.fps();
    let (joint_names, parents) = match representation.skeleton() {
        Some(skeleton) => (
            skeleton.description().joint_names.clone(),
            skeleton.parents().to_vec(),
        ),
        None => (vec!["root".to_string()], vec![None]),
    };
    let curves = representation.curves(rows).into_iter();
    Some(Figure {
        name: name.to_string(),
        fps,
        positions: joints.to_f32(),
        joint_names,
        parents,
        orientations: orientations(representation, rows),
        contacts: match representation.skeleton() {
            Some(skeleton) => contacts(&joints, skeleton, fps),
            None => Vec::new(),
        },
        curves: curves
            .map(|group| curves_of(group, joints.frames()))
            .collect(),
    })
}

/// Of a phrase, where the root faces.
fn orientations(representation: &dyn Representation, rows: &[f32]) -> Option<Vec<[f32; 4]>> {
    let is_phrase = representation.channels() == CHANNELS && representation.skeleton().is_none();
    let motion = is_phrase.then(|| Motion::new(rows.to_vec()).ok())??;
    let frames = (0..motion.frames()).map(|t| {
        let q = motion.quaternion(t).normalised();
        [q.w, q.x, q.y, q.z].map(|value| value as f32)
    });
    Some(frames.collect())
}

/// When the joints of the feet hardly move.
fn contacts(joints: &Joints, skeleton: &Skeleton, fps: f64) -> Vec<Contact> {
    let stands = |joint: usize| {
        let track = joints.track(joint);
        let speeds = track.windows(2).map(|pair| {
            let squares = (0..3).map(|axis| (pair[1][axis] - pair[0][axis]).powi(2));
            fps * squares.sum::<f64>().sqrt()
        });
        let mut frames: Vec<bool> = speeds.map(|speed| speed < STANDING).collect();
        frames.push(frames.last().copied().unwrap_or(true));
        frames
    };
    let feet = skeleton.contact_joints().into_iter();
    feet.map(|joint| Contact {
        joint,
        frames: stands(joint),
    })
    .collect()
}

/// Curves with one value per frame: the last one stays where derivatives are shorter.
fn curves_of(group: kinegrad_motion::representation::Curves, frames: usize) -> Curves {
    let series = group.series.into_iter().map(|(name, values)| {
        let mut values: Vec<f32> = values.into_iter().map(|value| value as f32).collect();
        let last = values.last().copied().unwrap_or_default();
        values.resize(frames, last);
        (name, values)
    });
    Curves {
        title: group.title,
        series: series.collect(),
    }
}
