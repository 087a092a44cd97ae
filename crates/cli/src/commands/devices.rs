//! `kinegrad devices`

use std::process::ExitCode;

use kinegrad_report::table;
use kinegrad_train::{Error, device};

/// Lists the devices of this build, best first.
pub fn run() -> Result<ExitCode, Error> {
    let rows = device::list().map(|(kind, works)| {
        let works = if works { "yes" } else { "no" };
        [kind.name, works, kind.description].map(String::from)
    });
    show!("{}", table(["device", "works here", "description"], rows));
    let (_, chosen) = device::open("auto")?;
    say!("`auto` selects {chosen}");
    Ok(ExitCode::SUCCESS)
}
