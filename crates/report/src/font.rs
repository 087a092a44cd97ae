//! The font of pictures.

use plotters::style::{FontStyle, register_font};

/// Registers a built-in font, so that pictures are equal on every machine. Repeated calls are
/// harmless.
pub(crate) fn register() {
    let font = epaint_default_fonts::UBUNTU_LIGHT;
    let registered = register_font("sans-serif", FontStyle::Normal, font);
    debug_assert!(registered.is_ok(), "the built-in font is one");
}
