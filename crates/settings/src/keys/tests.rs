use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::*;

/// Colours.
#[derive(Default, Deserialize, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
enum Colour {
    /// As blood.
    #[default]
    Red,
    /// As
    /// grass.
    LightGreen,
}

#[derive(Deserialize, JsonSchema, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Shape {
    /// A circle.
    Disc {
        /// Metres.
        radius: f64,
    },
    /// A ball.
    Ball {
        /// Metres.
        radius: f64,
    },
    /// A square.
    Square(Side),
}

#[derive(Default, Deserialize, JsonSchema, Serialize)]
#[serde(default)]
struct Side {
    /// Length of a side.
    side: f64,
}

#[derive(Deserialize, JsonSchema, Serialize)]
struct Nested<T> {
    /// How many.
    count: u32,
    #[serde(flatten)]
    shape: T,
}

#[derive(Default, Deserialize, JsonSchema, Serialize)]
#[serde(default)]
struct Document {
    /// True if [`Colour`] counts, see [there](Self::colour).
    bright: bool,
    /// The colour, in [0, 1].
    colour: Colour,
    /// Maybe.
    again: Option<Colour>,
    /// Two.
    pair: [f64; 2],
    /// By name.
    groups: BTreeMap<String, f64>,
    /// A table that may be missing.
    side: Option<Side>,
    /// One shape.
    main: Option<Nested<Shape>>,
    /// Shapes.
    #[serde(rename = "shape")]
    shapes: Vec<Nested<Shape>>,
    /// A number below or above 0.
    offset: i64,
}

fn key(name: &str) -> Key {
    let keys = keys_of::<Document>();
    let names: Vec<&str> = keys.iter().map(|key| key.name.as_str()).collect();
    let found = keys.iter().find(|key| key.name == name);
    found
        .unwrap_or_else(|| panic!("no {name} in {names:?}"))
        .clone()
}

#[test]
fn meanings_are_the_doc_comments_without_links() {
    assert_eq!(key("bright").meaning, "True if `Colour` counts, see there.");
    assert_eq!(key("colour").meaning, "The colour, in [0, 1].");
}

#[test]
fn values_are_said_in_words() {
    for (name, words) in [
        ("bright", "true or false"),
        ("colour", "\"red\" or \"light_green\""),
        ("again", "\"red\" or \"light_green\""),
        ("pair", "a list of 2; each: a number"),
        (
            "groups",
            "a table of `name = value` entries; each: a number",
        ),
        ("side", "a table"),
        ("side.side", "a number"),
        ("shape", "tables, one for each"),
        ("shape[].count", "a whole number, 0 or more"),
        ("shape[].kind", "\"disc\", \"ball\" or \"square\""),
        ("offset", "a whole number"),
    ] {
        assert_eq!(key(name).values.to_string(), words, "{name}");
    }
    assert_eq!(key("colour").values.names()[1].meaning, "As grass.");
}

#[test]
fn keys_of_one_kind_of_table_say_so_and_defaults_are_those_of_the_types() {
    assert_eq!(
        key("shape[].radius").only_with.as_deref(),
        Some("shape[].kind = \"disc\", \"ball\"")
    );
    assert_eq!(
        key("shape[].side").only_with.as_deref(),
        Some("shape[].kind = \"square\"")
    );
    assert_eq!(key("shape[].kind").values.names()[0].meaning, "A circle.");
    for name in ["main.radius", "main.side", "main.count", "main.kind"] {
        key(name);
    }
    assert_eq!(key("colour").default, Some("red".into()));
    assert!(key("shape[].count").required && !key("colour").required);
    assert_eq!(key("again").default, Some(serde_json::Value::Null));
}
