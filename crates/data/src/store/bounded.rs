//! Responses of bounded length and time: a server may send more than it states, slowly, or never end.

use std::error::Error;
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use http_body_util::{BodyExt, BodyStream, Limited, StreamBody};
use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse,
    HttpResponseBody, HttpService, ReqwestConnector,
};

/// Largest page of a listing, bytes.
const LARGEST_PAGE: u64 = 16 << 20;

/// Largest answer that refuses a request, bytes.
pub(super) const LARGEST_REFUSAL: u64 = 1 << 16;

/// Slowest transfer, bytes per second; a slower one is cut off.
pub(super) const SLOWEST: f64 = 4096.0;

/// Connects as `object_store` does, and bounds the responses.
#[derive(Debug)]
pub(super) struct BoundedConnector {
    /// Time that a response may take beyond that of its bytes at [`SLOWEST`].
    pub patience: Duration,
}

impl HttpConnector for BoundedConnector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let client = ReqwestConnector::default().connect(options)?;
        Ok(HttpClient::new(Bounded {
            client,
            patience: self.patience,
        }))
    }
}

/// A client whose responses end with an error beyond the length that they state, and if they come
/// too slowly.
#[derive(Debug)]
struct Bounded {
    client: HttpClient,
    patience: Duration,
}

#[async_trait::async_trait]
impl HttpService for Bounded {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        // Objects are addressed by their path, pages of listings by a query.
        let is_object = request.uri().query().is_none();
        let (parts, body) = self.client.execute(request).await?.into_parts();
        let stated = parts.headers.get("content-length");
        let stated = stated.and_then(|length| length.to_str().ok()?.parse().ok());
        let is_success = parts.status.is_success();
        let limit: u64 = match stated {
            _ if !is_success => LARGEST_REFUSAL,
            Some(length) if is_object => length,
            _ => LARGEST_PAGE,
        };
        let limited = Limited::new(body, usize::try_from(limit).unwrap_or(usize::MAX));
        let limited = limited.map_err(move |error| too_long(error, limit, is_success));
        let (patience, began, mut received) = (self.patience, Instant::now(), 0.0);
        let paced = BodyStream::new(limited).map(move |frame| {
            let frame = frame?;
            received += frame.data_ref().map_or(0, |data| data.len()) as f64;
            match began.elapsed() > patience + Duration::from_secs_f64(received / SLOWEST) {
                true => Err(too_slow()),
                false => Ok(frame),
            }
        });
        let body = HttpResponseBody::new(StreamBody::new(paced));
        Ok(HttpResponse::from_parts(parts, body))
    }
}

/// A response longer than it states or than any that `object_store` can use.
#[derive(Debug, thiserror::Error)]
#[error("more than {limit} bytes came")]
pub(super) struct TooLong {
    limit: u64,
}

/// The error of a body. The length of a refusal (status 4xx or 5xx) does not make it permanent.
fn too_long(error: Box<dyn Error + Send + Sync>, limit: u64, is_success: bool) -> HttpError {
    match error.downcast::<HttpError>() {
        Ok(error) => *error,
        Err(_) if is_success => HttpError::new(HttpErrorKind::Decode, TooLong { limit }),
        Err(_) => {
            let reason = format!("a refusal of more than {limit} bytes came");
            HttpError::new_boxed(HttpErrorKind::Decode, reason.into())
        }
    }
}

/// The error of a body that comes too slowly.
fn too_slow() -> HttpError {
    let reason = format!("less than {SLOWEST} bytes came in a second");
    HttpError::new_boxed(HttpErrorKind::Timeout, reason.into())
}
