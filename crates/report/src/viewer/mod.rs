//! Pages that show a [`Scene`]: 3D motion with music, curves and floor marks. A page is a
//! self-contained file.
//!
//! Positions are exact to 0.2 mm (see [`encode`]). Drawing uses a 2D canvas and no GPU, so a page
//! can have any number of viewers.

mod encode;
#[cfg(test)]
mod tests;
mod thumbnail;

pub use thumbnail::Thumbnail;

use std::sync::LazyLock;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

use crate::drawing::{DRAWING, Figure, TABLE};
use crate::escape::escape;
use crate::scene::{Contact, Origins, Scene, SceneObject, Song};

/// Content security policy of pages with viewers, for `<meta
/// http-equiv="Content-Security-Policy">`: no external content.
pub const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; \
    style-src 'unsafe-inline'; img-src data: blob:; media-src data: blob:";

/// The style sheet of viewers, for elements of class `kg`.
pub fn style() -> &'static str {
    static STYLE: LazyLock<String> = LazyLock::new(|| {
        let [light, dark] = [&DRAWING.light, &DRAWING.dark].map(|theme| theme.css());
        format!(
            ".kg, .kg-page {{ {light} }}\n@media (prefers-color-scheme: dark) {{ .kg, .kg-page {{ \
             {dark} }} }}\n{}",
            include_str!("viewer.css")
        )
    });
    &STYLE
}

/// The script of viewers. The script fills every [`embed`] of a loaded page, and lists the viewers
/// in `window.kinegrad.viewers`.
pub fn script() -> &'static str {
    static SCRIPT: LazyLock<String> = LazyLock::new(|| {
        let files = [
            include_str!("data.js"),
            include_str!("camera.js"),
            include_str!("draw.js"),
            include_str!("curves.js"),
            include_str!("origins.js"),
            include_str!("clock.js"),
            include_str!("viewer.js"),
        ];
        let files = files.concat();
        format!("(() => {{\n\"use strict\";\nconst DRAWING = {TABLE};\n{files}}})();\n")
    });
    &SCRIPT
}

/// Delimiters of the data of a viewer.
const DATA: [&str; 2] = ["<script type=\"application/json\">", "</script>"];

/// The scene as an element of a page with [`style`] and [`script`].
pub fn embed(scene: &Scene) -> String {
    element(&scene.title, &scene_json(scene, false), "kg")
}

fn element(title: &str, data: &Value, class: &str) -> String {
    let [begin, end] = DATA;
    format!(
        "<section class=\"{class}\" aria-label=\"{}\">{begin}{}{end}<noscript>JavaScript shows \
         the motion.</noscript></section>",
        escape(title),
        inert(data),
    )
}

/// A page of the scene.
pub fn page(scene: &Scene) -> String {
    let title = escape(&scene.title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{CONTENT_SECURITY_POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>{title}</title>\n<style>\n{}</style>\n</head>\n<body class=\"kg-page\">\n\
         <h1>{title}</h1>\n{}\n<script>\n{}</script>\n</body>\n</html>\n",
        style(),
        embed(scene),
        script(),
    )
}

/// JSON without `<`: this character occurs only in strings and could end the script.
fn inert(json: &Value) -> String {
    json.to_string().replace('<', "\\u003c")
}

fn scene_json(scene: &Scene, small: bool) -> Value {
    let objects = scene.objects.iter();
    let objects: Vec<Value> = objects.map(|object| object_json(object, small)).collect();
    let song = scene.song.as_ref().filter(|_| !small);
    json!({
        "title": scene.title,
        "figures": objects,
        "floor": scene.floor,
        "song": song.map(song_json),
    })
}

fn object_json(object: &SceneObject, small: bool) -> Value {
    let frames = object.frames();
    let parents = object.parents.iter();
    let parents = parents.map(|parent| parent.map_or(-1, |parent| parent as i64));
    let contacts = object.contacts.iter();
    let charts = object.curves.iter().filter(|_| !small);
    let series: Vec<&[f32]> = charts
        .clone()
        .flat_map(|chart| chart.series.iter().map(|(_, values)| values.as_slice()))
        .collect();
    let named = charts.map(|chart| {
        let names: Vec<&str> = chart.series.iter().map(|(name, _)| name.as_str()).collect();
        json!({ "title": chart.title, "series": names })
    });
    json!({
        "name": object.name,
        "fps": object.fps,
        "frames": frames,
        "joints": object.joint_names,
        "parents": parents.collect::<Vec<_>>(),
        "positions": encode::positions(&object.positions, object.joints()),
        "orientations": object.orientations.as_deref().map(encode::orientations),
        "contacts": contacts.map(contact_json).collect::<Vec<_>>(),
        "charts": named.collect::<Vec<_>>(),
        "curves": encode::curves(&series, frames),
        "measures": (frames > 0).then(|| Figure::of(object).json()),
        "origins": object.origins.as_ref().filter(|_| !small).map(origins_json),
    })
}

fn origins_json(origins: &Origins) -> Value {
    let examples = origins.examples.iter();
    let examples = examples.map(|(name, frames)| json!({ "name": name, "frames": frames }));
    json!({ "examples": examples.collect::<Vec<_>>(), "parts": origins.parts })
}

/// A contact as half-open frame ranges.
fn contact_json(contact: &Contact) -> Value {
    let mut ranges: Vec<[usize; 2]> = Vec::new();
    for frame in (0..contact.frames.len()).filter(|frame| contact.frames[*frame]) {
        match ranges.last_mut() {
            Some([_, end]) if *end == frame => *end += 1,
            _ => ranges.push([frame, frame + 1]),
        }
    }
    json!({ "joint": contact.joint, "ranges": ranges })
}

fn song_json(song: &Song) -> Value {
    let data = BASE64_STANDARD.encode(&song.bytes);
    json!({
        "src": format!("data:{};base64,{data}", song.format.media_type()),
        "start": song.start,
        "beats": song.beats,
    })
}
