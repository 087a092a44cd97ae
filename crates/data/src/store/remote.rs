//! A dataset in a bucket or on a web server, through `object_store`.
//!
//! Credentials and endpoints come from the environment (`GOOGLE_APPLICATION_CREDENTIALS`,
//! `AWS_ACCESS_KEY_ID` and so on); `data.store` overrides the endpoint. This module retries each
//! request and its body, so a cut connection is retried like any other failure.

use std::path::PathBuf;
use std::sync::{Arc, Once};
use std::time::{Duration, UNIX_EPOCH};

use futures_util::TryStreamExt;
use kinegrad_audio::guard::guarded;
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload};
use tokio::runtime::Runtime;
use tokio::sync::Semaphore;

use super::bounded::{LARGEST_REFUSAL, SLOWEST, TooLong};
use super::{Backend, Object, StoreError, services};
use crate::layout::check_path;
use crate::location::Service;
use crate::{Counters, Error, StoreConfig};

/// First pause before a retry; it doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// Longest pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(20);

/// Bytes of a page of a listing, whose transfer limits the time until the next object: pages may be
/// empty without end.
const PAGE: u64 = 1 << 16;

/// Most objects in a listing.
const MOST_LISTED: usize = 1_000_000;

/// A bucket and a prefix, or a web server and a path.
#[derive(Debug)]
pub(super) struct Remote {
    uri: String,
    store: Box<dyn ObjectStore>,
    /// Path within the bucket; empty for web servers.
    prefix: String,
    can_list: bool,
    /// Endpoint of the config; empty for the service's own.
    endpoint: String,
    max_retries: usize,
    timeout: Duration,
    requests: Semaphore,
    runtime: Runtime,
    counters: Arc<Counters>,
}

impl Remote {
    pub fn open(
        service: Service,
        uri: String,
        config: &StoreConfig,
        counters: Arc<Counters>,
    ) -> Result<Self, Error> {
        static PROVIDER: Once = Once::new();
        PROVIDER.call_once(|| {
            // An error means that the program has already chosen a provider.
            let _ = rustls::crypto::ring::default_provider().install_default();
        });
        let unusable = |reason: String| Error::Store(failed(&uri, "open", 1, reason));
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .thread_name("store")
            .enable_all()
            .build()
            .map_err(|reason| unusable(reason.to_string()))?;
        let (_, rest) = uri.split_once("://").expect("an address");
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let built = services::open(service, &uri, bucket, config);
        let store = built.map_err(|reason| unusable(reason.to_string()))?;
        Ok(Self {
            prefix: match service {
                Service::Http => String::new(),
                Service::Gcs | Service::S3 => prefix.to_owned(),
            },
            can_list: service != Service::Http,
            endpoint: config.endpoint.clone().unwrap_or_default(),
            store,
            max_retries: config.max_retries,
            timeout: Duration::from_secs_f64(config.timeout_seconds),
            requests: Semaphore::new(config.concurrency),
            runtime,
            counters,
            uri,
        })
    }

    fn must_be_writable(&self) -> Result<(), StoreError> {
        if self.is_writable() {
            return Ok(());
        }
        Err(StoreError::ReadOnly(self.uri.clone()))
    }

    /// Name of `path` in messages, and key of `path` in the bucket.
    fn key(&self, path: &str) -> Result<(String, Path), StoreError> {
        check_path(path)?;
        let object = format!("{}/{path}", self.uri);
        let full = match self.prefix.as_str() {
            "" => path.to_owned(),
            prefix => format!("{prefix}/{path}"),
        };
        let key = Path::parse(&full).map_err(|_| StoreError::Path {
            path: full,
            reason: "object stores do not take it",
        })?;
        Ok((object, key))
    }

    /// The object of a listing, if it is [listed](is_listed).
    fn listed(&self, meta: &ObjectMeta, folder: &str, file: Option<&str>) -> Option<Object> {
        let location = meta.location.to_string();
        let path = match self.prefix.as_str() {
            "" => location.as_str(),
            prefix => location.strip_prefix(prefix)?.strip_prefix('/')?,
        };
        is_listed(path, folder, file).then(|| Object {
            path: path.to_owned(),
            bytes: meta.size,
            version: version(meta),
        })
    }

    /// Waits for a transfer of at most that many bytes.
    async fn within<T>(
        &self,
        bytes: u64,
        transfer: impl Future<Output = object_store::Result<T>>,
    ) -> Result<T, Failure> {
        let longest = self.timeout + Duration::from_secs_f64(bytes as f64 / SLOWEST);
        match tokio::time::timeout(longest, transfer).await {
            Ok(outcome) => outcome.map_err(Failure::Request),
            Err(_) => Err(Failure::CutOff(format!(
                "the transfer did not end within {:.0} s",
                longest.as_secs_f64()
            ))),
        }
    }

    /// Runs `request` until it succeeds, fails permanently or exceeds the maximum number of
    /// retries.
    fn try_often<T, F>(
        &self,
        object: &str,
        action: &'static str,
        request: impl Fn() -> F,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = Result<T, Failure>>,
    {
        let requests = async {
            let mut attempts = 0;
            let mut pause = FIRST_PAUSE;
            loop {
                attempts += 1;
                let permit = self.requests.acquire().await.expect("never closed");
                let outcome = request().await;
                drop(permit);
                let reason = match outcome {
                    Ok(value) => return Ok(value),
                    Err(Failure::Final(error)) => return Err(error),
                    Err(Failure::Request(error)) => match final_error(&error, object, action) {
                        Some(error) => return Err(error),
                        None => in_short(&error),
                    },
                    Err(Failure::CutOff(reason)) => reason,
                };
                if attempts > self.max_retries {
                    return Err(failed(object, action, attempts, reason));
                }
                Counters::increment(&self.counters.retries);
                tokio::time::sleep(pause.mul_f64(jitter())).await;
                pause = (2 * pause).min(LONGEST_PAUSE);
            }
        };
        // Requests with keys or tokens of a listing may be longer than addresses can be.
        guarded(|| self.runtime.block_on(requests)).unwrap_or_else(|| {
            let reason = "no request can be made of what the store has listed".to_owned();
            Err(failed(object, action, 1, reason))
        })
    }
}

impl Backend for Remote {
    fn uri(&self) -> String {
        self.uri.clone()
    }

    fn address(&self) -> String {
        format!("{} {}", self.uri, self.endpoint)
    }

    fn is_writable(&self) -> bool {
        self.can_list
    }

    fn is_remote(&self) -> bool {
        true
    }

    fn place(&self, _path: &str) -> Result<Option<PathBuf>, StoreError> {
        Ok(None)
    }

    fn read(&self, path: &str, limit: u64) -> Result<(Vec<u8>, String), StoreError> {
        let (object, key) = self.key(path)?;
        self.try_often(&object, "read", || async {
            let found = self.within(LARGEST_REFUSAL, self.store.get(&key)).await?;
            let length = found.meta.size;
            let version = version(&found.meta);
            if length > limit {
                return Err(Failure::Final(StoreError::TooLarge {
                    object: object.clone(),
                    found: length,
                    limit,
                }));
            }
            let bytes = self.within(length, found.bytes()).await?;
            if bytes.len() as u64 != length {
                let reason = format!("{} of {length} bytes came", bytes.len());
                return Err(Failure::CutOff(reason));
            }
            Ok((bytes.into(), version))
        })
    }

    fn write(&self, path: &str, bytes: Vec<u8>) -> Result<(), StoreError> {
        self.must_be_writable()?;
        let (object, key) = self.key(path)?;
        let payload = PutPayload::from(bytes);
        let bytes = payload.content_length() as u64;
        self.try_often(&object, "write", || async {
            let put = self.store.put(&key, payload.clone());
            self.within(bytes, put).await.map(drop)
        })
    }

    fn remove(&self, path: &str) -> Result<(), StoreError> {
        self.must_be_writable()?;
        let (object, key) = self.key(path)?;
        self.try_often(&object, "remove", || async {
            let delete = self.store.delete(&key);
            match self.within(LARGEST_REFUSAL, delete).await {
                Err(Failure::Request(object_store::Error::NotFound { .. })) => Ok(()),
                removed => removed,
            }
        })
    }

    fn list(&self, folder: &str, file: Option<&str>) -> Result<Vec<Object>, StoreError> {
        if !self.can_list {
            return Err(StoreError::NoListing(self.uri.clone()));
        }
        let (object, key) = self.key(folder)?;
        self.try_often(&object, "list", || async {
            let mut listing = self.store.list(Some(&key));
            let (mut objects, mut order) = (Vec::new(), Order::default());
            while let Some(meta) = self.within(PAGE, listing.try_next()).await? {
                order.next(&meta.location).map_err(|reason| {
                    let object = object.clone();
                    Failure::Final(StoreError::Unusable { object, reason })
                })?;
                objects.extend(self.listed(&meta, folder, file));
            }
            Ok(objects)
        })
    }
}

/// Objects of a listing so far.
#[derive(Default)]
struct Order {
    count: usize,
    /// The object whose number was the last power of two: a listing that repeats itself meets it
    /// again (Brent's detection of cycles).
    mark: Path,
}

impl Order {
    /// Counts an object. Fails with a reason for the object after [`MOST_LISTED`] and for a
    /// listing that repeats itself.
    fn next(&mut self, object: &Path) -> Result<(), String> {
        self.count += 1;
        if self.count > MOST_LISTED {
            return Err(format!("more than {MOST_LISTED} objects are listed"));
        }
        if self.count > 1 && self.mark == *object {
            return Err(format!("{object} is listed twice"));
        }
        if self.count.is_power_of_two() {
            self.mark = object.clone();
        }
        Ok(())
    }
}

/// True if `path` is a visible `FOLDER/ANY/FILE` or, without a file, `FOLDER/NAME`.
fn is_listed(path: &str, folder: &str, file: Option<&str>) -> bool {
    let rest = path
        .strip_prefix(folder)
        .and_then(|rest| rest.strip_prefix('/'));
    let name = match file {
        Some(file) => rest.and_then(|rest| rest.strip_suffix(file)?.strip_suffix('/')),
        None => rest,
    };
    name.is_some_and(|name| !name.contains('/') && !name.starts_with('.'))
}

/// A factor from 0.75 to 1.25 that spreads the retries of several clients.
fn jitter() -> f64 {
    let now = UNIX_EPOCH.elapsed();
    0.75 + 0.5 * f64::from(now.unwrap_or_default().subsec_nanos() % 1000) / 1000.0
}

/// Version of an object, without the quotes of the tag, which vary between responses.
fn version(meta: &ObjectMeta) -> String {
    match &meta.e_tag {
        Some(tag) => format!("{} {}", meta.size, tag.trim_matches('"')),
        None => format!("{} {}", meta.size, meta.last_modified.to_rfc3339()),
    }
}

/// Reasons of a failed attempt.
enum Failure {
    Request(object_store::Error),
    CutOff(String),
    /// The error is permanent.
    Final(StoreError),
}

/// The permanent error. A failing metadata service of a machine means missing credentials.
fn failed(object: &str, action: &'static str, attempts: usize, reason: String) -> StoreError {
    const SIGNS: [&str; 4] = ["169.254.", "token request", "api/token", "redential"];
    let object = object.to_owned();
    match SIGNS.iter().any(|sign| reason.contains(sign)) {
        true => StoreError::Denied { object, reason },
        false => StoreError::Failed {
            object,
            action,
            attempts,
            reason,
        },
    }
}

/// True if a server rejected the request: status 4xx, except statuses that ask the client to wait.
fn is_refused(reason: &str) -> bool {
    let Some((_, status)) = reason.split_once("status code: ") else {
        // Responses without a length cannot be checked for completeness.
        return reason.contains("Content-Length");
    };
    let patience = ["408", "425", "429"];
    status.starts_with('4') && !patience.iter().any(|known| status.starts_with(known))
}

/// True if a response was longer than it states.
fn is_too_long(error: &(dyn std::error::Error + 'static)) -> bool {
    std::iter::successors(Some(error), |error| error.source()).any(|error| error.is::<TooLong>())
}

/// The error, if it is permanent.
fn final_error(
    error: &object_store::Error,
    object: &str,
    action: &'static str,
) -> Option<StoreError> {
    let reason = in_short(error);
    if is_too_long(error) {
        let object = object.to_owned();
        return Some(StoreError::Unusable { object, reason });
    }
    if matches!(error, object_store::Error::Generic { .. }) && is_refused(&reason) {
        return Some(failed(object, action, 1, reason));
    }
    let object = object.to_owned();
    match error {
        object_store::Error::NotFound { .. } => Some(StoreError::Missing(object)),
        object_store::Error::PermissionDenied { source, .. }
        | object_store::Error::Unauthenticated { source, .. } => Some(StoreError::Denied {
            object,
            reason: in_short(source.as_ref()),
        }),
        _ => None,
    }
}

/// The innermost cause and the outermost message, on one short line.
fn in_short(error: &(dyn std::error::Error + 'static)) -> String {
    let mut innermost = error;
    while let Some(cause) = innermost.source() {
        innermost = cause;
    }
    let (outer, inner) = (error.to_string(), innermost.to_string());
    let text = if outer.contains(&inner) {
        outer
    } else {
        format!("{outer}: {inner}")
    };
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(400) {
        Some((end, _)) => format!("{}...", &line[..end]),
        None => line,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first_error(names: impl IntoIterator<Item = usize>) -> Option<(usize, String)> {
        let mut order = Order::default();
        names.into_iter().enumerate().find_map(|(place, name)| {
            let key = Path::from(format!("motion/{name}/trajectory.npy"));
            Some((place, order.next(&key).err()?))
        })
    }

    #[test]
    fn listings_that_repeat_themselves_end() {
        // Pages of a thousand, repeated at once and after other pages.
        for (before, page) in [(0, 1), (0, 1000), (1, 1000), (2500, 1000), (3, 7)] {
            let repeated = (0..before).chain((0..).map(|place| before + place % page));
            let (place, reason) = first_error(repeated).expect("an error");
            assert!(reason.ends_with("is listed twice"), "{reason}");
            assert!(place <= 4 * (before + page), "{before}, {page}: {place}");
        }
    }

    #[test]
    fn long_listings_end_and_others_are_read() {
        assert_eq!(first_error(0..MOST_LISTED), None);
        let (place, reason) = first_error(0..).expect("an error");
        assert_eq!(place, MOST_LISTED);
        assert_eq!(reason, "more than 1000000 objects are listed");
    }
}
