//! Measures of an object that drawing needs.

use serde_json::{Value, json};

use super::DRAWING;
use crate::scene::{SceneObject, Side};

/// Number of frames in which distances of joints are measured.
const MEASURED: usize = 24;

/// Words in the names of fingers.
const FINGERS: [&str; 6] = ["thumb", "index", "middle", "ring", "pinky", "finger"];

/// A drawn bone.
#[derive(Clone, Debug)]
pub(crate) struct Bone {
    pub parent: usize,
    pub joint: usize,
    /// Meters.
    pub radius: f64,
    pub side: Side,
}

/// The measures of an object with at least one frame.
#[derive(Clone, Debug)]
pub(crate) struct Figure {
    /// Height of the body in meters; of a lone root that of a person.
    pub height: f64,
    /// The joint at the root of the body.
    pub root: usize,
    pub bones: Vec<Bone>,
    /// The head, and the top of the head or the head again.
    pub head: Option<[usize; 2]>,
    /// Lowest and highest coordinates.
    pub low: [f64; 3],
    pub high: [f64; 3],
    /// Outline around the root trajectory.
    pub around_trajectory: Vec<[f64; 2]>,
    /// Outline around the middle of all positions.
    pub around_middle: Vec<[f64; 2]>,
    /// Root position `[x, z]` of each frame, smoothed.
    pub trajectory: Vec<[f64; 2]>,
}

impl Figure {
    /// Measures an object with at least one frame.
    pub fn of(object: &SceneObject) -> Self {
        let (joints, frames) = (object.joints(), object.frames());
        let mut figure = Self {
            height: DRAWING.camera.lone_size,
            root: 0,
            bones: Vec::new(),
            head: None,
            low: [f64::INFINITY; 3],
            high: [f64::NEG_INFINITY; 3],
            around_trajectory: Vec::new(),
            around_middle: Vec::new(),
            trajectory: Vec::new(),
        };
        for (at, value) in object.positions.iter().enumerate() {
            let (axis, value) = (at % 3, f64::from(*value));
            figure.low[axis] = figure.low[axis].min(value);
            figure.high[axis] = figure.high[axis].max(value);
        }
        if joints > 1 {
            let heights = measured(frames).map(|frame| {
                let heights = (0..joints).map(|joint| f64::from(object.joint(frame, joint)[1]));
                let (low, high) = heights.fold((f64::MAX, f64::MIN), |(low, high), y| {
                    (low.min(y), high.max(y))
                });
                high - low
            });
            let height = heights.fold(0.0, f64::max);
            figure.height = if height > 0.0 { height } else { 1.0 };
            figure.find_bones(object);
        }
        figure.trajectory = figure.smoothed(object);
        figure.around_trajectory = figure.outline(object, |frame| figure.trajectory[frame]);
        let middle = figure.middle();
        figure.around_middle = figure.outline(object, |_| middle);
        figure
    }

    /// Middle of all positions, `[x, z]`.
    pub fn middle(&self) -> [f64; 2] {
        [0, 2].map(|axis| (self.low[axis] + self.high[axis]) / 2.0)
    }

    /// True if a camera should follow the object. A path on the ground is seen as a whole.
    pub fn goes_far(&self) -> bool {
        let is_flat = self.high[1] <= self.low[1];
        let extent = (self.high[0] - self.low[0]).max(self.high[2] - self.low[2]);
        !is_flat && extent > DRAWING.stage.follow_beyond * self.height
    }

    /// The measures that the viewer's script reads.
    pub fn json(&self) -> Value {
        let side = |side| match side {
            Side::Left => 1,
            Side::Middle => 0,
            Side::Right => -1,
        };
        let bones = self.bones.iter();
        let bones = bones.map(|bone| json!({
            "parent": bone.parent, "joint": bone.joint, "radius": bone.radius, "side": side(bone.side),
        }));
        json!({
            "height": self.height,
            "root": self.root,
            "bones": bones.collect::<Vec<_>>(),
            "head": self.head,
            "low": self.low,
            "high": self.high,
            "around": { "trajectory": self.around_trajectory, "middle": self.around_middle },
        })
    }

    fn find_bones(&mut self, object: &SceneObject) {
        let limits = &DRAWING.bone;
        let children = object.children();
        for (joint, parent) in object.parents.iter().enumerate() {
            let Some(parent) = *parent else { continue };
            let lengths = measured(object.frames()).map(|frame| {
                let [a, b] = [parent, joint].map(|joint| object.joint(frame, joint));
                let square = [0, 1, 2].map(|axis| f64::from(a[axis] - b[axis]).powi(2));
                square.iter().sum::<f64>().sqrt()
            });
            let (least, length) = lengths.fold((f64::MAX, 0.0f64), |(least, most), length| {
                (least.min(length), most.max(length))
            });
            if length - least > limits.most_spread * self.height {
                // A distance that varies is not a bone; below the root, the joint is the root of
                // the body.
                if parent == self.root {
                    self.root = joint;
                }
                continue;
            }
            if length < limits.least_length * self.height {
                continue;
            }
            // Some captures have a root on the floor below the hips.
            if object.parents[parent].is_none()
                && children[parent].len() == 1
                && length > limits.most_root_length * self.height
            {
                self.root = joint;
                continue;
            }
            let name = bare(object, joint).to_lowercase();
            let thick = match FINGERS.iter().any(|finger| name.contains(finger)) {
                true => limits.finger_radius,
                false => limits.radius,
            };
            self.bones.push(Bone {
                parent,
                joint,
                radius: (thick * self.height).min(limits.most_of_length * length),
                side: object.side(joint),
            });
        }
        let is_head = |joint: &usize| bare(object, *joint).eq_ignore_ascii_case("head");
        let Some(head) = (0..object.joints()).find(is_head) else {
            return;
        };
        let is_top = |bone: &Bone| {
            let name = bare(object, bone.joint).to_lowercase();
            bone.parent == head && ["end", "top"].iter().any(|word| name.contains(word))
        };
        let tops: Vec<usize> = self
            .bones
            .iter()
            .filter(|bone| is_top(bone))
            .map(|bone| bone.joint)
            .collect();
        // The top of the head lies within its ball.
        if let [top] = tops[..] {
            self.bones.retain(|bone| bone.joint != top);
            self.head = Some([head, top]);
        } else {
            self.head = Some([head, head]);
        }
    }

    /// The root trajectory on the ground, averaged over frames before and after.
    fn smoothed(&self, object: &SceneObject) -> Vec<[f64; 2]> {
        let frames = object.frames();
        let half = (DRAWING.camera.smoothing_seconds * object.fps).round() as usize;
        let mut sums = vec![[0.0; 2]];
        for frame in 0..frames {
            let [x, _, z] = object.joint(frame, self.root).map(f64::from);
            let [before_x, before_z] = sums[frame];
            sums.push([before_x + x, before_z + z]);
        }
        let mean = |frame: usize| {
            let (from, to) = (frame.saturating_sub(half), (frame + half + 1).min(frames));
            [0, 1].map(|axis| (sums[to][axis] - sums[from][axis]) / (to - from) as f64)
        };
        (0..frames).map(mean).collect()
    }

    /// Largest distance of the drawing from a vertical axis over all frames, as `[reach, height]` in
    /// meters for the lower and the upper border of each layer. `axis` returns the axis of a frame.
    fn outline(&self, object: &SceneObject, axis: impl Fn(usize) -> [f64; 2]) -> Vec<[f64; 2]> {
        let camera = &DRAWING.camera;
        let mut joints: Vec<usize> = self
            .bones
            .iter()
            .flat_map(|bone| [bone.parent, bone.joint])
            .collect();
        joints.sort_unstable();
        joints.dedup();
        if joints.is_empty() {
            joints = (0..object.joints()).collect();
        }
        let is_lone = object.joints() == 1;
        let flesh = if is_lone {
            camera.lone_reach
        } else {
            camera.flesh * self.height
        };
        let least = if is_lone { camera.lone_height } else { 0.0 };
        let from = self.low[1] - flesh;
        let thick = ((self.high[1] + flesh).max(self.low[1] + least) - from) / camera.layers as f64;
        let mut reaches: Vec<Option<f64>> = vec![None; camera.layers];
        for frame in 0..object.frames() {
            let [x, z] = axis(frame);
            for &joint in &joints {
                let place = object.joint(frame, joint).map(f64::from);
                let reach = (place[0] - x).hypot(place[2] - z) + flesh;
                for side in [place[1] - flesh, place[1] + flesh] {
                    let layer = (((side - from) / thick) as usize).min(camera.layers - 1);
                    reaches[layer] = Some(reaches[layer].map_or(reach, |known| known.max(reach)));
                }
            }
        }
        let layers = reaches.iter().enumerate();
        let borders = layers.filter_map(|(layer, reach)| {
            let reach = (*reach)?;
            Some([layer, layer + 1].map(|layer| [reach, from + layer as f64 * thick]))
        });
        borders.flatten().collect()
    }
}

/// The frames in which distances are measured.
fn measured(frames: usize) -> impl Iterator<Item = usize> {
    (0..MEASURED).map(move |step| step * (frames - 1) / (MEASURED - 1))
}

/// A joint's name without its namespace.
fn bare(object: &SceneObject, joint: usize) -> &str {
    let name = object.joint_names.get(joint).map_or("", String::as_str);
    name.rsplit(':').next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::tests::{body, dancer};

    #[test]
    fn a_body_has_a_head_and_bones_of_its_size() {
        let figure = Figure::of(&body(40));
        assert!((1.3..1.7).contains(&figure.height), "{}", figure.height);
        assert_eq!(figure.bones.len(), 3);
        assert_eq!(figure.head, Some([1, 1]));
        let thick = DRAWING.bone.radius * figure.height;
        assert!(
            figure
                .bones
                .iter()
                .all(|bone| (bone.radius - thick).abs() < 1e-9)
        );
        assert!(!figure.goes_far());
        // Joints at a varying distance have no bone between them.
        let mut apart = body(40);
        for (frame, row) in apart.positions.chunks_exact_mut(12).enumerate() {
            row[3] += 0.1 * frame as f32;
        }
        let figure = Figure::of(&apart);
        assert_eq!((figure.bones.len(), figure.root), (2, 1));
        // Neither have a root on the floor and the body above it.
        let mut held = body(40);
        held.parents = vec![None, Some(0), Some(1), Some(1)];
        for row in held.positions.chunks_exact_mut(12) {
            row.copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.2, 1.5, 0.0, -0.2, 1.5, 0.0]);
        }
        assert_eq!(Figure::of(&held).root, 1);
    }

    #[test]
    fn a_path_on_the_ground_is_not_followed() {
        let mut far = dancer(200, 0.0);
        for (frame, place) in far.positions.chunks_exact_mut(3).enumerate() {
            place.copy_from_slice(&[0.1 * frame as f32, 1.0 + 0.01 * (frame % 2) as f32, 0.0]);
        }
        assert!(Figure::of(&far).goes_far());
        far.positions
            .chunks_exact_mut(3)
            .for_each(|place| place[1] = 0.0);
        assert!(!Figure::of(&far).goes_far());
    }

    #[test]
    fn an_outline_contains_the_figure() {
        let far = dancer(200, 0.0);
        let figure = Figure::of(&far);
        assert!(figure.bones.is_empty() && figure.height == DRAWING.camera.lone_size);
        let reach = figure
            .around_trajectory
            .iter()
            .map(|[reach, _]| *reach)
            .fold(0.0, f64::max);
        assert!((DRAWING.camera.lone_reach..0.8).contains(&reach), "{reach}");
        assert!(figure.around_middle.iter().any(|[reach, _]| *reach > 1.0));
    }
}
