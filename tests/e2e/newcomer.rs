//! First steps: `init`, `completions`, `man`, and training without a config.

use std::fs;
use std::process::Command;

use kinegrad_tests::sandbox::{Sandbox, finish};

fn sandbox() -> Sandbox {
    Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"))
}

#[test]
fn init_and_train_work_in_an_empty_folder() {
    let sandbox = sandbox();
    let written = sandbox.run("init").succeeded();
    assert_eq!(written.stdout, "kinegrad.toml\n");
    let config = fs::read_to_string(sandbox.path("kinegrad.toml")).expect("a file");
    assert!(
        written.stderr.contains("kinegrad train"),
        "{}",
        written.stderr
    );
    sandbox
        .run("train --set train.max_steps=2 --set sampling.count_at_end=1 --set data.synthetic.phrases=12")
        .succeeded();
    assert!(sandbox.path("runs/quickstart/config.toml").exists());
    sandbox.write("kinegrad.toml", "mine");
    sandbox
        .run("init")
        .failed(2, &["kinegrad.toml exists already", "--out"]);
    assert_eq!(
        fs::read(sandbox.path("kinegrad.toml")).expect("a file"),
        b"mine"
    );
    let printed = sandbox.run("init --out -").succeeded().stdout;
    assert_eq!(printed, config);
    assert!(!sandbox.path("-").exists());
    sandbox.run("init --out other.toml").succeeded();
    assert!(sandbox.path("other.toml").exists());
}

#[test]
fn every_config_that_is_listed_can_be_written_and_shown() {
    let sandbox = sandbox();
    let listed = sandbox.run("init --list").succeeded().stdout;
    insta::with_settings!({ snapshot_path => "snapshots", prepend_module_to_snapshot => false }, {
        insta::assert_snapshot!("init_list", listed);
    });
    for name in listed
        .lines()
        .filter_map(|line| line.split_whitespace().next())
    {
        sandbox.run(&format!("init {name}")).succeeded();
        if !matches!(name, "prepare" | "bodies" | "goal" | "compose") {
            let show = format!("config show {name}.toml --set data.source=set");
            // Its initial checkpoint is missing, which gives a warning.
            let shown = sandbox.run(&show).succeeded();
            assert!(shown.stdout.contains("[train]"), "{}", shown.stdout);
        }
    }
    sandbox.run("init quickstrat").failed(
        2,
        &[
            "gmd_motion_tiny",
            "did you mean `kinegrad init quickstart`?",
        ],
    );
    sandbox
        .run("train nowhere.toml")
        .failed(2, &["nowhere.toml", "kinegrad init"]);
}

#[test]
fn bash_completes_commands_and_options() {
    let sandbox = sandbox();
    for shell in ["zsh", "fish", "powershell", "elvish"] {
        let script = sandbox.run(&format!("completions {shell}")).succeeded();
        assert!(script.stdout.contains("prepare"), "{shell}");
    }
    let script = sandbox.run("completions bash").succeeded().stdout;
    let script = sandbox.write("kinegrad.bash", script);
    let complete = |words: &str| {
        let list: Vec<&str> = words.split(' ').collect();
        let (last, before) = (list[list.len() - 1], list[list.len() - 2]);
        let asked = format!(
            "source '{}'; COMP_WORDS=({words}); COMP_CWORD={}; _kinegrad kinegrad '{last}' \
             '{before}'; echo \"${{COMPREPLY[@]}}\"",
            script.display(),
            list.len() - 1,
        );
        let mut bash = Command::new("bash");
        bash.args(["--norc", "-c", &asked]);
        finish(bash).succeeded().stdout
    };
    assert_eq!(complete("kinegrad tra").trim(), "train");
    assert_eq!(complete("kinegrad config expl").trim(), "explain");
    assert!(complete("kinegrad train --res").contains("--resume"));
}

#[test]
fn manual_pages_are_written_and_can_be_rendered() {
    let sandbox = sandbox();
    sandbox.run("man --out pages").succeeded();
    let pages = sandbox.list("pages");
    for page in [
        "kinegrad.1",
        "kinegrad-train.1",
        "kinegrad-config-explain.1",
    ] {
        assert!(pages.contains(&page.to_owned()), "{pages:?}");
    }
    let source = fs::read_to_string(sandbox.path("pages/kinegrad-train.1")).expect("a page");
    assert!(
        source.contains(".TH") && source.contains("resume"),
        "{source}"
    );
    let mut groff = Command::new("groff");
    groff
        .args(["-man", "-Tascii", "-P-c", "-P-b", "-P-u"])
        .arg(sandbox.path("pages/kinegrad-train.1"));
    if let Ok(rendered) = groff.output() {
        let text = String::from_utf8_lossy(&rendered.stdout).into_owned();
        assert!(
            text.contains("SYNOPSIS") && text.contains("config file"),
            "{text}"
        );
    }
}
