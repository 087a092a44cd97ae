//! Errors about unreadable configs, as a snapshot.

use kinegrad_tests::sandbox::{SMALLEST, Sandbox};

#[test]
fn errors_of_configs_name_place_key_and_remedy() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    let mut said = String::new();
    for setting in [
        "learning_rate=1e-3",
        "train.batch_size=4",
        "optim.lerning_rate=1",
        "emphasis.scale=2",
        "train.max_steps=many",
        "train.max_steps=-1",
        "train.max_steps=1.5",
        "optim.learning_rate=fast",
        "data.augment.mirror=1",
        "run.name=3",
        "optim.betas=[0.9]",
        "optim.betas=0.9",
        "optim.lr_schedule=3",
        "optim.lr_schedule=cosin",
        "optim=3",
        "optim.offload=gpu",
        "train.precision=fp16",
        "data.source=3",
        "init.diffusion=1",
        "lora.targets=[1]",
        "optim.groups.unet=no",
    ] {
        let shown = sandbox.run(&format!("config show c.toml --set {setting}"));
        said.push_str(&shown.failed(2, &["hint:"]).stderr);
        said.push('\n');
    }
    sandbox.write(
        "bad.toml",
        "[run]\nseed = 1\n\n[train]\nmax_steps = \"ten\"\n",
    );
    let shown = sandbox.run("config show bad.toml");
    said.push_str(&shown.failed(2, &["bad.toml:5", "hint:"]).stderr);
    insta::with_settings!({ snapshot_path => "snapshots", prepend_module_to_snapshot => false }, {
        insta::assert_snapshot!("config_errors", said);
    });
}

#[test]
fn a_key_that_a_trained_model_may_change_is_suggested() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    sandbox
        .run("sample runs/smallest --out s --set num_inference_steps=2")
        .failed(2, &["did you mean `sampling.sampler.num_inference_steps`?"]);
    sandbox
        .run("sample runs/smallest --out s --set optim.learning_rate=2")
        .failed(2, &["the model is trained", "for example"]);
}
