//! UNets described by golden files.

use kinegrad_cc_motion::network::UNet1d;
use kinegrad_cc_motion::network::UNet1dConfig;
use kinegrad_models::Initializer;
use serde_json::Value;

/// The network of a golden file's JSON, for 25 motion channels, without dropout, with new weights.
///
/// # Panics Panics if the text is not a description of a network.
pub fn fresh(json: &str, init: &Initializer) -> UNet1d {
    let json: Value = serde_json::from_str(json).expect("the description is JSON");
    let number = |key: &str| json[key].as_u64().expect("a number") as usize;
    let numbers = |key: &str| -> Vec<usize> {
        let list = json[key].as_array().expect("a list");
        list.iter()
            .map(|n| n.as_u64().expect("a number") as usize)
            .collect()
    };
    let config = UNet1dConfig {
        model_channels: number("base"),
        channel_mult: numbers("mult"),
        num_res_blocks: number("nres"),
        attention_levels: Some(numbers("attn_levels")),
        num_heads: number("heads"),
        use_scale_shift_norm: true,
        time_embed_dim: number("time_dim"),
        context_dim: number("ctx_dim"),
        dropout: 0.0,
        ..UNet1dConfig::default()
    };
    let network = config.init(25, number("cond_dim"), init);
    network.expect("a valid network")
}
