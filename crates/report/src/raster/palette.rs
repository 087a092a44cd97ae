//! Colors of pictures. The number of colors is small, so that GIF palettes are exact.

pub(crate) const BACKGROUND: [u8; 3] = [255, 255, 255];
pub(crate) const GRID: [u8; 3] = [226, 228, 232];
pub(crate) const SHADOW: [u8; 3] = [205, 208, 214];
/// The root trajectory.
pub(crate) const TRAIL: [u8; 3] = [158, 166, 180];
/// Limbs of each side; the middle is trunk, head and joints without a side.
pub(crate) const LEFT: [u8; 3] = [222, 107, 40];
pub(crate) const RIGHT: [u8; 3] = [38, 112, 190];
pub(crate) const MIDDLE: [u8; 3] = [74, 84, 102];
/// Edges of limbs.
pub(crate) const EDGE: [u8; 3] = [28, 32, 40];
/// Front of an oriented body, and the pointer in front.
pub(crate) const FRONT: [u8; 3] = [92, 160, 222];
pub(crate) const NOSE: [u8; 3] = [240, 168, 36];
/// A foot on the ground.
pub(crate) const CONTACT: [u8; 3] = [52, 168, 83];
/// A goal: its path, key frames and obstacles.
pub(crate) const PATH: [u8; 3] = [86, 150, 86];
pub(crate) const KEYFRAME: [u8; 3] = [140, 70, 170];
pub(crate) const OBSTACLE: [u8; 3] = [214, 120, 120];
pub(crate) const TEXT: [u8; 3] = [60, 66, 78];

const COLOURS: [[u8; 3]; 14] = [
    GRID, SHADOW, TRAIL, LEFT, RIGHT, MIDDLE, EDGE, FRONT, NOSE, CONTACT, PATH, KEYFRAME, OBSTACLE,
    TEXT,
];

/// Steps from the background to each color, for anti-aliased edges.
const STEPS: usize = 4;

/// The palette of GIFs: the background and four steps to every other color.
pub(crate) const PALETTE: [[u8; 3]; 1 + STEPS * COLOURS.len()] = {
    let mut palette = [BACKGROUND; 1 + STEPS * COLOURS.len()];
    let mut colour = 0;
    while colour < COLOURS.len() {
        let mut step = 1;
        while step <= STEPS {
            let mut channel = 0;
            while channel < 3 {
                let from = BACKGROUND[channel] as usize * (STEPS - step);
                let mixed = (from + COLOURS[colour][channel] as usize * step) / STEPS;
                palette[colour * STEPS + step][channel] = mixed as u8;
                channel += 1;
            }
            step += 1;
        }
        colour += 1;
    }
    palette
};
