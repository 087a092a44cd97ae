//! A stand-in for the viewer: it names what would move.

use std::fmt::Write;

use crate::page::escape;
use crate::scene::Scene;

/// Style of embedded scenes, once a page.
pub fn style() -> &'static str {
    ".viewer-stub { border: 1px solid var(--line); border-radius: 8px; padding: 40px 12px; }\n"
}

/// Script of embedded scenes, once a page, after them.
pub fn script() -> &'static str {
    ""
}

/// A scene as part of a page.
pub fn embed(scene: &Scene, _small: bool) -> String {
    let mut out = String::new();
    for figure in &scene.figures {
        let (name, frames) = (escape(&figure.name), figure.frames());
        let _ = writeln!(out, "<div class=viewer-stub>{name}: {frames} frames</div>");
    }
    out
}

/// A scene as a page of its own.
pub fn page(scene: &Scene) -> String {
    format!("<!doctype html>\n{}", embed(scene, false))
}
