//! A web server and proxy that injects faults.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use super::request;

/// The source of answers for requests without a fault.
#[derive(Clone, Debug)]
pub enum Upstream {
    /// The files of a folder.
    Folder(PathBuf),
    /// Another server.
    Server(SocketAddr),
}

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// This status code instead of an answer.
    Status(u16),
    /// The connection is reset before an answer.
    Reset,
    /// The answer ends in the middle of its body.
    Truncate,
    /// Half of the body, then a long pause.
    Stall,
    /// One byte of the body is changed.
    Corrupt,
    /// The answer is delayed.
    Slow,
    /// An answer that states ten bytes and comes in chunks, up to 256 MiB.
    Endless,
    /// A refusal with the same body.
    EndlessRefusal,
    /// A byte of a stated length of 2,000 every 50 ms.
    Trickle,
}

/// The remaining faults, and the requests.
#[derive(Debug, Default)]
struct Plan {
    /// Part of the path, fault, and count.
    faults: Vec<(String, Fault, usize)>,
    injected: usize,
    requests: Vec<String>,
    under_way: usize,
    most_under_way: usize,
    /// Mebibytes of endless answers.
    endless_mib: usize,
}

/// A server on loopback. Dropping it ends it.
#[derive(Debug)]
pub struct FaultyServer {
    address: SocketAddr,
    plan: Arc<Mutex<Plan>>,
    stopped: Arc<AtomicBool>,
    acceptor: Option<JoinHandle<()>>,
}

impl FaultyServer {
    /// Serves `upstream`, at first without faults.
    ///
    /// # Panics
    /// Panics if there is no loopback port.
    pub fn start(upstream: Upstream) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a loopback port");
        let address = listener.local_addr().expect("an address");
        let plan = Arc::new(Mutex::new(Plan::default()));
        let stopped = Arc::new(AtomicBool::new(false));
        let (shared, stop) = (plan.clone(), stopped.clone());
        let acceptor = std::thread::spawn(move || {
            for stream in listener.incoming() {
                if stop.load(Ordering::SeqCst) {
                    return;
                }
                let (plan, upstream, stop) = (shared.clone(), upstream.clone(), stop.clone());
                if let Ok(stream) = stream {
                    // Ignores clients that disconnect.
                    std::thread::spawn(move || serve(stream, &upstream, &plan, &stop));
                }
            }
        });
        Self {
            address,
            plan,
            stopped,
            acceptor: Some(acceptor),
        }
    }

    /// Its base address.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The next `times` requests whose path contains `path` fail.
    ///
    /// # Panics Panics if a thread of the server panicked.
    pub fn inject(&self, path: &str, fault: Fault, times: usize) {
        let mut plan = self.plan.lock().expect("the plan");
        plan.faults.push((path.to_owned(), fault, times));
    }

    /// The peak of concurrent requests since the last call.
    ///
    /// # Panics Panics if a thread of the server panicked.
    pub fn take_most_under_way(&self) -> usize {
        std::mem::take(&mut self.plan.lock().expect("the plan").most_under_way)
    }

    /// Number of injected faults so far.
    ///
    /// # Panics Panics if a thread of the server panicked.
    pub fn injected(&self) -> usize {
        self.plan.lock().expect("the plan").injected
    }

    /// Mebibytes of endless answers that clients took so far.
    ///
    /// # Panics Panics if a thread of the server panicked.
    pub fn endless_mib(&self) -> usize {
        self.plan.lock().expect("the plan").endless_mib
    }

    /// Number of requests so far whose path contains `path`.
    ///
    /// # Panics Panics if a thread of the server panicked.
    pub fn requests(&self, path: &str) -> usize {
        let plan = self.plan.lock().expect("the plan");
        plan.requests.iter().filter(|p| p.contains(path)).count()
    }
}

impl Drop for FaultyServer {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::SeqCst);
        // Wakes the acceptor.
        let _ = TcpStream::connect(self.address);
        if let Some(acceptor) = self.acceptor.take() {
            let _ = acceptor.join();
        }
    }
}

/// Answers one request and closes the connection.
fn serve(stream: TcpStream, upstream: &Upstream, plan: &Mutex<Plan>, stop: &AtomicBool) {
    let Some((head, body)) = read_request(&stream) else {
        return;
    };
    let under_way = UnderWay::begin(plan);
    answer(stream, &head, &body, upstream, under_way, stop);
}

/// A request that is being answered. It is dropped before the answer is written, because a client
/// that has read the answer may send the next request at once.
struct UnderWay<'a>(&'a Mutex<Plan>);

impl<'a> UnderWay<'a> {
    fn begin(plan: &'a Mutex<Plan>) -> Self {
        let mut counted = plan.lock().expect("the plan");
        counted.under_way += 1;
        counted.most_under_way = counted.most_under_way.max(counted.under_way);
        drop(counted);
        Self(plan)
    }
}

impl Drop for UnderWay<'_> {
    fn drop(&mut self) {
        if let Ok(mut plan) = self.0.lock() {
            plan.under_way -= 1;
        }
    }
}

fn answer(
    mut stream: TcpStream,
    head: &str,
    body: &[u8],
    upstream: &Upstream,
    under_way: UnderWay,
    stop: &AtomicBool,
) {
    let path = head.split(' ').nth(1).unwrap_or_default().to_owned();
    let fault = {
        let mut plan = under_way.0.lock().expect("the plan");
        plan.requests.push(path.clone());
        let due = plan
            .faults
            .iter_mut()
            .find(|(part, _, times)| *times > 0 && path.contains(part.as_str()));
        let fault = due.map(|(_, fault, times)| {
            *times -= 1;
            *fault
        });
        plan.injected += usize::from(fault.is_some());
        fault
    };
    match fault {
        Some(Fault::Status(status)) => {
            let answer = format!(
                "HTTP/1.1 {status} Fault\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            );
            drop(under_way);
            let _ = stream.write_all(answer.as_bytes());
            return;
        }
        Some(Fault::Reset) => {
            drop(under_way);
            reset(stream);
            return;
        }
        Some(Fault::Slow) => std::thread::sleep(Duration::from_millis(200)),
        Some(Fault::Endless) => return endless(stream, "200 OK", under_way.0),
        Some(Fault::EndlessRefusal) => return endless(stream, "403 Forbidden", under_way.0),
        Some(Fault::Trickle) => return trickle(stream),
        _ => {}
    }
    let mut answer = match upstream {
        Upstream::Folder(folder) => file(folder.join(path.trim_start_matches('/')), head),
        Upstream::Server(server) => {
            request(*server, &addressed(head, *server), body).unwrap_or_default()
        }
    };
    let start = answer.windows(4).position(|w| w == b"\r\n\r\n");
    let body = start.map_or(answer.len(), |start| start + 4);
    let half = body + (answer.len() - body) / 2;
    match fault {
        Some(Fault::Truncate) => answer.truncate(half),
        Some(Fault::Corrupt) if half < answer.len() => answer[half] ^= 0x10,
        Some(Fault::Stall) => {
            drop(under_way);
            let _ = stream.write_all(&answer[..half]);
            for _ in 0..600 {
                if stop.load(Ordering::SeqCst) {
                    break;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
            return;
        }
        _ => {}
    }
    drop(under_way);
    let _ = stream.write_all(&answer);
}

const DATE: &str = "Last-Modified: Thu, 01 Jan 2026 00:00:00 GMT\r\nConnection: close";

/// States ten bytes and sends chunks until the client disconnects.
fn endless(mut stream: TcpStream, status: &str, plan: &Mutex<Plan>) {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Length: 10\r\nTransfer-Encoding: chunked\r\n{DATE}\r\n\r\n"
    );
    let chunk = [b"100000\r\n", &vec![b'A'; 1 << 20][..], b"\r\n"].concat();
    let _ = stream.write_all(head.as_bytes());
    for _ in 0..256 {
        if stream.write_all(&chunk).is_err() {
            break;
        }
        plan.lock().expect("the plan").endless_mib += 1;
    }
}

/// Sends a byte every 50 ms.
fn trickle(mut stream: TcpStream) {
    let head = format!("HTTP/1.1 200 OK\r\nContent-Length: 2000\r\n{DATE}\r\n\r\n");
    let _ = stream.write_all(head.as_bytes());
    for _ in 0..600 {
        if stream.write_all(b"A").is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Head, with the connection closed after it, and body.
fn read_request(stream: &TcpStream) -> Option<(String, Vec<u8>)> {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    let mut length = 0;
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line).ok()? == 0 {
            return None;
        }
        let lower = line.to_ascii_lowercase();
        if let Some(value) = lower.strip_prefix("content-length:") {
            length = value.trim().parse().ok()?;
        }
        if line == "\r\n" {
            head.push_str("Connection: close\r\n\r\n");
            break;
        }
        if !lower.starts_with("connection:") {
            head.push_str(&line);
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    Some((head, body))
}

/// The head with the target's host name, by which some servers choose the answer.
fn addressed(head: &str, server: SocketAddr) -> String {
    let lines = head.split_inclusive("\r\n").map(|line| {
        match line.to_ascii_lowercase().starts_with("host:") {
            true => format!("Host: {server}\r\n"),
            false => line.to_owned(),
        }
    });
    lines.collect()
}

/// Closes a connection with a linger time of zero, which resets it.
fn reset(stream: TcpStream) {
    let socket = socket2::Socket::from(stream);
    let _ = socket.set_linger(Some(Duration::ZERO));
}

/// The answer of a plain web server.
fn file(path: PathBuf, head: &str) -> Vec<u8> {
    let Ok(bytes) = std::fs::read(path) else {
        return b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            .to_vec();
    };
    let mut answer = format!(
        "HTTP/1.1 200 OK\r\nContent-Length: {}\r\nLast-Modified: Thu, 01 Jan 2026 00:00:00 \
         GMT\r\nConnection: close\r\n\r\n",
        bytes.len()
    )
    .into_bytes();
    if !head.starts_with("HEAD") {
        answer.extend(bytes);
    }
    answer
}
