//! Prints what both kinds of emphasis projection come to at 263 features, as a Markdown table.
//!
//! `cargo run -p kinegrad-motion --example emphasis_table`

use kinegrad_motion::emphasis::{EmphasisError, EmphasisRow, compare};

fn main() -> Result<(), EmphasisError> {
    println!("{}", EmphasisRow::HEADING);
    for row in compare(263, &[1.0, 2.0, 5.0, 10.0], 0)? {
        println!("{row}");
    }
    Ok(())
}
