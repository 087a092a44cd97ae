//! How scenes are drawn, on pages and in pictures: sizes, colors, figures and the camera.
//!
//! The viewer's script contains `table.json`: pages and pictures are drawn from the same numbers.
//! Sizes of figures are parts of their height; widths of lines are pixels.

mod camera;
mod figure;
mod stage;

pub(crate) use camera::{View, dot, seen_from};
pub(crate) use figure::Figure;
pub(crate) use stage::Stage;

use std::sync::LazyLock;

use serde::{Deserialize, Deserializer};

/// The table as text, for the viewer's script.
pub(crate) const TABLE: &str = include_str!("table.json");

/// The table.
pub(crate) static DRAWING: LazyLock<Drawing> =
    LazyLock::new(|| serde_json::from_str(TABLE).expect("the table has all numbers"));

/// Declares the groups of the table.
macro_rules! groups {
    ($($(#[$doc:meta])* $name:ident { $($field:ident: $kind:ty),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(crate) struct $name { $(pub $field: $kind),* }
    )*};
}

groups! {
    /// All numbers and colors.
    Drawing {
        camera: Camera,
        stage: StageLimits,
        floor: Floor,
        trail: Trail,
        goal: Goal,
        shadow: Shadow,
        bone: Bone,
        ball: Ball,
        contact: Contact,
        root: Root,
        label: Label,
        figures: Vec<Color>,
        light: Theme,
        dark: Theme,
    }
    /// The camera: angles in radians and degrees; meters for a lone root.
    Camera {
        view_degrees: f64,
        filled: f64,
        near: f64,
        yaw: f64,
        pitch: f64,
        smoothing_seconds: f64,
        layers: usize,
        flesh: f64,
        lone_reach: f64,
        lone_height: f64,
        lone_size: f64,
    }
    /// Limits of grounds and of a camera at rest, in heights, and the gap between panes.
    StageLimits { other_origin: f64, own_ground: f64, follow_beyond: f64, gap: f64 }
    /// The grid.
    Floor { size_per_cell: f64, most_cells: f64, reach: f64, width: f64 }
    /// The root trajectory.
    Trail {
        recent_seconds: f64,
        points: usize,
        recent_points: usize,
        width: f64,
        opacity: f64,
        recent_width: f64,
        recent_opacity: f64,
    }
    /// Path, key frames and obstacles.
    Goal {
        width: f64,
        dash: [f64; 2],
        area_opacity: f64,
        corners: usize,
        keyframe: f64,
        near_frames: usize,
        opacity: f64,
        near_opacity: f64,
        ring_width: f64,
        near_ring_width: f64,
    }
    /// Shadows.
    Shadow { width: f64, opacity: f64 }
    /// Bones.
    Bone {
        radius: f64,
        finger_radius: f64,
        most_of_length: f64,
        least_length: f64,
        most_spread: f64,
        most_root_length: f64,
        least_width: f64,
        edge: f64,
        left_lighter: f64,
        right_darker: f64,
    }
    /// The head, and joints without bones.
    Ball { head: f64, joint: f64, least: f64, edge: f64 }
    /// A joint that stands.
    Contact { ring: f64, ring_opacity: f64, dot: f64, least: f64, nearer: f64 }
    /// A lone root, meters: half sizes of its body, and radius and length of the arrow's parts.
    Root {
        body: [f64; 3],
        shaft: [f64; 2],
        head: [f64; 2],
        sides: usize,
        ball: f64,
        shadow: f64,
        line: f64,
        light: [f64; 3],
        lighter: f64,
        darker: f64,
        edge_darker: f64,
    }
    /// Names, pixels.
    Label {
        size: f64,
        left: f64,
        top: f64,
        square: f64,
        text_left: f64,
        keyframe_size: f64,
    }
    /// Colors of a page in light or dark. Pictures are light.
    Theme {
        page: Color,
        stage: Color,
        ink: Color,
        muted: Color,
        grid: Color,
        line: Color,
        button: Color,
        contact: Color,
        goal: Color,
        obstacle: Color,
        accent: Color,
        shadow: Color,
    }
}

impl Drawing {
    /// The color of a figure.
    pub fn color_of(&self, figure: usize) -> Color {
        self.figures[figure % self.figures.len()]
    }
}

impl Theme {
    /// The colors as CSS variables.
    pub fn css(&self) -> String {
        let colors = [
            ("page", self.page),
            ("stage", self.stage),
            ("ink", self.ink),
            ("muted", self.muted),
            ("grid", self.grid),
            ("line", self.line),
            ("button", self.button),
            ("contact", self.contact),
            ("goal", self.goal),
            ("obstacle", self.obstacle),
            ("accent", self.accent),
            ("shadow", self.shadow),
        ];
        let variables =
            colors.map(|(name, Color([r, g, b]))| format!("--kg-{name}: #{r:02x}{g:02x}{b:02x};"));
        variables.join(" ")
    }
}

/// Red, green and blue; `#rrggbb` in the table.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) struct Color(pub [u8; 3]);

/// White and black.
pub(crate) const WHITE: Color = Color([255; 3]);
pub(crate) const BLACK: Color = Color([0; 3]);

impl Color {
    /// The color `part` of the way to another.
    pub fn mixed(self, to: Self, part: f64) -> Self {
        let channel = |axis: usize| {
            let [from, to] = [self, to].map(|color| f64::from(color.0[axis]));
            (from + part * (to - from)).round() as u8
        };
        Self([0, 1, 2].map(channel))
    }
}

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let value = text.strip_prefix('#').filter(|digits| digits.len() == 6);
        let value = value.and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let [_, r, g, b] = value
            .ok_or_else(|| serde::de::Error::custom(format!("`{text}` is not a color")))?
            .to_be_bytes();
        Ok(Self([r, g, b]))
    }
}
