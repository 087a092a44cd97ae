//! Builders of the remote services.

use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::gcp::{GcpCredential, GoogleCloudStorageBuilder};
use object_store::http::HttpBuilder;
use object_store::{ClientOptions, ObjectStore, RetryConfig, StaticCredentialProvider};

use super::bounded::BoundedConnector;
use crate::StoreConfig;
use crate::location::Service;

/// The `bucket`, with credentials from the environment, or the web server at `uri`.
pub(super) fn open(
    service: Service,
    uri: &str,
    bucket: &str,
    config: &StoreConfig,
) -> object_store::Result<Box<dyn ObjectStore>> {
    match service {
        Service::Gcs => gcs(bucket, config),
        Service::S3 => s3(bucket, config),
        Service::Http => http(uri, config),
    }
}

/// Writes to buckets use Google's XML API, which some emulators lack.
fn gcs(bucket: &str, config: &StoreConfig) -> object_store::Result<Box<dyn ObjectStore>> {
    let mut builder = GoogleCloudStorageBuilder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(client_options(config))
        .with_retry(no_retries())
        .with_http_connector(connector(config));
    let emulator = emulator();
    let endpoint = config.endpoint.as_ref().or(emulator.as_ref());
    if let Some(endpoint) = endpoint {
        builder = builder.with_base_url(endpoint.trim_end_matches('/'));
    }
    if config.anonymous || (emulator.is_some() && config.endpoint.is_none()) {
        // Writing requires credentials, so empty credentials are set.
        let credential = GcpCredential {
            bearer: String::new(),
        };
        builder = builder
            .with_skip_signature(true)
            .with_credentials(Arc::new(StaticCredentialProvider::new(credential)));
    }
    Ok(Box::new(builder.build()?))
}

/// The emulator from the environment variable of Google's libraries.
fn emulator() -> Option<String> {
    let host = std::env::var("STORAGE_EMULATOR_HOST").ok();
    let host = host.filter(|host| !host.is_empty())?;
    Some(match host.contains("://") {
        true => host,
        false => format!("http://{host}"),
    })
}

fn s3(bucket: &str, config: &StoreConfig) -> object_store::Result<Box<dyn ObjectStore>> {
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(client_options(config))
        .with_retry(no_retries())
        .with_http_connector(connector(config));
    if let Some(endpoint) = &config.endpoint {
        builder = builder.with_endpoint(endpoint.trim_end_matches('/'));
    }
    if config.anonymous {
        builder = builder.with_skip_signature(true);
    }
    Ok(Box::new(builder.build()?))
}

fn http(uri: &str, config: &StoreConfig) -> object_store::Result<Box<dyn ObjectStore>> {
    let builder = HttpBuilder::new()
        .with_url(uri)
        .with_client_options(client_options(config))
        .with_retry(no_retries())
        .with_http_connector(connector(config));
    Ok(Box::new(builder.build()?))
}

fn patience(config: &StoreConfig) -> Duration {
    Duration::from_secs_f64(config.timeout_seconds)
}

fn connector(config: &StoreConfig) -> BoundedConnector {
    BoundedConnector {
        patience: patience(config),
    }
}

fn client_options(config: &StoreConfig) -> ClientOptions {
    let patience = patience(config);
    ClientOptions::new()
        // The user's endpoint may be an emulator without TLS.
        .with_allow_http(true)
        .with_connect_timeout(patience)
        .with_read_timeout(patience)
        .with_timeout_disabled()
}

/// This crate counts all attempts, not `object_store`.
fn no_retries() -> RetryConfig {
    RetryConfig {
        max_retries: 0,
        ..RetryConfig::default()
    }
}
