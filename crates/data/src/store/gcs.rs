//! Google Cloud Storage, and its emulators.

use std::sync::Arc;
use std::time::Duration;

use object_store::gcp::{GcpCredential, GcpCredentialProvider, GoogleCloudStorageBuilder};
use object_store::path::Path;
use object_store::{ObjectStore, PutPayload, StaticCredentialProvider};
use reqwest::{Client, RequestBuilder, StatusCode, Url};

use super::client::{client_options, no_retries};
use crate::StoreConfig;

type Opened = (Box<dyn ObjectStore>, Option<GcsUploader>);

/// The bucket, with its environment's credentials, and an uploader where the endpoint is not
/// Google's own.
///
/// # Errors
/// If credentials or the endpoint cannot be used.
pub(super) fn open(bucket: &str, config: &StoreConfig) -> object_store::Result<Opened> {
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
    let store = builder.build()?;
    let uploader = endpoint
        .map(|endpoint| GcsUploader::new(endpoint, bucket, store.credentials().clone(), config))
        .transpose()?;
    Ok((Box::new(store), uploader))
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

/// Writes and removes objects by Google's JSON interface: `object_store` uses the older XML one,
/// which emulators read from and do not write by.
#[derive(Debug)]
pub(super) struct GcsUploader {
    client: Client,
    endpoint: Url,
    bucket: String,
    credentials: GcpCredentialProvider,
}

impl GcsUploader {
    fn new(
        endpoint: &str,
        bucket: &str,
        credentials: GcpCredentialProvider,
        config: &StoreConfig,
    ) -> object_store::Result<Self> {
        let patience = Duration::from_secs_f64(config.timeout_seconds);
        let client = Client::builder()
            .connect_timeout(patience)
            .read_timeout(patience)
            .build()
            .map_err(failed)?;
        Ok(Self {
            client,
            endpoint: Url::parse(endpoint).map_err(failed)?,
            bucket: bucket.to_owned(),
            credentials,
        })
    }

    /// Writes the object `key`.
    ///
    /// # Errors
    /// As [`ObjectStore`]'s own writing.
    pub async fn put(&self, key: &Path, payload: &PutPayload) -> object_store::Result<()> {
        let mut address = self.endpoint.clone();
        address.set_path(&format!("upload/storage/v1/b/{}/o", self.bucket));
        address
            .query_pairs_mut()
            .append_pair("uploadType", "media")
            .append_pair("name", key.as_ref());
        let body: Vec<u8> = payload
            .iter()
            .flat_map(|part| part.iter().copied())
            .collect();
        self.send(key, self.client.post(address).body(body)).await
    }

    /// Removes the object `key`.
    ///
    /// # Errors
    /// As [`ObjectStore`]'s own removing.
    pub async fn delete(&self, key: &Path) -> object_store::Result<()> {
        let mut address = self.endpoint.clone();
        let parts = ["storage", "v1", "b", &self.bucket, "o", key.as_ref()];
        address
            .path_segments_mut()
            .map_err(|()| failed(std::io::Error::other("the endpoint takes no paths")))?
            .clear()
            .extend(parts);
        self.send(key, self.client.delete(address)).await
    }

    async fn send(&self, key: &Path, request: RequestBuilder) -> object_store::Result<()> {
        let bearer = self.credentials.get_credential().await?.bearer.clone();
        let request = match bearer.is_empty() {
            true => request,
            false => request.bearer_auth(bearer),
        };
        let answer = request.send().await.map_err(failed)?;
        let path = key.to_string();
        match answer.status() {
            status if status.is_success() => Ok(()),
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
                Err(object_store::Error::PermissionDenied {
                    path,
                    source: answer.status().to_string().into(),
                })
            }
            StatusCode::NOT_FOUND => Err(object_store::Error::NotFound {
                path,
                source: "no such bucket or object".into(),
            }),
            status => {
                let reason = format!("status code: {status}");
                Err(failed(std::io::Error::other(reason)))
            }
        }
    }
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> object_store::Error {
    object_store::Error::Generic {
        store: "GCS",
        source: Box::new(error),
    }
}
