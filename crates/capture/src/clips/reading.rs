//! The body of a single capture, without a plan.

use kinegrad_motion::humanml::{Joints, Skeleton};

use super::body::Body;
use super::clip::Grounded;
use crate::plan::Units;
use crate::{Bvh, Error, UpAxis};

const HINT: &str = "`kinegrad data prepare` reads captures of other bodies, with a joint map and units of \
                    their own (docs/dataset.md)";

/// The joints of a capture as those of [`Skeleton::humanml3d`], `[frames, 22]`, in metres with +y
/// up, at the skeleton's frame rate, with the feet on the floor, and notes about the capture. With
/// `retarget`, the body has the bones of the skeleton. `file` is the capture's name for messages;
/// `units` and `up` are as for [`Body::of_bvh`].
///
/// # Errors
/// [`Error::Name`] for joints that no built-in map names, and bodies that are not understood.
pub fn read_body(
    bvh: &Bvh,
    file: &str,
    units: Option<Units>,
    up: Option<UpAxis>,
    retarget: bool,
) -> Result<(Joints, Vec<String>), Error> {
    let refused = |problem: String| Error::Name {
        problem: format!("{file}: {problem}"),
        hint: HINT.to_owned(),
    };
    let skeleton = Skeleton::humanml3d();
    let body = Body::of_bvh(bvh, units, up).map_err(refused)?;
    let joints = body.at_rate(skeleton.description().fps);
    let grounded = Grounded::new(&skeleton, &joints, retarget)?;
    Ok((grounded.joints, body.notes))
}
