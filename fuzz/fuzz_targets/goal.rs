//! Goals: `Goal::parse`, and the targets, detours and warnings of an accepted goal.

#![no_main]

use kinegrad_fuzz::{MIB, TOML, bounded};
use kinegrad_motion::MAX_FRAMES;
use kinegrad_motion::goal::{Goal, GroundTargets};
use libfuzzer_sys::fuzz_target;

// A goal has at most 216000 frames, each with a target of 24 bytes.
fuzz_target!(|text: &str| {
    let limit = 32 * MIB + TOML * text.len();
    let Ok(goal) = bounded(limit, || Goal::parse(text, "fuzzed.toml")) else {
        return;
    };
    assert!(goal.frames <= MAX_FRAMES);
    let views: [fn(&Goal) -> GroundTargets; 3] =
        [Goal::points, Goal::dense, Goal::around_obstacles];
    for view in views {
        let targets = bounded(limit, || view(&goal));
        assert_eq!(targets.frames(), goal.frames);
        for (frame, [x, z]) in targets.masked() {
            assert!(x.is_finite() && z.is_finite(), "frame {frame}: {x}, {z}");
        }
    }
    bounded(limit, || goal.feasibility_warnings(20.0, 3.0));
});
