//! The tiny UNet, forward and backward, on wgpu (WGSL) against Flex.
//!
//! Without a GPU this runs on Mesa's llvmpipe (package `mesa-vulkan-drivers`), where compiling the
//! shaders takes minutes, hence the tiny sizes.
#![recursion_limit = "256"]

#[test]
fn wgpu_agrees_with_flex() {
    kinegrad_tests::parity::assert_parity("wgpu");
}
