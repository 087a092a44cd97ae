//! The program of golden tests. Each test declares its reference files, and a test that compares
//! nothing fails.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_golden::{Folder, Golden, counting};
use libtest_mimic::{Arguments, FormatSetting, Trial};

#[cfg(test)]
mod tests;

/// The forms in which a test receives a declared reference file.
pub trait Opened {
    /// Opens the file.
    ///
    /// # Panics
    /// Panics if it cannot be read.
    fn open(path: &Path) -> Self;
}

impl Opened for Golden {
    fn open(path: &Path) -> Self {
        Self::read(path)
    }
}

impl Opened for PathBuf {
    fn open(path: &Path) -> Self {
        path.to_owned()
    }
}

/// A golden test: a name, its files and its body. Made by [`trials!`](crate::trials!).
pub struct GoldenTest {
    name: String,
    files: &'static [&'static str],
    body: fn(&Folder),
}

impl GoldenTest {
    /// The test `name` of `module`, a value of `module_path!`.
    pub fn new(
        module: &str,
        name: &str,
        files: &'static [&'static str],
        body: fn(&Folder),
    ) -> Self {
        let name = match module.split_once("::") {
            Some((_, module)) => format!("{module}::{name}"),
            None => name.to_owned(),
        };
        Self { name, files, body }
    }

    /// The test on the files of `folder`. If one is missing, the test is listed as ignored; it
    /// fails if the folder must be complete or if it is run anyway. A `silent` test does not print
    /// its measured errors.
    pub fn trial(self, folder: &Folder, silent: bool) -> Trial {
        let Self { name, files, body } = self;
        let absent = files.iter().filter(|file| !folder.path(file).exists());
        let absent: Vec<&str> = absent.copied().collect();
        if absent.is_empty() {
            let folder = folder.clone();
            return Trial::test(name, move || match counting(silent, || body(&folder)) {
                0 => Err("compared nothing".into()),
                _ => Ok(()),
            });
        }
        let reason = format!("no {}", absent.join(", "));
        let failure = format!("{reason} in {}", folder.root().display());
        let trial = Trial::test(name, move || Err(failure.into()));
        match folder.must_be_complete() {
            true => trial,
            false => trial.with_kind(reason).with_ignored_flag(true),
        }
    }
}

/// Golden tests, each with its files; the functions take their contents (see [`Opened`]). A test
/// whose function has another name, or more arguments, names it after an arrow.
///
/// ```
/// use kinegrad_tests::golden::Golden;
/// use kinegrad_tests::trials;
///
/// fn golden_blocks(golden: Golden) {}
/// fn schedule(golden: Golden, timesteps: usize) {}
///
/// let tests = trials![
///     golden_blocks("ccmotion/03_blocks.safetensors"),
///     golden_long("ccmotion/01_schedules.safetensors") => |golden| schedule(golden, 1000),
/// ];
/// assert_eq!(tests.len(), 2);
/// ```
#[macro_export]
macro_rules! trials {
    (@body $name:ident) => { $name };
    (@body $name:ident $body:expr) => { $body };
    ($($name:ident($($file:literal),+) $(=> $body:expr)?),+ $(,)?) => {
        vec![$($crate::trials::GoldenTest::new(
            module_path!(),
            stringify!($name),
            &[$($file),+],
            |folder| {
                let body = $crate::trials!(@body $name $($body)?);
                body($($crate::trials::Opened::open(&folder.path($file))),+)
            },
        )),+]
    };
}

/// Runs the tests that the command line selects, like `cargo test` and `cargo nextest`, and prints
/// their number.
pub fn run(tests: Vec<GoldenTest>) -> ExitCode {
    let arguments = Arguments::from_args();
    let folder = Folder::in_use();
    let trial = |test: GoldenTest| test.trial(&folder, !arguments.nocapture);
    let conclusion = libtest_mimic::run(&arguments, tests.into_iter().map(trial).collect());
    // Lists and JSON are for programs.
    if !arguments.list && arguments.format != Some(FormatSetting::Json) {
        let run = conclusion.num_passed + conclusion.num_failed;
        println!(
            "golden comparisons: {run} run, {} left out",
            conclusion.num_ignored
        );
    }
    conclusion.exit_code()
}
