//! The configs with the sources' own settings (`configs/sources`): each is valid, and trains with small
//! networks and data.

use std::fs;

use kinegrad_tests::golden::workspace;
use kinegrad_tests::sandbox::Sandbox;

const DIFFUSION: &str = "--set model.size=tiny --set model.num_head_channels=8";
const PHRASES: &str = "--set data.kind=synthetic --set data.synthetic.phrases=8 \
     --set data.synthetic.frames=24";
const CLIPS: &str = "--set data.source=walks";
const TRANSFORMER: &str = "--set model.latent_dim=24 --set model.num_layers=2 \
     --set model.num_heads=1 --set model.ff_size=40 --set evaluation.transition_frames=10";

#[test]
fn configs_of_the_sources_train() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox
        .run("data synth --walks --phrases 20 --frames 48 --out walks")
        .succeeded();
    let folder = workspace().join("configs/sources");
    let train = |name: &str, settings: &str| {
        let config = folder.join(name).with_extension("toml");
        let train = format!(
            "train {} {settings} --set run.device=cpu --set data.target_frames=20 \
             --set data.batch_size=4 --set data.num_workers=0 --set train.max_steps=2",
            config.display()
        );
        sandbox.run(&train).succeeded();
    };
    train("ccmotion", &format!("{DIFFUSION} {PHRASES}"));
    train("ccmotion_decoder", PHRASES);
    train("ccmotion_e2e", PHRASES);
    train("flow", &format!("{CLIPS} --set data.humanml3d.text=labels"));
    let base = workspace().join("configs/bpe.toml");
    let base = format!(
        "train {} {CLIPS} {TRANSFORMER} --set run.device=cpu --set data.num_workers=0 \
         --set data.batch_size=4 --set data.target_frames=20 --set train.max_steps=2",
        base.display()
    );
    sandbox.run(&base).succeeded();
    let guided = "--set model.latent_dim=16 --set model.dim_mults=[1.0,1.0] \
                  --set model.padded_frames=20";
    for name in ["gmd_motion", "gmd_trajectory"] {
        // Captions have no embeddings here.
        let text = "--set data.humanml3d.text=labels";
        train(name, &format!("{CLIPS} {guided} {text}"));
    }
    train("flowmdm_path", &format!("{CLIPS} {TRANSFORMER}"));
    let configs = fs::read_dir(folder).expect("a folder").flatten();
    let configs = configs.filter(|file| file.path().extension().is_some_and(|end| end == "toml"));
    assert_eq!(configs.count(), 7, "each config is trained above");
}
