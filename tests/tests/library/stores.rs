//! Datasets in buckets and on web servers: the same phrases as from a folder, despite faults.

use std::fs;
use std::path::Path;

use kinegrad_data::manifest::{self, ManifestRow};
use kinegrad_data::{
    AUDIO, Batch, DataConfig, Dataset, Digest, Error, Loader, MANIFEST, PhraseItem, PhraseSamples,
    Side, Store, StoreConfig, features_path, motion_path, synthetic,
};
use kinegrad_motion::Statistics;
use kinegrad_tests::sandbox::contents;
use kinegrad_tests::servers::{self, Emulator, Fault, FaultyServer, Upstream};
use std::sync::Arc;

const PHRASES: usize = 12;

/// A dataset in a folder, optionally with a manifest, and an empty cache.
fn dataset(with_manifest: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let set = folder.path().join("set");
    synthetic::write_dataset(&set, kinegrad_data::AudioLayout::CCMOTION, PHRASES, 40, 3)
        .expect("a dataset");
    if with_manifest {
        let store = Store::open(&set.display().to_string(), &StoreConfig::default());
        manifest::write(&store.expect("a folder"), rows(&set)).expect("a manifest");
    }
    folder
}

fn rows(set: &Path) -> Vec<ManifestRow> {
    let read = |path: String| fs::read(set.join(path)).expect("a file");
    (0..PHRASES)
        .map(|index| {
            let id = synthetic::id(index);
            let (motion, audio) = (read(motion_path(&id)), read(features_path(&id)));
            ManifestRow {
                motion_source: "synthetic".to_owned(),
                audio_source: None,
                first_frame: 0,
                frames: 40,
                fps: 30.0,
                beats: None,
                tempo: None,
                split: Some(match index % 4 {
                    0 => Side::Validation,
                    _ => Side::Train,
                }),
                motion_bytes: motion.len() as i64,
                motion_sha256: Digest::of(&motion),
                audio_bytes: audio.len() as i64,
                audio_sha256: Digest::of(&audio),
                audio_features: None,
                label: None,
                flags: Vec::new(),
                id,
            }
        })
        .collect()
}

fn config(source: &str, cache: &Path, endpoint: Option<String>) -> DataConfig {
    let mut config = DataConfig {
        source: Some(source.to_owned()),
        batch_size: 5,
        target_frames: 32,
        num_workers: 2,
        ..DataConfig::default()
    };
    config.cache.dir = Some(cache.display().to_string());
    config.store.endpoint = endpoint;
    config.store.anonymous = true;
    config.store.timeout_seconds = 1.0;
    config
}

fn loader(
    dataset: &Dataset<PhraseItem>,
    statistics: Arc<Statistics>,
    config: &DataConfig,
) -> Loader {
    let samples = PhraseSamples::new(dataset.train.clone(), statistics, config, 7);
    Loader::new(samples, config, 7, 0)
}

fn numbers(batch: Batch) -> Vec<f32> {
    let audio = batch.condition(AUDIO).expect("phrases have audio");
    [&batch.x_start[..], &audio.values].concat()
}

/// The first batches of a dataset, as their numbers.
fn batches(dataset: &Dataset<PhraseItem>, config: &DataConfig) -> Result<Vec<Vec<f32>>, Error> {
    let statistics = Arc::new(dataset.statistics()?);
    let mut loader = loader(dataset, statistics, config);
    (0..6)
        .map(|_| {
            let batch = loader.next()?;
            Ok(numbers(batch))
        })
        .collect()
}

/// A dataset copied into a bucket equals its folder, with a cold and a warm cache and without one.
fn bucket_equals_folder(emulator: &Emulator, scheme: &str, with_manifest: bool) {
    let folder = dataset(with_manifest);
    let set = folder.path().join("set");
    let source = format!("{scheme}://bucket/some/prefix");
    let cache = folder.path().join("cache");
    let remote = config(&source, &cache, Some(emulator.endpoint()));
    let put = |prefix: &str, path: &str, bytes: Vec<u8>| match scheme {
        "gs" => emulator.upload(&format!("{prefix}/{path}"), &bytes),
        _ => {
            let uri = format!("{scheme}://bucket/{prefix}");
            let store = Store::open(&uri, &remote.store).expect("a bucket");
            store.write(path, bytes).expect("the bucket takes it");
        }
    };
    for (path, bytes) in contents(&set) {
        put("some/prefix", &path, bytes);
    }
    // A phrase of another dataset, whose prefix begins like this one's.
    put(
        "some/prefix-other",
        "motion/x/trajectory.npy",
        b"no".to_vec(),
    );

    let local = config(&set.display().to_string(), &cache, None);
    let expected = Dataset::<PhraseItem>::open(&local).expect("the folder opens");
    let expected_batches = batches(&expected, &local).expect("batches");
    let cold = Dataset::<PhraseItem>::open(&remote).expect("the bucket opens");
    assert_eq!(cold.digest, expected.digest);
    assert_eq!(batches(&cold, &remote).expect("batches"), expected_batches);
    assert_eq!(cold.report().disk_hits, 0);
    let warm = Dataset::<PhraseItem>::open(&remote).expect("the bucket opens again");
    assert_eq!(batches(&warm, &remote).expect("batches"), expected_batches);
    let report = warm.report();
    assert_eq!(report.disk_hits, 2 * PHRASES as u64, "{report:?}");
    assert_eq!(report.reads, u64::from(with_manifest), "{report:?}");
    let mut bare = remote.clone();
    bare.cache.disk_mib = 0;
    bare.cache.memory_mib = 0;
    let uncached = Dataset::<PhraseItem>::open(&bare).expect("the bucket opens");
    assert_eq!(
        batches(&uncached, &bare).expect("batches"),
        expected_batches
    );
    let report = uncached.report();
    assert_eq!((report.memory_hits, report.disk_hits), (0, 0));
    assert!(report.reads > 3 * PHRASES as u64, "{report:?}");
    let ids = |dataset: &Dataset<PhraseItem>| {
        dataset
            .validation
            .ids()
            .map(String::from)
            .collect::<Vec<_>>()
    };
    assert_eq!(ids(&cold), ids(&expected));
    assert_eq!(ids(&cold).len() == 3, with_manifest, "{:?}", ids(&cold));
}

#[test]
fn gcs_equals_the_folder() {
    let emulator = servers::gcs();
    bucket_equals_folder(&emulator, "gs", true);
}

#[test]
fn gcs_without_a_manifest_is_listed() {
    let emulator = servers::gcs();
    bucket_equals_folder(&emulator, "gs", false);
}

#[test]
fn s3_equals_the_folder_with_and_without_a_manifest() {
    bucket_equals_folder(&servers::s3(), "s3", true);
    bucket_equals_folder(&servers::s3(), "s3", false);
}

/// A web server with a dataset, and the config to read it.
fn web(with_manifest: bool) -> (tempfile::TempDir, FaultyServer, DataConfig) {
    let folder = dataset(with_manifest);
    let server = FaultyServer::start(Upstream::Folder(folder.path().to_owned()));
    let source = format!("{}/set", server.endpoint());
    let mut config = config(&source, &folder.path().join("cache"), None);
    config.cache.disk_mib = 0;
    (folder, server, config)
}

fn local_batches(folder: &tempfile::TempDir, remote: &DataConfig) -> Vec<Vec<f32>> {
    let local = DataConfig {
        source: Some(folder.path().join("set").display().to_string()),
        ..remote.clone()
    };
    batches(
        &Dataset::<PhraseItem>::open(&local).expect("the folder opens"),
        &local,
    )
    .expect("batches")
}

#[test]
fn passing_faults_are_survived_and_no_wrong_byte_is_used() {
    for fault in [
        Fault::Status(500),
        Fault::Status(503),
        Fault::Status(429),
        Fault::Reset,
        Fault::Truncate,
        Fault::Corrupt,
    ] {
        let (folder, server, config) = web(true);
        server.inject(
            "manifest",
            fault,
            if fault == Fault::Corrupt { 0 } else { 2 },
        );
        server.inject("synthetic_00003/trajectory.npy", fault, 2);
        server.inject("synthetic_00007/features.npz", fault, 2);
        let dataset =
            Dataset::<PhraseItem>::open(&config).unwrap_or_else(|e| panic!("{fault:?}: {e}"));
        let found = batches(&dataset, &config).unwrap_or_else(|e| panic!("{fault:?}: {e}"));
        assert_eq!(found, local_batches(&folder, &config), "{fault:?}");
        let injected = server.injected();
        assert_eq!(
            injected,
            if fault == Fault::Corrupt { 4 } else { 6 },
            "{fault:?}"
        );
        assert_eq!(dataset.report().retries, injected as u64, "{fault:?}");
    }
}

#[test]
fn a_stalled_answer_is_given_up_and_tried_again() {
    let (folder, server, config) = web(true);
    server.inject("synthetic_00003/features.npz", Fault::Stall, 1);
    let dataset = Dataset::<PhraseItem>::open(&config).expect("the second try answers");
    assert_eq!(
        batches(&dataset, &config).expect("batches"),
        local_batches(&folder, &config)
    );
    assert_eq!(server.injected(), 1);
}

#[test]
fn lasting_faults_end_with_the_object_s_name() {
    for (fault, expected) in [
        (Fault::Status(500), "500"),
        (Fault::Status(429), "429"),
        (Fault::Reset, "after 2 attempts"),
        (Fault::Truncate, "after 2 attempts"),
        (Fault::Stall, "after 2 attempts"),
        (Fault::Corrupt, "not those in manifest.parquet"),
    ] {
        let (_folder, server, mut config) = web(true);
        config.store.max_retries = 1;
        config.store.timeout_seconds = 0.3;
        server.inject("synthetic_00005/features.npz", fault, usize::MAX);
        let message = Dataset::<PhraseItem>::open(&config)
            .expect_err("it never works")
            .to_string();
        let object = format!(
            "{}/set/audio_features/synthetic_00005/features.npz",
            server.endpoint()
        );
        assert!(message.contains(&object), "{fault:?}: {message}");
        assert!(message.contains(expected), "{fault:?}: {message}");
    }
}

#[test]
fn answers_longer_than_stated_and_slow_trickles_end() {
    for (fault, expected) in [
        (Fault::Endless, "more than 10 bytes came"),
        (Fault::EndlessRefusal, "more than 65536 bytes came"),
        (Fault::Trickle, "less than 4096 bytes came in a second"),
    ] {
        let (_folder, server, mut config) = web(true);
        config.store.max_retries = if fault == Fault::Endless { 5 } else { 0 };
        server.inject("synthetic_00005/features.npz", fault, usize::MAX);
        let started = std::time::Instant::now();
        let error = Dataset::<PhraseItem>::open(&config).expect_err("it never ends");
        let message = error.to_string();
        assert!(message.contains(expected), "{fault:?}: {message}");
        // A response that contradicts itself is bad input, and no second attempt mends it.
        assert_eq!(error.is_failure(), fault != Fault::Endless, "{fault:?}");
        assert!(started.elapsed().as_secs() < 20, "{fault:?}");
        // What the buffers of both sides take.
        assert!(
            server.endless_mib() < 64,
            "{fault:?}: {}",
            server.endless_mib()
        );
    }
}

#[test]
fn names_too_long_for_an_address_are_errors() {
    let (_folder, _server, config) = web(true);
    let source = config.source.as_deref().expect("an address");
    let store = Store::open(source, &config.store).expect("a store");
    let error = store.read(&"x".repeat(70_000), 100).expect_err("too long");
    assert!(
        error.to_string().contains("no request can be made"),
        "{error}"
    );
}

#[test]
fn forbidden_objects_are_not_tried_again() {
    let (_folder, server, config) = web(true);
    server.inject(
        "synthetic_00005/features.npz",
        Fault::Status(403),
        usize::MAX,
    );
    let error = Dataset::<PhraseItem>::open(&config).expect_err("forbidden");
    let message = error.to_string();
    assert!(message.contains("access denied"), "{message}");
    assert_eq!(server.injected(), 1);
}

#[test]
fn phrases_of_a_batch_that_are_far_away_are_read_at_once() {
    let (_folder, server, mut config) = web(true);
    config.cache.memory_mib = 0;
    config.cache.disk_mib = 0;
    config.num_workers = 1;
    // A request that is retried while the first try is answered counts twice.
    config.store.timeout_seconds = 30.0;
    let most_with = |concurrency| {
        let mut config = config.clone();
        config.store.concurrency = concurrency;
        let dataset = Dataset::<PhraseItem>::open(&config).expect("all is there");
        let statistics = Arc::new(dataset.statistics().expect("statistics"));
        server.take_most_under_way();
        server.inject("synthetic_", Fault::Slow, config.batch_size);
        let mut loader = loader(&dataset, statistics, &config);
        loader.next().expect("all is there");
        drop(loader);
        server.take_most_under_way()
    };
    assert_eq!(most_with(1), 1);
    assert!(most_with(4) > 2);
}

/// Opens a dataset without a cache, applies `change` and continues.
fn changed_under_way(change: impl Fn(&Path)) -> (String, Vec<Vec<f32>>) {
    let (folder, _server, mut config) = web(true);
    config.cache.memory_mib = 0;
    config.num_workers = 0;
    let dataset = Dataset::<PhraseItem>::open(&config).expect("all is there");
    let statistics = Arc::new(dataset.statistics().expect("statistics"));
    let mut loader = loader(&dataset, statistics, &config);
    let mut before = vec![];
    let batch = loader.next().expect("all is there");
    before.push(numbers(batch));
    let expected = local_batches(&folder, &config);
    change(&folder.path().join("set"));
    loop {
        match loader.next() {
            Ok(batch) => before.push(numbers(batch)),
            Err(error) => {
                let good = before.len();
                assert_eq!(before, expected[..good], "until then all is right");
                return (error.to_string(), before);
            }
        }
        assert!(before.len() < 6, "the change goes unnoticed");
    }
}

#[test]
fn an_object_that_changes_under_way_stops_the_run_by_name() {
    let (message, _) = changed_under_way(|set| {
        for index in 0..PHRASES {
            let path = set.join(motion_path(&synthetic::id(index)));
            let mut bytes = fs::read(&path).expect("a file");
            *bytes.last_mut().expect("not empty") ^= 1;
            fs::write(path, bytes).expect("written");
        }
    });
    assert!(
        message.contains("trajectory.npy") && message.contains("when the dataset was opened"),
        "{message}"
    );
}

#[test]
fn an_object_that_is_deleted_under_way_stops_the_run_by_name() {
    let (message, _) = changed_under_way(|set| {
        fs::remove_dir_all(set.join("audio_features")).expect("removed");
    });
    assert!(
        message.contains("features.npz") && message.contains("not found"),
        "{message}"
    );
}

#[test]
fn web_servers_need_a_manifest_and_take_no_files() {
    let (_folder, _server, config) = web(false);
    let message = Dataset::<PhraseItem>::open(&config)
        .expect_err("no manifest")
        .to_string();
    assert!(
        message.contains("http cannot list") && message.contains("manifest.parquet"),
        "{message}"
    );
    let source = config.source.as_deref().expect("a source");
    let store = Store::open(source, &config.store).expect("a server");
    let message = store.write("x", vec![]).expect_err("read only").to_string();
    assert!(message.contains("only be read"), "{message}");
}

#[test]
fn a_damaged_cache_is_read_past() {
    let (folder, server, mut config) = web(true);
    config.cache.disk_mib = 100;
    let expected = local_batches(&folder, &config);
    Dataset::<PhraseItem>::open(&config).expect("cold");
    let cold = server.requests("features.npz");
    let objects = folder.path().join("cache/objects");
    for (name, mut bytes) in contents(&objects) {
        let path = objects.join(name);
        bytes[100] ^= 4;
        fs::write(path, bytes).expect("written");
    }
    let again = Dataset::<PhraseItem>::open(&config).expect("warm, and damaged");
    assert_eq!(batches(&again, &config).expect("batches"), expected);
    assert_eq!(server.requests("features.npz"), 2 * cold);
    assert_eq!(again.report().disk_hits, 0);
}

#[test]
fn faults_before_a_bucket_are_survived_too() {
    let emulator = servers::s3();
    let proxy = FaultyServer::start(Upstream::Server(emulator.address));
    let folder = dataset(false);
    let set = folder.path().join("set");
    let mut remote = config(
        "s3://bucket",
        &folder.path().join("cache"),
        Some(proxy.endpoint()),
    );
    remote.cache.disk_mib = 0;
    let store = Store::open("s3://bucket", &remote.store).expect("a bucket");
    proxy.inject("", Fault::Status(503), 2);
    for (path, bytes) in contents(&set) {
        store.write(&path, bytes).expect("taken");
    }
    proxy.inject("list-type", Fault::Status(429), 2);
    proxy.inject("list-type", Fault::Reset, 2);
    proxy.inject("trajectory", Fault::Truncate, 3);
    proxy.inject("features", Fault::Reset, 3);
    let opened = Dataset::<PhraseItem>::open(&remote).expect("the bucket opens");
    assert_eq!(
        batches(&opened, &remote).expect("batches"),
        local_batches(&folder, &remote)
    );
    assert_eq!(proxy.injected(), 12);
}

#[test]
fn manifests_with_tricks_are_refused() {
    let (folder, _server, config) = web(true);
    let set = folder.path().join("set");
    let mut tricked = rows(&set);
    tricked[4].id = "../../outside".to_owned();
    let store = Store::open(&set.display().to_string(), &StoreConfig::default()).expect("a folder");
    manifest::write(&store, tricked).expect("written");
    let message = Dataset::<PhraseItem>::open(&config)
        .expect_err("a trick")
        .to_string();
    assert!(
        message.contains(MANIFEST) && message.contains("../../outside"),
        "{message}"
    );
}
