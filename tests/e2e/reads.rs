//! What a command reads: the state of a checkpoint once, and each table of a config once.

use std::collections::BTreeMap;
use std::fs;

use kinegrad_tests::sandbox::{Sandbox, finish};

/// How often each line that begins with `start` is logged by a command, by its rest.
fn logged(sandbox: &Sandbox, arguments: &str, start: &str) -> BTreeMap<String, usize> {
    let mut command = sandbox.command(arguments.split_whitespace());
    command.env("RUST_LOG", "kinegrad_train=trace");
    let finished = finish(command).succeeded();
    let mut counts = BTreeMap::new();
    for rest in finished
        .stderr
        .lines()
        .filter_map(|line| line.strip_prefix(start))
    {
        *counts.entry(rest.to_string()).or_default() += 1;
    }
    counts
}

#[test]
fn a_state_and_a_table_are_read_once_a_command() {
    let sandbox = crate::goals::trained();
    sandbox.write("goal.toml", crate::goals::GOAL);
    let sample = "sample runs/gmd_motion --steps 2 --goal goal.toml --out a \
                  --trajectory-run runs/gmd_trajectory";
    let eval = "eval runs/gmd_motion --trajectory-run runs/gmd_trajectory --steps 2 \
                --set evaluation.goals=2";
    for command in [sample, eval] {
        let states = logged(&sandbox, &format!("{command} --verbose"), "debug: reading ");
        let states: Vec<_> = states
            .iter()
            .filter(|(path, _)| path.ends_with("state.json"))
            .collect();
        assert_eq!(states.len(), 2, "{command}: {states:?}");
        assert!(states.iter().all(|(_, count)| **count == 1), "{states:?}");
    }
    // One config: its common tables, and those of its system.
    let plain = "sample runs/gmd_motion --out b";
    let tables = logged(&sandbox, plain, "trace: parsing ");
    assert!(
        tables.keys().any(|line| line.contains("GmdConfig")),
        "{tables:?}"
    );
    assert!(tables.values().all(|count| *count == 1), "{tables:?}");
    let stated = fs::read_dir(sandbox.path("runs/gmd_motion/checkpoints")).expect("checkpoints");
    assert!(stated.count() > 1, "a run with several checkpoints");
}
