//! The features of a frame, joint by joint.

use burn::tensor::Tensor;
use kinegrad_motion::humanml::FeatureLayout;

/// Channels of a joint's previous state: position 3, rotation 6, velocity 3.
pub const PREVIOUS_STATE: usize = 12;

/// The layout of features of so many joints.
pub(super) fn layout(joints: usize) -> FeatureLayout {
    FeatureLayout::of_joints(joints).expect("the joints of a skeleton")
}

/// Channels `range` of rows of features, `width` for each of the joints that have them.
fn each(rows: &Tensor<2>, range: std::ops::Range<usize>, width: usize) -> Tensor<3> {
    let (count, joints) = (rows.dims()[0], range.len() / width);
    rows.clone()
        .narrow(1, range.start, range.len())
        .reshape([count, joints, width])
}

/// The position of each joint: the root at (0, its height, 0), the others in the facing frame.
///
/// # Shapes
/// - rows: `[rows, channels]`
/// - output: `[rows, J, 3]`
pub(super) fn positions(rows: &Tensor<2>, joints: usize) -> Tensor<3> {
    let height = rows.clone().narrow(1, FeatureLayout::ROOT.end - 1, 1);
    let ground = height.zeros_like();
    let root = Tensor::cat(vec![ground.clone(), height, ground], 1).unsqueeze_dim(1);
    Tensor::cat(vec![root, each(rows, layout(joints).positions(), 3)], 1)
}

/// The displacement of each joint to the next frame in the facing frame.
///
/// # Shapes
/// - rows: `[rows, channels]`
/// - output: `[rows, J, 3]`
pub(super) fn velocities(rows: &Tensor<2>, joints: usize) -> Tensor<3> {
    each(rows, layout(joints).velocities(), 3)
}

/// Features of the whole body: root rotation, ground velocity and height, and the contact
/// flags.
///
/// # Shapes
/// - rows: `[rows, channels]`
/// - output: `[rows, 8]`
pub(super) fn whole_body(rows: &Tensor<2>, joints: usize) -> Tensor<2> {
    let part = |range: std::ops::Range<usize>| rows.clone().narrow(1, range.start, range.len());
    let contacts = layout(joints).contacts();
    Tensor::cat(vec![part(FeatureLayout::ROOT), part(contacts)], 1)
}

/// The state of each joint in the last frame of a history: position, the first two columns of its
/// rotation, velocity. The root is at (0, its height, 0), unturned. Source: docs/sources.md, section
/// 5.
///
/// # Shapes
/// - last: `[batch, 12 J - 1]`
/// - output: `[batch, 12, J]`
///
/// # Panics
/// Panics if no skeleton has features of so many channels.
pub fn previous_state(last: Tensor<2>) -> Tensor<3> {
    let [batch, channels] = last.dims();
    let joints = (channels + 1) / PREVIOUS_STATE;
    let unturned = Tensor::<3>::from_data([[[1.0f32, 0.0, 0.0, 0.0, 1.0, 0.0]]], &last.device());
    let rotations = Tensor::cat(
        vec![
            unturned.expand([batch, 1, 6]),
            each(&last, layout(joints).rotations(), 6),
        ],
        1,
    );
    let parts = vec![
        positions(&last, joints),
        rotations,
        velocities(&last, joints),
    ];
    Tensor::cat(parts, 2).swap_dims(1, 2)
}
