//! How every service is spoken to.

use std::time::Duration;

use object_store::{ClientOptions, RetryConfig};

use crate::StoreConfig;

pub(super) fn client_options(config: &StoreConfig) -> ClientOptions {
    let patience = Duration::from_secs_f64(config.timeout_seconds);
    ClientOptions::new()
        // An endpoint that the user names may be an emulator without TLS.
        .with_allow_http(true)
        .with_connect_timeout(patience)
        .with_read_timeout(patience)
        .with_timeout_disabled()
}

/// All attempts are counted here, not inside `object_store` as well.
pub(super) fn no_retries() -> RetryConfig {
    RetryConfig {
        max_retries: 0,
        ..RetryConfig::default()
    }
}
