//! Checkpoints with valid checksums and invalid content.

use std::fs;

use super::*;
use crate::config::plain;

fn state() -> State {
    let config = plain("", &[]);
    State {
        format: FORMAT,
        kinegrad: "0.1.0".into(),
        step: 3,
        steps_per_epoch: None,
        config,
        statistics: Default::default(),
        network_statistics: None,
        dataset_sha256: None,
        progress: Progress::default(),
        checksums: Default::default(),
    }
}

fn info(name: &str) -> ParameterInfo {
    ParameterInfo {
        name: name.into(),
        shape: vec![2],
    }
}

/// Saves two weights; returns the checkpoint's folder.
fn saved(run: &Path) -> std::path::PathBuf {
    let values = vec![vec![1.0, 2.0], vec![3.0, 4.0]];
    let infos = [info("a"), info("b")];
    write_weights(run, &state(), &infos, &values, &values).expect("saved")
}

/// The reason that the checkpoint in `path` is damaged.
fn damage(path: &Path) -> String {
    match Checkpoint::read(path) {
        Err(Error::CheckpointDamaged { reason, .. }) => reason,
        other => panic!("{other:?}"),
    }
}

#[test]
fn averages_of_other_weights_are_damage() {
    let run = tempfile::tempdir().expect("a folder");
    let path = saved(run.path());
    Checkpoint::read(&path).expect("a good checkpoint");
    // A file of the same length and with another checksum.
    let mut state = State::read(&path).expect("a state");
    let file = Weights::Ema.file();
    let one = [("b".to_string(), &[4][..], &[1.0f32, 2.0, 3.0, 4.0][..])];
    let checksum = tensors::write(&path.join(file), one).expect("written");
    state.checksums.insert(file.into(), checksum);
    fs::write(path.join("state.json"), state.to_text()).expect("written");
    assert!(damage(&path).contains("other tensors"));
}

#[test]
fn numbers_that_no_config_can_hold_are_damage() {
    let run = tempfile::tempdir().expect("a folder");
    let path = saved(run.path());
    let mut state = State::read(&path).expect("a state");
    state.config.train.max_steps = Some(u64::MAX);
    fs::write(path.join("state.json"), state.to_text()).expect("written");
    let reason = damage(&path);
    assert!(reason.contains("`train.max_steps`"), "{reason}");
}

#[test]
fn numbers_that_are_not_finite_are_named_before_they_are_saved_and_never_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let checkpoints = Checkpoints::of(folder.path());
    let infos = [info("weight")];
    let good = [vec![1.0f32, 2.0]];
    let means = |exp_avg_sq: Vec<f32>| Moments {
        exp_avg: vec![0.0; 2],
        exp_avg_sq,
    };
    let good_means = [means(vec![0.0; 2])];
    let save = |step, model: &[_], ema: &[_], moments: &[_]| {
        let mut unfinished = checkpoints.begin(step).expect("a folder");
        for (weights, values) in [(Weights::Model, model), (Weights::Ema, ema)] {
            let written = unfinished.write_weights(weights, &infos, values);
            written.expect("written");
        }
        unfinished.write_moments(&infos, moments).expect("written");
        let state = State { step, ..state() };
        unfinished.finish(&state).expect("saved")
    };
    let broken = |model: &[_], ema: &[_], moments: &[_]| {
        broken_weights(Weights::Model, &infos, model)
            .or_else(|| broken_weights(Weights::Ema, &infos, ema))
            .or_else(|| broken_moments(&infos, moments))
    };
    assert_eq!(broken(&good, &good, &good_means), None);
    save(1, &good, &good, &good_means);

    let bad = [vec![1.0f32, f32::NAN]];
    let bad_means = [means(vec![f32::INFINITY, 0.0])];
    for (model, ema, moments, what) in [
        (&bad, &good, &good_means, "the parameter"),
        (&good, &bad, &good_means, "the averaged"),
        (&good, &good, &bad_means, "running mean"),
    ] {
        let named = broken(model, ema, moments).expect(what);
        assert!(
            named.contains(what) && named.contains("`weight`"),
            "{named}"
        );
        // Its checksums are right.
        let path = save(2, model, ema, moments);
        let mut skipped = Vec::new();
        let newest = checkpoints.newest_good(|error| skipped.push(error.to_string()));
        let newest = newest.expect("listed").expect("a good one");
        assert_eq!(newest.state.step, 1);
        assert!(skipped[0].contains("not finite"), "{skipped:?}");
        fs::remove_dir_all(&path).expect("removed");
    }
}
