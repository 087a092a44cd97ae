use super::*;

fn phrases() -> DataConfig {
    DataConfig {
        source: Some("somewhere".into()),
        ..DataConfig::default()
    }
}

#[test]
fn an_empty_table_gives_the_documented_defaults_and_survives_a_round_trip() {
    let config: DataConfig = toml::from_str("").unwrap();
    assert_eq!(config, DataConfig::default());
    assert_eq!(
        (config.target_frames, config.batch_size, config.num_workers),
        (120, 32, 4)
    );
    assert_eq!(config.validation.fraction, None);
    let full = DataConfig {
        num_phrases: Some(7),
        audio_features: AudioLayout::WITH_BEATS.groups(),
        augment: AugmentConfig {
            min_frames: Some(60),
            ..AugmentConfig::default()
        },
        ..phrases()
    };
    let text = toml::to_string(&full).unwrap();
    assert_eq!(toml::from_str::<DataConfig>(&text).unwrap(), full);
}

#[test]
fn unknown_keys_and_wrong_types_are_refused() {
    for text in [
        "batchsize = 3",
        "validation.fractions = 0.1",
        "augment.mirrors = true",
        "synthetic.frame = 3",
        "batch_size = -1",
        "crop = \"middle\"",
    ] {
        assert!(toml::from_str::<DataConfig>(text).is_err(), "{text}");
    }
}

#[test]
fn values_out_of_range_are_refused_by_their_key() {
    type Change = fn(&mut DataConfig);
    let cases: [(&str, Change); 20] = [
        ("data.target_frames", |c| c.target_frames = 3),
        ("data.audio_features", |c| c.audio_features.clear()),
        ("data.batch_size", |c| c.batch_size = 0),
        ("data.augment.path_warp_prob", |c| {
            c.augment.path_warp_prob = 0.5
        }),
        ("data.num_workers", |c| c.num_workers = 1000),
        ("data.num_phrases", |c| c.num_phrases = Some(0)),
        ("data.source", |c| c.source = None),
        ("data.validation.fraction", |c| {
            c.validation.fraction = Some(1.0)
        }),
        ("data.store.endpoint", |c| {
            c.store.endpoint = Some("host".into())
        }),
        ("data.store.timeout_seconds", |c| {
            c.store.timeout_seconds = 0.0
        }),
        ("data.store.concurrency", |c| c.store.concurrency = 0),
        ("data.cache.memory_mib", |c| c.cache.memory_mib = 1 << 30),
        ("data.validation.fraction", |c| {
            c.validation.fraction = Some(f64::NAN)
        }),
        ("data.validation.patterns", |c| {
            c.validation.patterns = vec![String::new()]
        }),
        ("data.augment.speed", |c| c.augment.speed = 1.5),
        ("data.augment.min_frames", |c| {
            c.augment.min_frames = Some(121)
        }),
        ("data.augment.audio_noise", |c| c.augment.audio_noise = -0.1),
        ("data.augment.audio_replace_prob", |c| {
            c.augment.audio_replace_prob = 1.5
        }),
        ("data.synthetic.phrases", |c| {
            c.kind = DataKind::Synthetic;
            c.synthetic.phrases = 0;
        }),
        ("data.synthetic.frames", |c| {
            c.kind = DataKind::Synthetic;
            c.synthetic.frames = 2;
        }),
    ];
    assert!(phrases().validate().is_ok());
    for (expected, change) in cases {
        let mut config = phrases();
        change(&mut config);
        match config.validate() {
            Err(Error::Config(refused)) => assert_eq!(refused.key, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}
