//! `config explain`, and the page of all keys.

use std::fs;

use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::Sandbox;

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

#[test]
fn the_page_of_all_keys_is_what_the_program_says() {
    let path = workspace().join("docs/config.md");
    let page = sandbox()
        .run("config explain --markdown")
        .succeeded()
        .stdout;
    if std::env::var_os("KINEGRAD_UPDATE").is_some() {
        fs::write(&path, &page).expect("docs/config.md");
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == page,
        "docs/config.md is out of step: write it again with KINEGRAD_UPDATE=1"
    );
    // The page contains no Rust type names.
    for line in page.lines() {
        assert!(!line.contains("::"), "{line}");
    }
}

#[test]
fn keys_are_explained() {
    let sandbox = sandbox();
    for (name, key) in [
        ("key", "optim.lr_schedule"),
        ("last_part", "start_timesteps"),
        ("table", "checkpoint"),
        ("kinds", "model.size"),
        ("goal", "obstacle"),
        ("plan", "take.segment"),
    ] {
        let said = sandbox
            .run(&format!("config explain {key}"))
            .succeeded()
            .stdout;
        insta::with_settings!({ snapshot_path => "snapshots", prepend_module_to_snapshot => false }, {
            insta::assert_snapshot!(format!("explain_{name}"), said);
        });
    }
    let all = sandbox.run("config explain").succeeded().stdout;
    for key in ["optim.learning_rate: ", "take[].motion: ", "keyframe[].x: "] {
        assert!(all.contains(key), "{key} in {all}");
    }
    sandbox.run("config explain optim.lerning_rate").failed(
        2,
        &["optim.lerning_rate", "did you mean `optim.learning_rate`?"],
    );
    sandbox
        .run("config explain zzz")
        .failed(2, &["`kinegrad config explain` lists every key"]);
}
