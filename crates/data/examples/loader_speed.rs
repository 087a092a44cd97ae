//! Training samples per second of the loader: kinegrad's side of `scripts/loader/run`.
//!
//! ```text
//! loader_speed write FOLDER PHRASES FRAMES
//! loader_speed measure FOLDER WORKERS MEMORY_MIB WARM_UP_EPOCHS
//! ```
//!
//! `write` writes a synthetic dataset and `statistics.json`. `measure` prints the sums of an epoch
//! as one JSON line. Each further input line is a number of seconds; the answer is the samples per
//! second over this time.

use std::error::Error;
use std::io::BufRead;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use kinegrad_data::{
    CacheConfig, DataConfig, Dataset, Loader, PhraseItem, PhraseSamples, ValidationSplit, synthetic,
};

const SEED: u64 = 7;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["write", folder, phrases, frames] => write(folder, phrases.parse()?, frames.parse()?),
        ["measure", folder, workers, memory, epochs] => {
            let mut config = config(folder);
            config.num_workers = workers.parse()?;
            config.cache.memory_mib = memory.parse()?;
            measure(&config, epochs.parse()?)
        }
        _ => Err("usage: write FOLDER PHRASES FRAMES | measure FOLDER WORKERS MEMORY_MIB EPOCHS")?,
    }
}

fn config(folder: &str) -> DataConfig {
    DataConfig {
        source: Some(folder.to_owned()),
        validation: ValidationSplit {
            fraction: Some(0.0),
            ..ValidationSplit::default()
        },
        cache: CacheConfig {
            disk_mib: 0,
            ..CacheConfig::default()
        },
        ..DataConfig::default()
    }
}

fn write(folder: &str, phrases: usize, frames: usize) -> Result<(), Box<dyn Error>> {
    synthetic::write_dataset(
        Path::new(folder),
        kinegrad_data::AudioLayout::CCMOTION,
        phrases,
        frames,
        SEED,
    )?;
    let statistics = Dataset::<PhraseItem>::open(&config(folder))?.statistics()?;
    let file = Path::new(folder).join("statistics.json");
    std::fs::write(file, serde_json::to_vec(&statistics)?)?;
    Ok(())
}

fn measure(config: &DataConfig, warm_up_epochs: usize) -> Result<(), Box<dyn Error>> {
    let dataset = Dataset::open(config)?;
    let statistics = Arc::new(dataset.statistics()?);
    let batches_per_epoch = dataset.train.len() / config.batch_size;
    let samples = PhraseSamples::new(dataset.train, statistics, config, SEED);
    let mut loader = Loader::new(samples, config, SEED, 0);
    let (mut motion, mut audio) = (0.0, 0.0);
    for _ in 0..batches_per_epoch {
        let batch = loader.next()?;
        let sum = |values: &[f32]| values.iter().map(|v| f64::from(v.abs())).sum::<f64>();
        motion += sum(&batch.x_start);
        audio += sum(&batch.conditions[0].values);
    }
    println!("{{\"motion\": {motion}, \"audio\": {audio}}}");
    for _ in 0..batches_per_epoch * warm_up_epochs {
        loader.next()?;
    }
    for line in std::io::stdin().lock().lines() {
        let seconds: f64 = line?.trim().parse()?;
        // Batches prefetched during the warm-up do not count.
        for _ in 0..2 * config.num_workers + 1 {
            loader.next()?;
        }
        let (start, mut samples) = (Instant::now(), 0);
        while start.elapsed().as_secs_f64() < seconds {
            samples += loader.next()?.batch_size;
        }
        println!("{}", samples as f64 / start.elapsed().as_secs_f64());
    }
    Ok(())
}
