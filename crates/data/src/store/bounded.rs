//! Responses of bounded length: a server may send more than it states, or never end.

use std::error::Error;

use http_body_util::{BodyExt, Limited};
use object_store::ClientOptions;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse,
    HttpResponseBody, HttpService, ReqwestConnector,
};

/// Largest page of a listing, bytes.
pub(super) const LARGEST_PAGE: u64 = 16 << 20;

/// Largest answer that refuses a request, bytes.
pub(super) const LARGEST_REFUSAL: u64 = 1 << 16;

/// Connects as `object_store` does, and bounds the responses.
#[derive(Debug)]
pub(super) struct BoundedConnector;

impl HttpConnector for BoundedConnector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let client = ReqwestConnector::default().connect(options)?;
        Ok(HttpClient::new(Bounded(client)))
    }
}

/// A client whose responses end with an error beyond the length that they state.
#[derive(Debug)]
struct Bounded(HttpClient);

#[async_trait::async_trait]
impl HttpService for Bounded {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        // Objects are addressed by their path, pages of listings by a query.
        let is_object = request.uri().query().is_none();
        let (parts, body) = self.0.execute(request).await?.into_parts();
        let stated = parts.headers.get("content-length");
        let stated = stated.and_then(|length| length.to_str().ok()?.parse().ok());
        let limit: u64 = match stated {
            _ if !parts.status.is_success() => LARGEST_REFUSAL,
            Some(length) if is_object => length,
            _ => LARGEST_PAGE,
        };
        let limited = Limited::new(body, usize::try_from(limit).unwrap_or(usize::MAX));
        let body = HttpResponseBody::new(limited.map_err(move |error| too_long(error, limit)));
        Ok(HttpResponse::from_parts(parts, body))
    }
}

/// The error of a body: its own, or that of its length.
fn too_long(error: Box<dyn Error + Send + Sync>, limit: u64) -> HttpError {
    match error.downcast::<HttpError>() {
        Ok(error) => *error,
        Err(_) => {
            let reason = format!("more than {limit} bytes came");
            HttpError::new_boxed(HttpErrorKind::Decode, reason.into())
        }
    }
}
