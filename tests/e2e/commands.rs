//! The help of every command, as snapshots.

use kinegrad_tests::sandbox::Sandbox;

#[test]
fn help() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    for command in [
        "",
        "train",
        "sample",
        "import",
        "match",
        "merge",
        "check",
        "eval",
        "plot",
        "report",
        "runs",
        "view",
        "data",
        "data synth",
        "data prepare",
        "audio",
        "audio features",
        "text",
        "text embed",
        "data inspect",
        "config",
        "config show",
        "config explain",
        "init",
        "completions",
        "man",
        "devices",
    ] {
        let help = sandbox.run(&format!("{command} --help")).succeeded().stdout;
        let name = format!("help_{}", command.replace(' ', "_"));
        insta::with_settings!({ snapshot_path => "snapshots", prepend_module_to_snapshot => false }, {
            insta::assert_snapshot!(name, help);
        });
    }
}

#[test]
fn devices_lists_the_cpu_and_what_auto_takes() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let listed = sandbox.run("devices").succeeded().stdout;
    assert!(listed.contains("cpu") && listed.contains("yes"), "{listed}");
    assert!(listed.contains("`auto` selects"), "{listed}");
}

#[test]
fn wrong_arguments_exit_with_2() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("trian")
        .failed(2, &["unrecognized subcommand", "train"]);
    sandbox
        .run("train")
        .failed(2, &["kinegrad.toml", "kinegrad init"]);
    sandbox
        .run("sample nowhere --out s")
        .failed(2, &["nowhere", "hint:"]);
    sandbox
        .run("check nowhere.npy")
        .failed(2, &["nowhere.npy", "hint:"]);
    sandbox
        .run("plot nowhere --out p.svg")
        .failed(2, &["nowhere", "hint:"]);
    sandbox
        .run("data inspect nowhere")
        .failed(2, &["nowhere", "hint:"]);
}
