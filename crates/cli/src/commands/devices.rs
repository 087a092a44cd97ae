//! `kinegrad devices`

use std::process::ExitCode;

use kinegrad_train::device;

use crate::failure::Failure;
use crate::output::table;

/// Lists the devices of this build, best first.
pub fn run() -> Result<ExitCode, Failure> {
    let header = ["device", "works here", "what it is"]
        .map(String::from)
        .to_vec();
    let rows = device::list().into_iter().map(|(info, works)| {
        vec![
            info.name,
            if works { "yes" } else { "no" }.to_string(),
            info.description,
        ]
    });
    say!("{}", table(std::iter::once(header).chain(rows)));
    let (_, chosen) = device::open("auto")?;
    say!("`auto` takes {chosen}");
    Ok(ExitCode::SUCCESS)
}
