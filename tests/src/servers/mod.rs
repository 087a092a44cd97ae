//! Servers that tests start themselves, on loopback: real emulators of Google Cloud Storage and
//! S3, and a web server and proxy that injects faults.

mod emulator;
mod faulty;

pub use emulator::{Emulator, gcs, s3};
pub use faulty::{Fault, FaultyServer, Upstream};

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};

/// A free port; another process may take it.
fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a loopback port");
    listener.local_addr().expect("an address").port()
}

/// Sends one request and returns the whole answer, head and body.
fn request(server: SocketAddr, head: &str, body: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut stream = TcpStream::connect(server)?;
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    Ok(answer)
}
