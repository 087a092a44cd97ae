//! Every tensor of the reference clips, against librosa 0.11.
//!
//! `data_fixtures/golden/audio` contains them as FLAC and without the tensors of [`left_out`]. The
//! tolerances are the reference data's own.

use std::path::{Path, PathBuf};

use kinegrad_audio::features::{CENTROID, CHROMA, MEL, MFCC, ONSET, RMS};
use kinegrad_audio::stft::{BINS, Stft};
use kinegrad_audio::{
    Analysis, CHANNELS, Features, FrameMatrix, HOP, beats, chroma, decode, mel, num_frames, tempo,
    tuning,
};
use kinegrad_tests::golden::{Folder, Golden, compared, differences, wide};
use kinegrad_tests::trials;
use kinegrad_tests::trials::{GoldenTest, Opened};

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_drum120("audio/drum120.safetensors") => check_clip,
        golden_sweep("audio/sweep.safetensors") => check_clip,
        golden_chords("audio/chords.safetensors") => check_clip,
        golden_stereo48k("audio/stereo48k.safetensors") => check_clip,
        golden_mono22k_detuned("audio/mono22k_detuned.safetensors") => check_clip,
        golden_edge_silence("audio/edge_silence.safetensors") => check_clip,
        golden_edge_short("audio/edge_short.safetensors") => check_clip,
        golden_edge_single_frame("audio/edge_single_frame.safetensors") => check_clip,
        golden_edge_dc("audio/edge_dc.safetensors") => check_clip,
        golden_edge_quiet("audio/edge_quiet.safetensors") => check_clip,
        golden_edge_padded_silence("audio/edge_padded_silence.safetensors") => check_clip,
        golden_stereo48k_resampled_here("audio/stereo48k.safetensors") => |clip| check_resampled(clip, &FROM_48K),
        golden_mono22k_detuned_resampled_here("audio/mono22k_detuned.safetensors") => |clip| check_resampled(clip, &FROM_22K),
    ]
}

/// Tensors that the small set omits, because they are large and later tensors cover them.
fn left_out(clip: &str) -> &'static [&'static str] {
    match clip {
        "chords" | "edge_short" | "edge_single_frame" => &[],
        // Every stage but onsets, RMS, centroid and beats.
        "edge_dc" => &[
            "chroma_unnorm",
            "cqt_mag",
            "mel_db",
            "mel_full_db",
            "mel_power",
            "mfcc_raw",
            "stft_mag_frames",
            "stft_mag_frames_idx",
        ],
        "edge_quiet" | "edge_silence" => &["cqt_mag", "mel_power"],
        "sweep" => &["mel_db", "mel_power"],
        _ => &["cqt_mag", "mel_db", "mel_power"],
    }
}

/// One reference clip: its samples and its tensors.
struct Clip {
    recording: PathBuf,
    golden: Golden,
    complete: bool,
}

/// Tolerances of the stacked tensor for a clip that is resampled.
struct Resampled {
    mel_max: f64,
    mel_mean: f64,
    mfcc_mean: f64,
    onset_max: f64,
}

const FROM_48K: Resampled = Resampled {
    mel_max: 0.02,
    mel_mean: 3e-4,
    mfcc_mean: 0.05,
    onset_max: 2e-3,
};

const FROM_22K: Resampled = Resampled {
    mel_max: 1e-3,
    mel_mean: 3e-4,
    mfcc_mean: 0.02,
    onset_max: 2e-3,
};

impl Opened for Clip {
    /// The clip with the tensors at `tensors`.
    fn open(tensors: &Path) -> Self {
        let recording = ["wav", "flac"]
            .map(|extension| tensors.with_extension(extension))
            .into_iter()
            .find(|path| path.exists())
            .expect("a recording lies beside the tensors");
        Self {
            recording,
            golden: Golden::open(tensors),
            complete: Folder::in_use().must_be_complete(),
        }
    }
}

impl Clip {
    /// The samples as decoded and converted here.
    fn decoded(&self) -> Vec<f32> {
        decode(&self.recording).expect("the clip decodes").samples
    }

    fn get(&self, key: &str) -> Vec<f64> {
        self.golden.get(key).values
    }

    /// True if the small set omits the tensor.
    fn leaves_out(&self, key: &str) -> bool {
        !self.complete && left_out(&self.name()).contains(&key) && !self.golden.has(key)
    }

    /// Asserts `|found - reference| <= tolerance` everywhere.
    fn compare(&self, key: &str, found: &[f64], tolerance: f64) {
        if !self.leaves_out(key) {
            self.golden.compare(key, found, tolerance);
        }
    }

    /// [`compare`](Self::compare), relative to the reference's largest magnitude.
    fn compare_relative(&self, key: &str, found: &[f64], tolerance: f64) {
        if !self.leaves_out(key) {
            self.golden.compare_relative(key, found, tolerance);
        }
    }

    fn name(&self) -> String {
        self.golden.name()
    }

    fn bound(&self, what: &str, error: f64, tolerance: f64) {
        self.golden.bound(what, error, tolerance);
    }
}

fn major(matrix: &FrameMatrix) -> Vec<f64> {
    wide(&matrix.channel_major())
}

fn largest_difference(what: &str, found: &[f64], reference: &[f64]) -> f64 {
    differences(what, found, reference).fold(0.0, f64::max)
}

fn mean_difference(what: &str, found: &[f64], reference: &[f64]) -> f64 {
    differences(what, found, reference).sum::<f64>() / reference.len().max(1) as f64
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product = |x: &[f64], y: &[f64], mx: f64, my: f64| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum()
    };
    product(a, b, mean_a, mean_b)
        / (product(a, a, mean_a, mean_a) * product(b, b, mean_b, mean_b)).sqrt()
}

/// Every tensor of a clip without resampling, or with a stored converted signal.
fn check_clip(clip: Clip) {
    let signal = match clip.golden.find("y_44100") {
        Some(stored) => stored.f32s(),
        None => clip.decoded(),
    };
    clip.golden
        .compare_exactly("n_samples", &[signal.len() as f64]);
    let pitch = clip.get("tuning")[0];
    clip.bound("tuning", (tuning::estimate(&signal) - pitch).abs(), 0.0101);
    let analysis = Analysis::with_tuning(&signal, pitch).expect("finite samples");
    check_stages(&clip, &signal, &analysis);
    check_beats(&clip, &analysis.onset.median);
    check_stacked(&clip, &analysis);
}

fn check_stages(clip: &Clip, signal: &[f32], analysis: &Analysis) {
    if !clip.leaves_out("stft_mag_frames_idx") {
        let stft = Stft::default();
        let mut scratch = stft.scratch();
        let mut found = Vec::new();
        for t in clip.golden.get("stft_mag_frames_idx").indices() {
            found.extend(wide(stft.magnitudes(signal, t * HOP, &mut scratch)));
        }
        assert!(found.len().is_multiple_of(BINS));
        clip.compare_relative("stft_mag_frames", &found, 1e-5);
    }
    let loudest = mel::maximum(&analysis.mel_power);
    let mel_db = mel::decibels(analysis.mel_power.clone(), loudest);
    clip.compare_relative("mel_power", &major(&analysis.mel_power), 1e-5);
    clip.compare("mel_db", &major(&mel_db), 2e-3);
    clip.compare("mel_full_db", &major(&analysis.mel_full_db), 2e-3);
    clip.compare("mfcc_raw", &major(&analysis.mfcc), 1e-2);
    clip.compare_relative("cqt_mag", &major(&analysis.cqt), 1.5e-3);
    clip.compare_relative("chroma_unnorm", &major(&analysis.chroma), 1.5e-3);
    clip.compare("rms", &wide(&analysis.rms), 1e-5);
    clip.compare("centroid", &wide(&analysis.centroid), 0.05);
    clip.compare("onset", &wide(&analysis.onset.mean), 1e-3);
    clip.compare("onset_median", &wide(&analysis.onset.median), 1e-3);
}

fn check_beats(clip: &Clip, onset_median: &[f32]) {
    let found = beats::track(onset_median);
    let frames: Vec<f64> = found.frames.iter().map(|&t| t as f64).collect();
    clip.compare("tempo", &[found.tempo], 1e-9);
    clip.golden.compare_exactly("beat_frames", &frames);
    clip.compare("beat_times", &found.times(), 1e-5);
    if found.tempo == 0.0 {
        return;
    }
    let tempo = tempo::estimate(onset_median);
    let search = beats::Search::new(onset_median, &tempo);
    clip.compare("tempogram_mean", &tempo.tempogram_mean, 1e-4);
    clip.compare("frames_per_beat", &[search.frames_per_beat as f64], 0.0);
    clip.compare_relative("beat_local_score", &search.local_score, 1e-4);
    clip.compare_relative("beat_cumscore", &search.cumulative_score, 1e-4);
    check_links(clip, &search);
}

/// The links agree, or have equal scores: single-precision scores can tie.
fn check_links(clip: &Clip, search: &beats::Search) {
    let reference = clip.get("beat_backlink");
    assert_eq!(search.backlinks.len(), reference.len(), "{}", clip.name());
    let period = search.frames_per_beat as f64;
    let chain = |i: usize, link: usize| {
        let stretch = ((i - link) as f64).ln() - period.ln();
        search.cumulative_score[link] - 100.0 * stretch * stretch
    };
    for (i, (link, expected)) in search.backlinks.iter().zip(reference).enumerate() {
        let expected = (expected >= 0.0).then_some(expected as usize);
        assert_eq!(
            link.is_some(),
            expected.is_some(),
            "{} link {i}",
            clip.name()
        );
        compared(1);
        if let (Some(link), Some(expected)) = (*link, expected) {
            let better = chain(i, link) - chain(i, expected);
            assert!(better <= 1e-4, "{} link {i}: {better:e}", clip.name());
        }
    }
}

fn check_stacked(clip: &Clip, analysis: &Analysis) {
    let features = analysis.clone().features();
    let frames = features.frames();
    let reference = clip.get("stacked");
    assert_eq!(reference.len(), CHANNELS * frames);
    let row = |c: usize| &reference[c * frames..(c + 1) * frames];
    let found = |c: usize| wide(features.rows(c..c + 1));
    let worst = |rows: std::ops::Range<usize>| {
        rows.map(|c| largest_difference("stacked", &found(c), row(c)))
            .fold(0.0, f64::max)
    };
    clip.bound("stacked mel", worst(MEL), 1e-4);
    clip.bound("stacked rms", worst(RMS..RMS + 1), 1e-5);
    clip.bound("stacked centroid", worst(CENTROID..CENTROID + 1), 1e-5);
    clip.bound("stacked onset", worst(ONSET..ONSET + 1), 1e-4);
    for (i, c) in MFCC.enumerate() {
        let raw: Vec<f64> = analysis.mfcc.channel(i).map(f64::from).collect();
        if deviation(&raw) < 1e-3 {
            // A constant row: the reference contains rounding noise.
            assert!(found(c).iter().all(|v| v.abs() <= 1.0), "{}", clip.name());
        } else {
            let error = largest_difference("stacked mfcc", &found(c), row(c));
            clip.bound("stacked mfcc", error, 1e-3);
        }
    }
    check_chroma(clip, &analysis.chroma, &features, &reference);
}

/// Frames with almost no energy contain magnified leakage, so only their range is checked.
fn check_chroma(clip: &Clip, unnormalised: &FrameMatrix, features: &Features, reference: &[f64]) {
    assert_eq!(
        chroma::normalise(unnormalised.clone()).channel_major(),
        features.rows(CHROMA)
    );
    let frames = features.frames();
    let peak = |t: usize| unnormalised.frame(t).iter().copied().fold(0.0, f32::max);
    let loudest = (0..frames).map(peak).fold(0.0, f32::max);
    let (mut found, mut expected) = (Vec::new(), Vec::new());
    for (i, &value) in features.rows(CHROMA).iter().enumerate() {
        assert!(
            (0.0..=1.0).contains(&value),
            "{} chroma {value}",
            clip.name()
        );
        if peak(i % frames) > 0.01 * loudest {
            found.push(f64::from(value));
            expected.push(reference[CHROMA.start * frames + i]);
        }
    }
    if found.is_empty() {
        return;
    }
    clip.bound(
        "stacked chroma",
        largest_difference("chroma", &found, &expected),
        0.01,
    );
    clip.bound(
        "stacked chroma mean",
        mean_difference("chroma", &found, &expected),
        2e-3,
    );
    clip.bound(
        "stacked chroma 1 - correlation",
        1.0 - correlation(&found, &expected),
        1e-4,
    );
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// All stages from the file, with this crate's resampler in place of the reference's.
fn check_resampled(clip: Clip, allowed: &Resampled) {
    let signal = clip.decoded();
    clip.golden
        .compare_exactly("n_samples", &[signal.len() as f64]);
    let analysis = Analysis::new(&signal).expect("finite samples");
    let features = analysis.clone().features();
    let frames = features.frames();
    assert_eq!(frames, num_frames(signal.len()));
    let reference = clip.get("stacked");
    let part = |rows: std::ops::Range<usize>| {
        let expected = &reference[rows.start * frames..rows.end * frames];
        (wide(features.rows(rows)), expected)
    };
    let (mel, mel_reference) = part(MEL);
    let (mfcc, mfcc_reference) = part(MFCC);
    let (onset, onset_reference) = part(ONSET..ONSET + 1);
    let mel_max = largest_difference("mel", &mel, mel_reference);
    let mel_mean = mean_difference("mel", &mel, mel_reference);
    let mfcc_mean = mean_difference("mfcc", &mfcc, mfcc_reference);
    let onset_max = largest_difference("onset", &onset, onset_reference);
    clip.bound("resampled mel", mel_max, allowed.mel_max);
    clip.bound("resampled mel mean", mel_mean, allowed.mel_mean);
    clip.bound("resampled mfcc mean", mfcc_mean, allowed.mfcc_mean);
    clip.bound("resampled onset", onset_max, allowed.onset_max);
    clip.bound(
        "resampled tuning",
        (analysis.tuning - clip.get("tuning")[0]).abs(),
        0.0101,
    );
    check_chroma(&clip, &analysis.chroma, &features, &reference);
    let beats: Vec<f64> = features.beats().frames.iter().map(|&t| t as f64).collect();
    clip.golden.compare_exactly("beat_frames", &beats);
}
