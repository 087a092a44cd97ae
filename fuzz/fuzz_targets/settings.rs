//! The other files of settings. The first letter selects the kind: `c` for configs of training, `j`
//! for joint maps, `k` for key frames, `p` for body parts and `t` for paths.

#![no_main]

use std::sync::LazyLock;

use kinegrad_capture::Bvh;
use kinegrad_capture::clips::JointMap;
use kinegrad_fuzz::{MIB, TOML, bounded, follow};
use kinegrad_matching::{Example, Keyframe, MatrixOptions, MotionMatrix, Part};
use kinegrad_motion::humanml::Skeleton;
use kinegrad_motion::path::PathPlan;
use kinegrad_systems::BUILT_IN;
use libfuzzer_sys::fuzz_target;

const FILE: &str = "fuzzed.toml";

const BODY: &str = "HIERARCHY ROOT Hips { OFFSET 0 90 0 CHANNELS 6 Xposition Yposition Zposition \
                    Zrotation Xrotation Yrotation JOINT Spine { OFFSET 0 20 0 CHANNELS 3 Zrotation \
                    Xrotation Yrotation End Site { OFFSET 0 20 0 } } JOINT Leg { OFFSET 9 0 0 \
                    CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 0 -80 0 } } }\n\
                    MOTION\nFrames: 2\nFrame Time: 0.05\n\
                    0 90 0 0 0 0 0 0 0 0 0 0\n1 90 0 0 0 0 0 0 0 0 0 0\n";

static LAYOUT: LazyLock<MotionMatrix> = LazyLock::new(|| {
    let bvh = Bvh::parse(BODY.as_bytes(), "body.bvh").expect("a body");
    let file = "body.bvh".to_owned();
    MotionMatrix::new(&[Example { file, bvh }], MatrixOptions::default()).expect("a layout")
});

static SKELETON: LazyLock<Skeleton> = LazyLock::new(Skeleton::humanml3d);

// A config has about a thousand keys, which tables with all defaults contain. A spline has 64
// straight pieces of 16 bytes for each point of six bytes of text.
fuzz_target!(|text: &str| {
    let limit = 4 * MIB + 2 * TOML * text.len();
    let Some(kind) = text.chars().next() else {
        return;
    };
    let text = &text[kind.len_utf8()..];
    match kind {
        'c' => {
            let read = bounded(limit, || BUILT_IN.parse(text, FILE, &[]));
            if let Ok(config) = read {
                let _ = bounded(limit, || BUILT_IN.validate(&config));
            }
        }
        'j' => {
            let _ = bounded(limit, || JointMap::parse(FILE, text, &SKELETON));
        }
        'k' => {
            let _ = bounded(limit, || Keyframe::read(text, FILE));
        }
        'p' => {
            let joints = LAYOUT.joints().len();
            if let Ok(parts) = bounded(limit, || Part::read(text, FILE, &LAYOUT)) {
                let mut all: Vec<usize> = parts.into_iter().flat_map(|part| part.joints).collect();
                all.sort_unstable();
                all.dedup();
                assert_eq!(all, (0..joints).collect::<Vec<_>>());
            }
        }
        't' => {
            let read = bounded(limit, || PathPlan::read(text, FILE, None));
            if let Ok(plan) = read {
                bounded(limit, || follow(&plan));
            }
        }
        _ => {}
    }
});
