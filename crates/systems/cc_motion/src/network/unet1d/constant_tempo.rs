//! A constant tempo fitted to beats tracked frame by frame.

use std::f64::consts::TAU;

use burn::tensor::{Device, Tensor, TensorData};
use kinegrad_kernels::Lengths;

use super::audio::mean_around;
use crate::network::rotation::add_angle;

/// Beats per frame, for 30 to 300 beats per minute at 30 frames per second.
const SLOWEST: f64 = 30.0 / 60.0 / 30.0;
const FASTEST: f64 = 300.0 / 60.0 / 30.0;

/// Number of tempi, in steps of half a thousandth of a beat per frame. Between two tempi, phases
/// within two seconds differ by at most a seventieth of a beat.
const TEMPI: usize = 301;

/// Sine and cosine of the beat phase at a constant tempo. Music keeps its tempo, so neighboring
/// frames also determine a frame's beat phase.
///
/// The tempo `w` maximizes the agreement of the frames, `|sum_t z_t exp(-i w t)|` with `z = cos + i
/// sin`. The remaining angles, `z_t exp(-i w t)`, are averaged over two seconds twice, so that the
/// tempo may drift slightly within the music.
///
/// # Shapes
/// - found, output: sine and cosine, `[batch, 2, time]`, with a norm that grows with the agreement
///   of the frames
pub(super) fn fit_constant_tempo(found: Tensor<3>, lengths: Option<&Lengths>) -> Tensor<3> {
    let [batch, two, time] = found.dims();
    let device = found.device();
    let found = match lengths {
        Some(lengths) => found * lengths.mask(time, &device),
        None => found,
    };
    let [sines, cosines] = [f64::sin, f64::cos].map(|of| turns(of, time, &device));
    let rows = found.clone().reshape([batch * two, time]);
    let sums = |turns: &Tensor<2>| {
        let sums = rows.clone().matmul(turns.clone().transpose());
        let sums = sums.reshape([batch, two, TEMPI]);
        [0, 1].map(|row| sums.clone().narrow(1, row, 1).reshape([batch, TEMPI]))
    };
    let ([sin_sin, cos_sin], [sin_cos, cos_cos]) = (sums(&sines), sums(&cosines));
    let agreement = (cos_cos + sin_sin).square() + (sin_cos - cos_sin).square();
    let tempo = agreement.argmax(1).reshape([batch]);
    let [sine, cosine] = [sines, cosines].map(|turns| {
        let turns = turns.select(0, tempo.clone());
        turns.reshape([batch, 1, time])
    });
    let left = add_angle(found, sine.clone().neg(), cosine.clone());
    let left = mean_around(mean_around(left, lengths), lengths);
    add_angle(left, sine, cosine)
}

/// Sine or cosine of the angles at each tempo, `[TEMPI, time]`.
fn turns(of: fn(f64) -> f64, time: usize, device: &Device) -> Tensor<2> {
    let tempi = (0..TEMPI).map(|k| {
        let share = k as f64 / (TEMPI - 1) as f64;
        SLOWEST + share * (FASTEST - SLOWEST)
    });
    let angles = tempi.flat_map(|tempo| (0..time).map(move |t| (TAU * tempo * t as f64) % TAU));
    let values: Vec<f32> = angles.map(|angle| of(angle) as f32).collect();
    Tensor::from_data(TensorData::new(values, [TEMPI, time]), device)
}

#[cfg(test)]
mod tests {
    use kinegrad_motion::circular;
    use kinegrad_random::{Key, Purpose};

    use super::*;

    /// Rows of sines and cosines of beat phases `places`, with the given norms.
    fn rows(places: &[f64], norms: &[f64]) -> Vec<f32> {
        let row = |of: fn(f64) -> f64| {
            let values = places.iter().zip(norms);
            values.map(move |(place, norm)| (norm * of(TAU * place)) as f32)
        };
        row(f64::sin).chain(row(f64::cos)).collect()
    }

    /// The largest distance of the found beats from `places`, in beats.
    fn distance(found: &[f32], places: &[f64]) -> f64 {
        let (sines, cosines) = found.split_at(found.len() / 2);
        let found = sines.iter().zip(cosines);
        let found = found.map(|(s, c)| f64::from(*s).atan2(f64::from(*c)) / TAU);
        let distances = found.zip(places).map(|(a, b)| circular::distance(a, *b));
        distances.fold(0.0, f64::max)
    }

    fn fitted(found: Vec<f32>, time: usize, lengths: Option<&Lengths>) -> Vec<f32> {
        let batch = found.len() / 2 / time;
        let found = Tensor::from_data(TensorData::new(found, [batch, 2, time]), &Device::flex());
        fit_constant_tempo(found, lengths)
            .into_data()
            .try_into_vec()
            .expect("values")
    }

    #[test]
    fn a_constant_tempo_stays_and_errors_of_single_frames_go() {
        for (time, a_minute) in [(120, 66.7), (120, 131.0), (97, 204.0), (61, 88.0)] {
            let places: Vec<f64> = (0..time)
                .map(|t| 0.3 + f64::from(t) * a_minute / 1800.0)
                .collect();
            let norms = vec![0.4; places.len()];
            let kept = fitted(rows(&places, &norms), places.len(), None);
            assert!(distance(&kept, &places) < 0.01);
            // A third of the frames are wrong by half a beat, other frames by up to a tenth.
            let noise = Key::new(3, Purpose::Noise).normals(places.len());
            let found: Vec<f64> = (0..places.len())
                .map(|t| {
                    let off = 0.1 * f64::from(noise[t]).clamp(-1.0, 1.0);
                    places[t] + if t % 3 == 0 { 0.5 } else { off }
                })
                .collect();
            let found = rows(&found, &norms);
            assert!(distance(&found, &places) > 0.45);
            let mended = distance(&fitted(found, places.len(), None), &places);
            assert!(mended < 0.1, "{time} {a_minute}: {mended}");
        }
    }

    #[test]
    fn a_tempo_that_drifts_is_followed() {
        // The tempo rises from 115 to 125 beats per minute within four seconds.
        let places: Vec<f64> = (0..120)
            .map(|t| f64::from(t) / 15.65 + f64::from(t * t) / 21600.0 / 2.0)
            .collect();
        let found = fitted(rows(&places, &[1.0; 120]), 120, None);
        assert!(
            distance(&found, &places) < 0.06,
            "{}",
            distance(&found, &places)
        );
    }

    #[test]
    fn each_sample_has_its_tempo_and_padding_none() {
        let time = 90;
        let (kept, tempi) = ([90usize, 70], [1.0 / 14.3, 1.0 / 21.0]);
        let places = [0, 1].map(|sample: usize| {
            let places = (0..time).map(move |t| t as f64 * tempi[sample]);
            places.collect::<Vec<f64>>()
        });
        let found = |padding: f64| {
            let of = |sample: usize| {
                let of_frame = |t: usize| match t < kept[sample] {
                    true => places[sample][t],
                    false => padding * t as f64,
                };
                let found: Vec<f64> = (0..time).map(of_frame).collect();
                rows(&found, &vec![1.0; time])
            };
            let found = [of(0), of(1)].concat();
            fitted(found, time, Some(&Lengths::new(kept)))
        };
        let (one, other) = (found(0.31), found(0.07));
        for sample in 0..2 {
            let of = |values: &[f32]| {
                let rows = values[sample * 2 * time..][..2 * time].chunks(time);
                let kept = rows.flat_map(|row| &row[..kept[sample]]);
                kept.copied().collect::<Vec<f32>>()
            };
            assert_eq!(of(&one), of(&other));
            assert!(distance(&of(&one), &places[sample][..kept[sample]]) < 0.01);
        }
    }
}
