//! The features of a frame, joint by joint.

use burn::tensor::Tensor;
use kinegrad_motion::humanml::FeatureLayout;

/// Channels of a joint's previous state: position 3, rotation 6, velocity 3.
pub const PREVIOUS_STATE: usize = 12;

fn layout(joints: usize) -> FeatureLayout {
    FeatureLayout::of_joints(joints).expect("the joints of a skeleton")
}

/// Channels `range` of feature rows, `width` channels per joint.
fn each(rows: &Tensor<2>, range: std::ops::Range<usize>, width: usize) -> Tensor<3> {
    let (count, joints) = (rows.dims()[0], range.len() / width);
    rows.clone()
        .narrow(1, range.start, range.len())
        .reshape([count, joints, width])
}

/// The positions of the joints, `[rows, J, 3]`, for rows `[rows, channels]`. The root is at (0,
/// root height, 0); other joints are in the facing frame.
pub(super) fn positions(rows: &Tensor<2>, joints: usize) -> Tensor<3> {
    let height = rows.clone().narrow(1, FeatureLayout::ROOT.end - 1, 1);
    let ground = height.zeros_like();
    let root = Tensor::cat(vec![ground.clone(), height, ground], 1).unsqueeze_dim(1);
    Tensor::cat(vec![root, each(rows, layout(joints).positions(), 3)], 1)
}

/// The displacements of the joints to the next frame in the facing frame, `[rows, J, 3]`.
pub(super) fn velocities(rows: &Tensor<2>, joints: usize) -> Tensor<3> {
    each(rows, layout(joints).velocities(), 3)
}

/// Root rotation, ground velocity and height, and the contact flags, `[rows, 8]`.
pub(super) fn whole_body(rows: &Tensor<2>, joints: usize) -> Tensor<2> {
    let part = |range: std::ops::Range<usize>| rows.clone().narrow(1, range.start, range.len());
    let contacts = layout(joints).contacts();
    Tensor::cat(vec![part(FeatureLayout::ROOT), part(contacts)], 1)
}

/// The state of each joint in the last frame of a history: position, first two columns of the
/// rotation, velocity. The root is at (0, root height, 0) without rotation. Source:
/// docs/sources.md, section 5.
///
/// # Shapes
/// - last: `[batch, 12 J - 1]`
/// - output: `[batch, 12, J]`
///
/// # Panics
/// If no skeleton has this number of channels.
pub fn previous_state(last: Tensor<2>) -> Tensor<3> {
    let [batch, channels] = last.dims();
    let joints = (channels + 1) / PREVIOUS_STATE;
    let unturned = Tensor::<3>::from_data([[[1.0f32, 0.0, 0.0, 0.0, 1.0, 0.0]]], &last.device());
    let unturned = unturned.expand([batch, 1, 6]);
    let others = each(&last, layout(joints).rotations(), 6);
    let (positions, velocities) = (positions(&last, joints), velocities(&last, joints));
    let rotations = Tensor::cat(vec![unturned, others], 1);
    Tensor::cat(vec![positions, rotations, velocities], 2).swap_dims(1, 2)
}
