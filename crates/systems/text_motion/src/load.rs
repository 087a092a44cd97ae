//! The encoders of a config, and the vectors of its words.

use burn::tensor::Device;
use kinegrad_data::humanml::read_word_vectors;
use kinegrad_models::Initializer;
use kinegrad_motion::metrics::text_motion::{MAX_WORDS, WordVectors};
use kinegrad_train::Error;
use kinegrad_train::config::Config;
use kinegrad_train::memory::Footprint;

use super::{TextMotionTables, WordsConfig};
use crate::network::{TextMotionConfig, TextMotionEncoders};

/// Channels of a frame that the encoders read: all channels except the contact flags.
pub(super) fn channels(config: &Config) -> usize {
    let skeleton = config.data.humanml3d.skeleton();
    skeleton.layout().contacts().start
}

pub(super) fn word_vectors(words: &WordsConfig) -> Result<WordVectors, Error> {
    Ok(match words.vectors.as_os_str().is_empty() {
        true => WordVectors::random(words.width),
        false => read_word_vectors(&words.vectors)?,
    })
}

/// The sizes of the encoders for word vectors of `width`.
fn sizes(config: &Config, width: usize) -> TextMotionConfig {
    TextMotionConfig {
        channels: channels(config),
        word_vector: width,
        sizes: *config.own::<TextMotionTables>().model.network.sizes(),
    }
}

pub(super) fn encoders(config: &Config, width: usize, device: &Device) -> TextMotionEncoders {
    sizes(config, width).init(&Initializer::new(config.run.seed, device))
}

pub(super) fn footprint(config: &Config) -> Result<Footprint, Error> {
    let width = word_vectors(&config.own::<TextMotionTables>().words)?.width();
    let TextMotionConfig {
        channels, sizes, ..
    } = sizes(config, width);
    let (frames, words) = (config.data.target_frames, MAX_WORDS + 2);
    let motion =
        frames * (2 * sizes.convolution) + frames / 4 * (sizes.movement + 8 * sizes.motion_state);
    let text = words * (2 * width + 8 * sizes.text_state);
    let item = channels * frames + (width + 1) * words;
    let encoders = encoders(config, width, &Device::flex());
    Ok(Footprint::of(&encoders, (motion + text) as u64, item))
}
