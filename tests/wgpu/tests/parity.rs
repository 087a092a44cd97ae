//! The tiny UNet, forward and backward, the optimiser, and a training of each system on wgpu (WGSL)
//! against Flex.
//!
//! Without a GPU this runs on Mesa's llvmpipe (package `mesa-vulkan-drivers`), where compiling the
//! shaders takes minutes, hence the tiny sizes.
#![recursion_limit = "256"]

#[test]
fn wgpu_agrees_with_flex() {
    kinegrad_tests::parity::assert_parity("wgpu");
}

#[test]
fn the_optimiser_on_wgpu_agrees_with_the_one_in_main_memory() {
    kinegrad_tests::parity::assert_optimizer_parity("wgpu");
}

#[test]
fn each_system_trains_resumes_and_samples_on_wgpu() {
    kinegrad_tests::devices::assert_systems_run("wgpu");
}
