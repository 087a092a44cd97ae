//! A program that reads pictures and writes a film: it may hang, flood or die.

use std::io::{self, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, ExitStatus};
use std::sync::mpsc::{self, SyncSender, TrySendError};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime};

/// Time between two looks at the program.
const PAUSE: Duration = Duration::from_millis(5);

/// Time that the program's pipes may stay open after its end.
const AFTER: Duration = Duration::from_secs(1);

/// Bytes of the end of the program's messages that are kept.
const MOST_MESSAGES: usize = 1 << 16;

/// A running program. Its input and its messages have threads, so a program that stops reading or
/// writing does not block the caller.
#[derive(Debug)]
pub struct Encoder {
    child: Child,
    /// Time without progress after which it is ended.
    patience: Duration,
    pictures: Option<SyncSender<Vec<u8>>>,
    /// Returns true if the program took all pictures.
    writer: JoinHandle<bool>,
    reader: JoinHandle<()>,
    messages: Arc<Mutex<Vec<u8>>>,
}

impl Encoder {
    /// A `child` with piped input and errors.
    pub fn new(mut child: Child, patience: Duration) -> Self {
        let (input, errors) = (child.stdin.take(), child.stderr.take());
        let (pictures, waiting) = mpsc::sync_channel::<Vec<u8>>(2);
        let write = move |mut input: ChildStdin| {
            waiting
                .iter()
                .all(|picture| input.write_all(&picture).is_ok())
        };
        let messages = Arc::<Mutex<Vec<u8>>>::default();
        let kept = messages.clone();
        Self {
            child,
            patience,
            pictures: Some(pictures),
            writer: thread::spawn(move || input.is_some_and(write)),
            reader: thread::spawn(move || {
                errors.into_iter().for_each(|errors| keep(errors, &kept))
            }),
            messages,
        }
    }

    /// Passes a picture on; false if the program takes none, or `stop` returns true.
    pub fn take(&self, mut picture: Vec<u8>, stop: impl Fn() -> bool) -> bool {
        let Some(pictures) = &self.pictures else {
            return false;
        };
        let began = Instant::now();
        loop {
            match pictures.try_send(picture) {
                Ok(()) => return true,
                Err(TrySendError::Full(back)) if began.elapsed() < self.patience && !stop() => {
                    picture = back;
                    thread::sleep(PAUSE);
                }
                Err(_) => return false,
            }
        }
    }

    /// Waits for the end after the last picture; with `stop`, or if the `film` does not change for
    /// longer than the patience, the program is ended. Returns its status, its last messages, and true
    /// if it took all pictures.
    pub fn finish(
        mut self,
        film: &Path,
        stop: impl Fn() -> bool,
    ) -> (io::Result<ExitStatus>, String, bool) {
        self.pictures = None;
        let status = wait(&mut self.child, self.patience, film, stop);
        let until = Instant::now() + AFTER;
        let is_open = || !(self.writer.is_finished() && self.reader.is_finished());
        // A process that it started may keep the pipes.
        while is_open() && Instant::now() < until {
            thread::sleep(PAUSE);
        }
        let taken = self.writer.is_finished() && self.writer.join().unwrap_or(false);
        let messages = self.messages.lock().map(|kept| kept.clone());
        let messages = String::from_utf8_lossy(&messages.unwrap_or_default()).into_owned();
        (status, messages, taken)
    }
}

/// Waits for the end of a `child`, or ends it with `stop` or if neither it nor `film` changes for longer
/// than the `patience`.
///
/// # Errors
/// [`io::ErrorKind::TimedOut`] if it was ended for want of progress.
pub fn wait(
    child: &mut Child,
    patience: Duration,
    film: &Path,
    stop: impl Fn() -> bool,
) -> io::Result<ExitStatus> {
    let changed = || -> Option<SystemTime> { film.metadata().ok()?.modified().ok() };
    let (mut began, mut last) = (Instant::now(), changed());
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        let now = changed();
        if now != last {
            (began, last) = (Instant::now(), now);
        }
        let is_late = began.elapsed() > patience;
        if is_late || stop() {
            child.kill()?;
            let status = child.wait()?;
            return match is_late {
                true => Err(late(patience)),
                false => Ok(status),
            };
        }
        thread::sleep(PAUSE);
    }
}

fn late(patience: Duration) -> io::Error {
    let reason = format!("it did nothing for {} s and was ended", patience.as_secs());
    io::Error::new(io::ErrorKind::TimedOut, reason)
}

/// Reads messages to their end and keeps the last ones.
fn keep(mut errors: ChildStderr, kept: &Mutex<Vec<u8>>) {
    let mut part = [0; 4096];
    while let Ok(length @ 1..) = errors.read(&mut part) {
        let Ok(mut kept) = kept.lock() else { return };
        kept.extend_from_slice(&part[..length]);
        let beyond = kept.len().saturating_sub(MOST_MESSAGES);
        kept.drain(..beyond);
    }
}
