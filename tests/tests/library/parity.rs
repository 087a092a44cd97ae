//! The tiny UNet, forward and backward, on every backend of this build except Flex. wgpu has its
//! own package, `tests/wgpu`.

use kinegrad_tests::parity::{assert_optimizer_parity, assert_parity};

#[test]
fn flex_agrees_with_itself() {
    assert_parity("cpu");
}

#[test]
fn the_optimiser_in_burns_operations_agrees_with_the_one_in_main_memory() {
    assert_optimizer_parity("cpu");
}

#[cfg(feature = "ndarray")]
#[test]
fn ndarray_agrees_with_flex() {
    assert_parity("ndarray");
}

#[cfg(feature = "cuda")]
#[test]
fn cuda_agrees_with_flex() {
    assert_parity("cuda");
}
