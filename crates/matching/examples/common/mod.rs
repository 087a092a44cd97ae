//! Shared by the examples.

use kinegrad_capture::Bvh;
use kinegrad_matching::Example;

/// The motion in a BVH file.
pub fn read(file: &str) -> Example {
    let bytes = std::fs::read(file).expect("a file");
    let bvh = Bvh::parse(&bytes, file).expect("BVH");
    let file = file.to_string();
    Example { file, bvh }
}
