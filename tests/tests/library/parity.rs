//! The tiny UNet, forward and backward, and a training of each system, on every backend of this build
//! except Flex. wgpu has its own package, `tests/wgpu`.

#[cfg(any(feature = "ndarray", feature = "cuda"))]
use kinegrad_tests::devices::assert_systems_run;
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

#[cfg(feature = "ndarray")]
#[test]
fn each_system_trains_resumes_and_samples_on_ndarray() {
    assert_systems_run("ndarray");
}

#[cfg(feature = "cuda")]
#[test]
fn cuda_agrees_with_flex() {
    assert_parity("cuda");
}

#[cfg(feature = "cuda")]
#[test]
fn each_system_trains_resumes_and_samples_on_cuda() {
    assert_systems_run("cuda");
}
