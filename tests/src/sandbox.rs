//! Running the binary in its own folder.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// A temporary folder in which the binary is run.
pub struct Sandbox {
    folder: TempDir,
    binary: PathBuf,
}

/// The result of the binary.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// A config that trains a network of 95 thousand parameters in about a second: two levels, 24
/// frames, dropout and condition dropout on.
pub const SMALLEST: &str = r#"
[run]
name = "smallest"
device = "cpu"
[data]
kind = "synthetic"
target_frames = 24
batch_size = 4
num_workers = 0
[data.synthetic]
phrases = 12
frames = 40
[model]
size = "tiny"
channel_mult = [1, 1]
num_res_blocks = 1
time_embed_dim = 32
context_dim = 32
[optim]
warmup_steps = 5
learning_rate = 1e-3
[train]
max_steps = 40
[ema]
decay = 0.9
update_every = 1
[checkpoint]
every_steps = 4
[validation]
every_steps = 10
draws = 2
"#;

/// A config that trains a network on synthetic walks in about a second: two levels, 16 frames. The
/// recipe is not set: `train.recipe` is `gmd_motion` or `gmd_trajectory`.
pub const SMALLEST_WALKS: &str = r#"
[run]
name = "smallest"
device = "cpu"
[data]
kind = "synthetic_walks"
target_frames = 16
batch_size = 4
num_workers = 0
[data.synthetic]
phrases = 12
frames = 48
[model]
kind = "gmd_unet"
latent_dim = 16
dim_mults = [1.0, 1.0]
padded_frames = 20
[optim]
warmup_steps = 5
learning_rate = 1e-3
[train]
recipe = "gmd_motion"
max_steps = 40
[ema]
decay = 0.9
[checkpoint]
every_steps = 4
[validation]
every_steps = 10
draws = 2
[sampling.sampler]
num_inference_steps = 6
"#;

/// [`SMALLEST_WALKS`] for clips in the folder `walks`.
pub fn smallest_walks_on_disk() -> String {
    SMALLEST_WALKS.replace(
        "kind = \"synthetic_walks\"",
        "kind = \"humanml3d\"\nsource = \"walks\"",
    )
}

impl Sandbox {
    /// An empty folder for the binary at `binary`.
    pub fn new(binary: &str) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        Self {
            folder,
            binary: PathBuf::from(binary),
        }
    }

    /// A path in the folder.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file in the folder.
    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("inside the folder")).expect("folders");
        std::fs::write(&path, text).expect("a file");
        path
    }

    /// The binary with these arguments, not started.
    pub fn command<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Command {
        let mut command = Command::new(&self.binary);
        command
            .args(arguments)
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .env("XDG_CACHE_HOME", self.path(".cache"))
            .env_remove("RUST_BACKTRACE")
            .stdin(Stdio::null());
        command
    }

    /// Runs the binary to its end; the arguments are separated by spaces.
    pub fn run(&self, arguments: &str) -> Finished {
        finish(self.command(arguments.split_whitespace()))
    }

    /// Starts the binary and returns at once.
    pub fn start(&self, arguments: &str) -> Child {
        let mut command = self.command(arguments.split_whitespace());
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary starts")
    }

    /// Names in a folder, sorted; empty if it does not exist.
    pub fn list(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder))
            .into_iter()
            .flatten()
            .flatten();
        let mut names: Vec<String> = entries
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }
}

/// Name and bytes of every file below a folder, sorted.
pub fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(next).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
                continue;
            }
            let name = path.strip_prefix(folder).expect("below the folder");
            let bytes = std::fs::read(&path).expect("a file");
            found.push((name.display().to_string(), bytes));
        }
    }
    found.sort();
    found
}

/// Waits for a result of `process`.
///
/// # Panics
///
/// Panics if the process ends without it, or after two minutes.
#[track_caller]
pub fn wait_for(process: &mut Child, what: &str, mut come: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(120);
    while !come() {
        // It may have arrived just before the end.
        if let Some(status) = process.try_wait().expect("a status") {
            assert!(come(), "{status} before {what}");
            return;
        }
        assert!(Instant::now() < deadline, "two minutes without {what}");
        sleep(Duration::from_millis(2));
    }
}

/// Runs a command to its end.
pub fn finish(mut command: Command) -> Finished {
    let output = command.output().expect("the binary runs");
    Finished {
        code: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

impl Finished {
    /// Asserts success and returns the output.
    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(
            self.code,
            Some(0),
            "stdout:\n{}\nstderr:\n{}",
            self.stdout,
            self.stderr
        );
        self
    }

    /// Asserts the exit code, and that standard error contains each of the texts.
    #[track_caller]
    pub fn failed(self, code: i32, texts: &[&str]) -> Self {
        assert_eq!(
            self.code,
            Some(code),
            "stdout:\n{}\nstderr:\n{}",
            self.stdout,
            self.stderr
        );
        for text in texts {
            assert!(
                self.stderr.contains(text),
                "no `{text}` in:\n{}",
                self.stderr
            );
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        self
    }
}
