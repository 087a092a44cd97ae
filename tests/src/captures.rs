//! Synthetic captures and songs for tests, and a plan that pairs them.

use crate::sandbox::Sandbox;

/// A BVH file of a root that walks a circle, at 60 frames per second, in centimetres.
pub fn bvh(frames: usize) -> String {
    let mut text = String::from(
        "HIERARCHY\nROOT Hips\n{\n OFFSET 0 90 0\n CHANNELS 6 Xposition Yposition Zposition \
         Zrotation Xrotation Yrotation\n End Site\n {\n  OFFSET 0 10 0\n }\n}\nMOTION\n",
    );
    text.push_str(&format!("Frames: {frames}\nFrame Time: 0.0166667\n"));
    for frame in 0..frames {
        let turn = frame as f64 / 90.0;
        let (x, z) = (100.0 * turn.cos(), 100.0 * turn.sin());
        let y = 90.0 + 2.0 * (7.0 * turn).sin();
        text.push_str(&format!("{x} {y} {z} 0 0 {}\n", -turn.to_degrees()));
    }
    text
}

/// Clicks at 120 beats per minute over a tone, as 16-bit WAV at 44100 Hz.
pub fn wav(seconds: usize) -> Vec<u8> {
    let rate = 44_100usize;
    let samples: Vec<i16> = (0..seconds * rate)
        .map(|n| {
            let beat = (n % (rate / 2)) as f64 / rate as f64;
            let click = (-beat * 60.0).exp() * (beat * 9000.0).sin();
            let tone = (n as f64 * 0.03).sin();
            (12_000.0 * click + 2_000.0 * tone) as i16
        })
        .collect();
    encoded(&samples)
}

/// Clicks at the given times in seconds over a tone, as 16-bit WAV at 44100 Hz.
pub fn clicks(moments: &[f64], seconds: f64) -> Vec<u8> {
    let rate = 44_100.0;
    let samples: Vec<i16> = (0..(seconds * rate) as usize)
        .map(|n| {
            let now = n as f64 / rate;
            let begun = moments.partition_point(|moment| *moment <= now);
            let click = begun.checked_sub(1).map_or(0.0, |last| {
                let since = now - moments[last];
                (-since * 60.0).exp() * (since * 9000.0).sin()
            });
            (12_000.0 * click + 2_000.0 * (n as f64 * 0.03).sin()) as i16
        })
        .collect();
    encoded(&samples)
}

/// Samples at 44100 Hz as a WAV file.
fn encoded(samples: &[i16]) -> Vec<u8> {
    let rate = 44_100u32;
    let data: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
    let mut bytes = b"RIFF".to_vec();
    bytes.extend((36 + data.len() as u32).to_le_bytes());
    bytes.extend(b"WAVEfmt ");
    bytes.extend(16u32.to_le_bytes());
    bytes.extend([1, 0, 1, 0]);
    bytes.extend(rate.to_le_bytes());
    bytes.extend((2 * rate).to_le_bytes());
    bytes.extend([2, 0, 16, 0]);
    bytes.extend(b"data");
    bytes.extend((data.len() as u32).to_le_bytes());
    bytes.extend(data);
    bytes
}

/// A plan of the files that [`write()`] makes.
pub const PLAN: &str = r#"
output = "set"
[phrases]
frames = 40
hop = 20
[split]
validation = ["two_*"]
[[take]]
motion = "captures/*.bvh"
audio = "songs/{name}.*"
audio_start_seconds = 0.5
[[take]]
name = "alone"
motion = "captures/one.bvh"
motion_end_seconds = 3.0
audio = "none"
beats = { start_seconds = 0.0, seconds_per_beat = 0.5, beats_per_bar = 4 }
"#;

/// Writes the files of [`PLAN`] and the plan itself.
pub fn write(sandbox: &Sandbox) {
    sandbox.write("captures/one.bvh", bvh(360));
    sandbox.write("captures/two.bvh", bvh(300));
    sandbox.write("songs/one.wav", wav(7));
    sandbox.write("songs/two.wav", wav(4));
    sandbox.write("plan.toml", PLAN);
}
