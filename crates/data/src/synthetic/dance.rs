//! The motion of a synthetic phrase: four moves in time with the music.

use std::f64::consts::{PI, TAU};

use kinegrad_motion::{FPS, Phrase, Quaternion, derive};
use kinegrad_random::Key;

use super::music::{BEATS_PER_BAR, MOVES, Music};
use super::style;

/// Stream below a phrase's key.
const DANCER: u64 = 3;

/// Position and rotation of the body in its own frame, meters and radians.
#[derive(Clone, Copy, Default)]
struct Pose {
    /// Right, up, forward.
    offset: [f64; 3],
    yaw: f64,
    /// Nodding forward.
    pitch: f64,
    /// Leaning sideways.
    roll: f64,
}

/// Pose of move `kind` at a beat: sway, step to and fro, circle or bounce. At bar lines the pose is
/// at its origin.
fn pose(kind: usize, beat: f64) -> Pose {
    let (bar, half, whole) = (0.5 * PI * beat, PI * beat, TAU * beat);
    match kind {
        0 => Pose {
            offset: [0.16 * half.sin(), 0.012 * whole.cos(), 0.0],
            yaw: 0.25 * half.sin(),
            pitch: 0.05 * whole.cos(),
            roll: -0.12 * half.sin(),
        },
        1 => Pose {
            offset: [0.0, 0.018 * whole.cos(), 0.24 * bar.sin()],
            yaw: 0.10 * bar.sin(),
            pitch: 0.12 * bar.cos(),
            roll: 0.04 * half.sin(),
        },
        2 => Pose {
            offset: [
                0.26 * bar.sin(),
                0.012 * whole.cos(),
                0.26 * (1.0 - bar.cos()),
            ],
            yaw: 0.60 * bar.sin(),
            pitch: 0.06,
            roll: -0.08 * bar.sin(),
        },
        _ => Pose {
            offset: [0.06 * half.sin(), 0.042 * whole.cos(), 0.02 * half.cos()],
            yaw: 0.12 * half.sin(),
            pitch: 0.10 * whole.cos(),
            roll: 0.0,
        },
    }
}

/// The dance to `music`, `frames` frames long. The first frame is at x = z = 0.
pub fn perform(music: &Music, phrase: Key, frames: usize) -> Phrase {
    assert!(frames > 0, "a phrase has at least one frame");
    let samples = phrase.at(DANCER).normals(4);
    let [heading, height, drift_x, drift_z] = [0, 1, 2, 3].map(|i| f64::from(samples[i]));
    let heading = 0.3 * heading.clamp(-3.0, 3.0);
    let height = 0.95 + 0.03 * height.clamp(-3.0, 3.0);
    let facing = Quaternion::from_yaw(heading);

    // The last frames need two more frames for their forward differences.
    let posed = frames + 2;
    let mut positions = Vec::with_capacity(posed);
    let mut quaternions = Vec::with_capacity(posed);
    let mut phase = Vec::with_capacity(posed);
    for t in 0..posed {
        let beat = music.beat(t);
        let size = music.energy(beat);
        let pose = blended(music.moves(beat), beat);
        let [right, up, forward] = pose.offset.map(|metres| size * metres);
        // The drift is slow and independent of the music.
        let slow = (TAU * 0.1 * t as f64 / FPS).sin();
        let [x, y, z] = facing.rotate([right, up, forward]);
        positions.push([
            x + 0.05 * drift_x * slow,
            y + height,
            z + 0.05 * drift_z * slow,
        ]);
        let turn = Quaternion::from_yaw(heading + size * pose.yaw)
            * Quaternion::from_rotation_vector([size * pose.pitch, 0.0, 0.0])
            * Quaternion::from_rotation_vector([0.0, 0.0, size * pose.roll]);
        quaternions.push(turn);
        phase.push((beat / BEATS_PER_BAR).fract());
    }
    let [x0, _, z0] = positions[0];
    for position in &mut positions {
        position[0] -= x0;
        position[2] -= z0;
    }
    let style = style::describe(&positions, &quaternions);
    derive(&positions, &quaternions, &phase, &style)
        .expect("arrays of one length, at least one frame")
        .slice(0..frames)
}

/// A weighted mean of moves.
fn blended(shares: [f64; MOVES], beat: f64) -> Pose {
    let mut sum = Pose::default();
    for (kind, share) in shares.into_iter().enumerate() {
        let pose = pose(kind, beat);
        for (total, part) in sum.offset.iter_mut().zip(pose.offset) {
            *total += share * part;
        }
        sum.yaw += share * pose.yaw;
        sum.pitch += share * pose.pitch;
        sum.roll += share * pose.roll;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_repeat_every_bar_and_differ() {
        for kind in 0..MOVES {
            for step in 0..32 {
                let beat = f64::from(step) / 8.0;
                let (now, later) = (pose(kind, beat), pose(kind, beat + BEATS_PER_BAR));
                for axis in 0..3 {
                    assert!((now.offset[axis] - later.offset[axis]).abs() < 1e-12);
                }
            }
            for other in 0..kind {
                let apart = (0..32).any(|step| {
                    let beat = f64::from(step) / 8.0;
                    let (a, b) = (pose(kind, beat).offset, pose(other, beat).offset);
                    (0..3).any(|axis| (a[axis] - b[axis]).abs() > 0.04)
                });
                assert!(apart, "moves {kind} and {other} look alike");
            }
        }
    }
}
