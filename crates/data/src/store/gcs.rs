//! Google Cloud Storage, and its emulators.

use std::sync::Arc;

use object_store::gcp::{GcpCredential, GoogleCloudStorageBuilder};
use object_store::{ObjectStore, StaticCredentialProvider};

use super::client::{client_options, no_retries};
use crate::StoreConfig;

/// The bucket, with its environment's credentials. It is written to by Google's XML interface, which
/// not every emulator has.
///
/// # Errors
/// If credentials or the endpoint cannot be used.
pub(super) fn open(
    bucket: &str,
    config: &StoreConfig,
) -> object_store::Result<Box<dyn ObjectStore>> {
    let mut builder = GoogleCloudStorageBuilder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(client_options(config))
        .with_retry(no_retries());
    let emulator = emulator();
    let endpoint = config.endpoint.as_ref().or(emulator.as_ref());
    if let Some(endpoint) = endpoint {
        builder = builder.with_base_url(endpoint.trim_end_matches('/'));
    }
    if config.anonymous || (emulator.is_some() && config.endpoint.is_none()) {
        // Writing asks for credentials all the same: there are some, and they are empty.
        let nobody = GcpCredential {
            bearer: String::new(),
        };
        builder = builder
            .with_skip_signature(true)
            .with_credentials(Arc::new(StaticCredentialProvider::new(nobody)));
    }
    Ok(Box::new(builder.build()?))
}

/// The emulator that the environment names, as Google's own libraries read it.
fn emulator() -> Option<String> {
    let host = std::env::var("STORAGE_EMULATOR_HOST").ok()?;
    if host.is_empty() {
        return None;
    }
    Some(if host.contains("://") {
        host
    } else {
        format!("http://{host}")
    })
}
