//! The nearest phase that advances evenly.
//!
//! If a model knows the beats but not the bar lines, the phase jumps by whole beats. The fit uses
//! the most even fraction of a bar ([`parts`]) and the bar position that most frames predict.
//!
//! Dynamic programming finds the path `p` that maximizes `sum cos 2 pi (p_t - phase_t)`. The
//! advance per frame is between 0.5 and 1.5 times the tempo. The path is then smoothed:
//!
//! ```text
//! min_q  sum_t |q_t - p_t - d_t|^2 + S^4 |q_{t+2} - 2 q_{t+1} + q_t|^2
//! ```
//!
//! `d_t` is the shortest distance from path to predicted phase, or 0 beyond an eighth of a turn.

use std::f64::consts::TAU;

use super::weight;
use crate::banded::{BAND, Cholesky};
use crate::phrase::PHASE;
use crate::{Phrase, circular};

/// `S`; changes of tempo within four seconds count as noise.
const SMOOTHING_FRAMES: f64 = 20.0;

/// Number of positions in a bar for dynamic programming.
const PLACES: usize = 256;

/// Largest number of candidate advances.
const MOST_ADVANCES: usize = 32;

/// Range of the advance per frame, relative to the tempo.
const SHARES: [f64; 2] = [0.5, 1.5];

/// Frames over which the tempo is constant.
const SPAN_FRAMES: usize = 120;

/// Number of compared tempos.
const TEMPOS: usize = 4 * SPAN_FRAMES;

/// Largest distance of a counted phase from the path, in turns.
const NEAR: f64 = 0.125;

/// Largest number of parts of a bar.
const MOST_PARTS: usize = 8;

/// Allowed loss of agreement for fewer parts.
const AGREEMENT_MARGIN: f64 = 0.1;

/// The second difference of three frames.
const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];

/// Replaces the phase by the nearest even phase, in [0, 1), except in `known` frames.
pub fn fit_phase(motion: &mut Phrase, known: &[bool]) {
    let frames = motion.frames();
    assert_eq!(known.len(), frames, "known frames");
    let stated = motion.column(PHASE);
    let in_parts = |parts: usize| -> Vec<f64> {
        let of_part: Vec<f64> = stated.iter().map(|turn| parts as f64 * turn).collect();
        let fitted = fit(&of_part, known);
        let bar = bar(&fitted, &stated, known, parts);
        let turns = fitted.iter().map(|turn| (turn + bar) / parts as f64);
        turns.collect()
    };
    let parts = parts(&stated);
    let mut fitted = in_parts(parts);
    // Known frames in different bar positions need a fit in whole bars.
    let misses =
        |t: usize| known[t] && circular::distance(fitted[t], stated[t]) > 0.5 / parts as f64;
    if (0..frames).any(misses) {
        fitted = in_parts(1);
    }
    for t in (0..frames).filter(|t| !known[*t]) {
        let phase = fitted[t].rem_euclid(1.0) as f32;
        // Values just below 1 may round to 1.
        motion.frame_mut(t)[PHASE] = if phase < 1.0 { phase } else { 0.0 };
    }
}

/// The smallest number of parts of a bar whose agreement with a tempo is nearly the best.
fn parts(stated: &[f64]) -> usize {
    let agreement = |parts: usize| {
        let of_part: Vec<f64> = stated.iter().map(|turn| parts as f64 * turn).collect();
        tempo(&of_part).1
    };
    let agreements: Vec<f64> = (1..=MOST_PARTS).map(agreement).collect();
    let best = agreements.iter().copied().fold(0.0, f64::max);
    let enough = |agreement: &f64| *agreement >= best - AGREEMENT_MARGIN;
    1 + agreements.iter().position(enough).unwrap_or(0)
}

/// The whole turns that bring `fitted`, in `parts` of a bar, nearest to the predicted phases.
fn bar(fitted: &[f64], stated: &[f64], known: &[bool], parts: usize) -> f64 {
    let agreement = |bar: usize| {
        let frames = fitted.iter().zip(stated).zip(known);
        let gains = frames.map(|((turn, stated), known)| {
            let turn = (turn + bar as f64) / parts as f64;
            weight(*known) * (TAU * (turn - stated)).cos()
        });
        gains.sum::<f64>()
    };
    let bars = (0..parts).map(|bar| (agreement(bar), bar as f64));
    let best = bars.reduce(|a, b| if b.0 > a.0 { b } else { a });
    best.map_or(0.0, |(_, bar)| bar)
}

/// The smooth path nearest to the predicted phases, unwrapped.
fn fit(stated: &[f64], known: &[bool]) -> Vec<f64> {
    let path = path(stated, known);
    let frames = stated.len();
    let mut normal = vec![[0.0; BAND]; frames];
    let mut fitted = Vec::with_capacity(frames);
    for (t, row) in normal.iter_mut().enumerate() {
        let rest = stated[t] - path[t];
        let rest = rest - rest.round();
        let near = known[t] || rest.abs() < NEAR;
        row[0] = weight(known[t]);
        fitted.push(row[0] * (path[t] + if near { rest } else { 0.0 }));
    }
    for first in 0..frames.saturating_sub(2) {
        for (i, a) in SECOND_DIFFERENCE.iter().enumerate() {
            for (j, b) in SECOND_DIFFERENCE.iter().enumerate().take(i + 1) {
                normal[first + i][i - j] += SMOOTHING_FRAMES.powi(4) * a * b;
            }
        }
    }
    Cholesky::new(normal).solve(&mut fitted);
    fitted
}

/// The unwrapped path that agrees best with the predicted phases.
fn path(stated: &[f64], known: &[bool]) -> Vec<f64> {
    let place = |turn: f64| (turn * PLACES as f64).rem_euclid(PLACES as f64) as usize % PLACES;
    let cosine = |place: usize| (TAU * place as f64 / PLACES as f64).cos();
    let cosines: Vec<f64> = (0..PLACES).map(cosine).collect();
    let gain = |t: usize, at: usize| {
        let apart = (at + PLACES - place(stated[t])) % PLACES;
        weight(known[t]) * cosines[apart]
    };
    let advances = advances(stated);
    let from = |at: usize, advance: i64| (at as i64 - advance).rem_euclid(PLACES as i64) as usize;
    let mut best: Vec<f64> = (0..PLACES).map(|at| gain(0, at)).collect();
    let mut chosen: Vec<[u8; PLACES]> = Vec::with_capacity(stated.len());
    for t in 1..stated.len() {
        let mut next = vec![0.0; PLACES];
        let mut choice = [0; PLACES];
        for (at, (next, choice)) in next.iter_mut().zip(&mut choice).enumerate() {
            let mut most = f64::NEG_INFINITY;
            for (number, advance) in advances.iter().enumerate() {
                let before = best[from(at, *advance)];
                if before > most {
                    (most, *choice) = (before, number as u8);
                }
            }
            *next = most + gain(t, at);
        }
        // Large sums over known frames would cancel the digits of other frames.
        let largest = next.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        next.iter_mut().for_each(|sum| *sum -= largest);
        best = next;
        chosen.push(choice);
    }
    let last = (0..PLACES).reduce(|a, b| if best[b] > best[a] { b } else { a });
    let mut at = last.expect("places");
    let mut steps: Vec<i64> = Vec::with_capacity(chosen.len());
    for choice in chosen.iter().rev() {
        let advance = advances[usize::from(choice[at])];
        steps.push(advance);
        at = from(at, advance);
    }
    let mut count = at as i64;
    let mut path = vec![count as f64 / PLACES as f64];
    for step in steps.into_iter().rev() {
        count += step;
        path.push(count as f64 / PLACES as f64);
    }
    path.truncate(stated.len());
    path
}

/// Candidate advances of a path per frame, around the tempo; not 0 if possible.
fn advances(stated: &[f64]) -> Vec<i64> {
    let mean = tempo(stated).0 * PLACES as f64;
    let mut bounds = SHARES.map(|share| share * mean);
    bounds.sort_by(f64::total_cmp);
    let [mut low, mut high] = [bounds[0].floor() as i64, bounds[1].ceil() as i64];
    if mean >= 1.0 {
        low = low.max(1);
    } else if mean <= -1.0 {
        high = high.min(-1);
    }
    let step = ((high - low + 1) as usize).div_ceil(MOST_ADVANCES);
    (low..=high).step_by(step).collect()
}

/// The advance in turns per frame, -0.5 to 0.5, with the best agreement with the phases, and that
/// agreement, 0 to 1. The agreement is the mean over spans of `|sum exp(2 pi i (phase_t - advance
/// t))|`.
fn tempo(stated: &[f64]) -> (f64, f64) {
    let unit = |turns: f64| (TAU * turns).sin_cos();
    let phases: Vec<(f64, f64)> = stated.iter().map(|&turns| unit(turns)).collect();
    let fits = |advance: f64| {
        let (sin, cos) = unit(advance);
        let of_span = |span: &[(f64, f64)]| {
            // Horner's scheme, from the last frame to the first.
            let sum = span.iter().rev().fold((0.0, 0.0), |(y, x), (s, c)| {
                (s + y * cos - x * sin, c + x * cos + y * sin)
            });
            sum.0.hypot(sum.1)
        };
        phases.chunks(SPAN_FRAMES).map(of_span).sum::<f64>()
    };
    let tempos = (1..=TEMPOS).map(|k| k as f64 / TEMPOS as f64 - 0.5);
    let best = tempos.map(|advance| (fits(advance), advance));
    let best = best.reduce(|a, b| if b.0 > a.0 { b } else { a });
    let (sum, advance) = best.expect("tempos");
    (advance, sum / stated.len() as f64)
}

#[cfg(test)]
mod tests {
    use kinegrad_random::{Key, Purpose};

    use super::*;
    use crate::phrase::CHANNELS;

    /// A motion with these phases in turns.
    fn with_phases(turns: &[f64]) -> Phrase {
        let mut motion = Phrase::new(vec![0.0; CHANNELS * turns.len()]).expect("whole frames");
        for (t, turn) in turns.iter().enumerate() {
            motion.frame_mut(t)[PHASE] = turn.rem_euclid(1.0) as f32;
        }
        motion
    }

    fn distance(motion: &Phrase, turns: &[f64]) -> f64 {
        let phase = |t: usize| f64::from(motion.frame(t)[PHASE]);
        let distances = turns.iter().enumerate();
        let distances = distances.map(|(t, turn)| circular::distance(phase(t), *turn));
        distances.fold(0.0, f64::max)
    }

    #[test]
    fn a_phase_at_constant_tempo_stays() {
        for (frames, rate) in [(1, 0.02), (2, 0.02), (3, 0.5), (90, 0.017), (77, -0.01)] {
            let turns: Vec<f64> = (0..frames).map(|t| 0.3 + rate * f64::from(t)).collect();
            let mut motion = with_phases(&turns);
            fit_phase(&mut motion, &vec![false; turns.len()]);
            assert!(distance(&motion, &turns) < 1e-4, "{frames} {rate}");
            let phases = (0..turns.len()).map(|t| motion.frame(t)[PHASE]);
            assert!(phases.into_iter().all(|phase| (0.0..1.0).contains(&phase)));
        }
    }

    #[test]
    fn noise_goes_and_a_tempo_that_changes_stays() {
        // From 0.45 to 0.6 bars per second within a minute; the noise is a twentieth of a bar.
        let truth: Vec<f64> = (0..1800)
            .map(|t| f64::from(t) / 30.0)
            .map(|seconds| 0.9 + 0.45 * seconds + 0.15 / 120.0 * seconds * seconds)
            .collect();
        let noise = Key::new(3, Purpose::Noise).normals(truth.len());
        let stated = truth.iter().zip(noise);
        let stated: Vec<f64> = stated.map(|(turn, n)| turn + 0.05 * f64::from(n)).collect();
        let mut motion = with_phases(&stated);
        assert!(
            crate::motion_measures::phase_steps(&motion)
                .iter()
                .any(|step| *step < -0.05)
        );
        fit_phase(&mut motion, &vec![false; truth.len()]);
        assert!(
            distance(&motion, &truth) < 0.05,
            "{}",
            distance(&motion, &truth)
        );
        for step in crate::motion_measures::phase_steps(&motion) {
            assert!((0.005..0.03).contains(&step), "{step}");
        }
    }

    #[test]
    fn a_lasting_change_of_the_bar_is_followed_and_a_short_one_ignored() {
        let even: Vec<f64> = (0..900).map(|t| 0.1 + 0.0125 * f64::from(t)).collect();
        // The phase is a beat late from second 10 on, and briefly at second 20.
        let later = |t: usize, turn: f64| turn - if t >= 300 { 0.25 } else { 0.0 };
        let lasting: Vec<f64> = even
            .iter()
            .enumerate()
            .map(|(t, turn)| later(t, *turn))
            .collect();
        let blip = |t: usize| if (600..610).contains(&t) { 0.25 } else { 0.0 };
        let stated: Vec<f64> = lasting
            .iter()
            .enumerate()
            .map(|(t, turn)| turn + blip(t))
            .collect();
        let mut motion = with_phases(&stated);
        fit_phase(&mut motion, &[false; 900]);
        let steps = crate::motion_measures::phase_steps(&motion);
        assert!(
            steps.iter().all(|step| (0.004..0.02).contains(step)),
            "{steps:?}"
        );
        let apart = |t: usize| circular::distance(f64::from(motion.frame(t)[PHASE]), lasting[t]);
        let settled = (0..200).chain(400..900);
        let worst = settled.map(apart).fold(0.0, f64::max);
        assert!(worst < 0.03, "{worst}");
    }

    #[test]
    fn jumps_between_bars_by_beats_leave_the_beat() {
        for (beats, tempo, frames) in [(4, 0.0161, 2700), (3, 0.0153, 120), (4, 0.0187, 131)] {
            let beat = 1.0 / f64::from(beats);
            let jumps = Key::new(6, Purpose::Noise).integers(frames / 40, beats as usize);
            let noise = Key::new(5, Purpose::Noise).normals(frames);
            let truth: Vec<f64> = (0..frames).map(|t| 0.37 + tempo * t as f64).collect();
            let stated: Vec<f64> = (0..frames)
                .map(|t| {
                    let bar = jumps[(t / 40).min(jumps.len() - 1)] as f64 * beat;
                    truth[t] + bar + 0.01 * f64::from(noise[t])
                })
                .collect();
            let mut motion = with_phases(&stated);
            fit_phase(&mut motion, &vec![false; frames]);
            let off = |t: usize| {
                let phase = f64::from(motion.frame(t)[PHASE]);
                circular::distance(phase / beat, truth[t] / beat)
            };
            let worst = (0..frames).map(off).fold(0.0, f64::max);
            assert!(worst < 0.06, "{beats} {tempo}: {worst}");
            let steps = crate::motion_measures::phase_steps(&motion);
            let even = |step: &f64| (step - tempo).abs() < 0.002;
            assert!(steps.iter().all(even), "{beats} {tempo}");
        }
    }

    #[test]
    fn known_frames_choose_the_bar() {
        // The last second is known, a beat off; the first second is known in either bar.
        for first in [0.25, 0.0] {
            let frames = 300;
            let truth = |t: usize| 0.2 + 0.0151 * t as f64;
            let stated = |t: usize| match t {
                0..30 => truth(t) + first,
                270.. => truth(t) + 0.25,
                _ => truth(t) + 0.25 * ((t / 30) % 4) as f64,
            };
            let stated: Vec<f64> = (0..frames).map(stated).collect();
            let known: Vec<bool> = (0..frames).map(|t| !(30..270).contains(&t)).collect();
            let (mut motion, before) = (with_phases(&stated), with_phases(&stated));
            fit_phase(&mut motion, &known);
            for t in (0..30).chain(270..frames) {
                assert_eq!(motion.frame(t), before.frame(t));
            }
            let steps = crate::motion_measures::phase_steps(&motion);
            let allowed = if first == 0.25 { 0.002 } else { 0.013 };
            let even = |step: &f64| (step - 0.0151).abs() < allowed;
            assert!(steps.iter().all(even), "{first}: {steps:?}");
        }
    }

    #[test]
    fn long_motion_and_arbitrary_phases_are_fitted() {
        let noise = Key::new(8, Purpose::Noise).uniforms(20_000);
        let stated: Vec<f64> = noise.into_iter().map(f64::from).collect();
        let mut motion = with_phases(&stated);
        fit_phase(&mut motion, &vec![false; stated.len()]);
        let phases = (0..stated.len()).map(|t| motion.frame(t)[PHASE]);
        assert!(phases.into_iter().all(|phase| (0.0..1.0).contains(&phase)));
    }

    #[test]
    fn the_tempo_is_found_under_much_noise() {
        for seed in 0..40 {
            let noise = Key::new(seed, Purpose::Noise).normals(120);
            let stated = noise.iter().enumerate();
            let stated: Vec<f64> = stated
                .map(|(t, n)| t as f64 / 60.0 + 0.15 * f64::from(*n))
                .collect();
            let found = tempo(&stated).0;
            assert!((found - 1.0 / 60.0).abs() < 0.004, "{seed}: {found}");
            let mut motion = with_phases(&stated);
            fit_phase(&mut motion, &[false; 120]);
            let steps = crate::motion_measures::phase_steps(&motion);
            assert!(
                steps.iter().all(|step| (0.0..0.035).contains(step)),
                "{seed}"
            );
        }
    }

    #[test]
    fn a_known_phase_is_kept() {
        let mut turns: Vec<f64> = (0..60).map(|t| 0.02 * f64::from(t)).collect();
        turns[40..].iter_mut().for_each(|turn| *turn += 0.2);
        let known: Vec<bool> = (0..60).map(|t| t < 40).collect();
        let (mut motion, before) = (with_phases(&turns), with_phases(&turns));
        fit_phase(&mut motion, &known);
        for t in 0..40 {
            assert_eq!(motion.frame(t), before.frame(t));
        }
        let steps = crate::motion_measures::phase_steps(&motion);
        assert!(steps[39..].iter().all(|step| (0.0..0.05).contains(step)));
    }
}
