//! Prints the measures of both kinds of emphasis projection for 263 features, as a Markdown table.
//!
//! `cargo run -p kinegrad-motion --example emphasis_table`

use kinegrad_motion::emphasis::{EmphasisConfig, EmphasisError, EmphasisKind};

const HEADING: &str = "\
| kind | scale | condition number | variance min | mean | max | std | trajectory share \
| round trip max | mean |
|---|---|---|---|---|---|---|---|---|---|";

fn main() -> Result<(), EmphasisError> {
    println!("{HEADING}");
    for (name, kind) in [
        ("gaussian", EmphasisKind::Gaussian),
        ("orthogonal", EmphasisKind::Orthogonal),
    ] {
        for scale in [1.0, 2.0, 5.0, 10.0] {
            let config = EmphasisConfig {
                kind,
                scale,
                ..EmphasisConfig::default()
            };
            let projection = config.projection(263)?.expect("a kind that projects");
            let m = projection.measure(0);
            println!(
                "| {name} | {scale} | {:.1} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.1e} | {:.1e} |",
                m.condition_number,
                m.variance_min,
                m.variance_mean,
                m.variance_max,
                m.variance_std,
                m.trajectory_share,
                m.round_trip_max,
                m.round_trip_mean
            );
        }
    }
    Ok(())
}
