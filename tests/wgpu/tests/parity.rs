//! The tiny UNet, forward and backward, and the optimiser on wgpu (WGSL) against Flex.
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
