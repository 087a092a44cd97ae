//! Group normalization with FiLM and an activation: `activation(scale (x - mean) + shift)`, with
//! one affine map per channel and sample.

use std::mem::MaybeUninit;

use super::activation::{Activation, Pointwise, with_activation};
use super::rows::{ColumnTask, Rows, SharedRows, column_tasks};
use super::simd::vectorized;
use super::team;
use crate::lengths::frames_of;

/// The settings of a group normalization.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupNormPlan {
    /// Number of groups.
    pub groups: usize,
    /// Added to the variance.
    pub eps: f64,
    /// Activation of the result.
    pub activation: Activation,
}

/// A group normalization of one input, with parameters in the order of their application.
#[derive(Clone, Copy)]
pub struct Norm<'a> {
    /// Groups, eps and activation.
    pub plan: GroupNormPlan,
    /// The statistics of the input.
    pub statistics: &'a Statistics,
    /// Scale of each channel.
    pub weight: &'a [f32],
    /// Shift of each channel.
    pub bias: &'a [f32],
    /// Scale (to which 1 is added) and shift of each sample's channels, `[batch, 2 channels]`,
    /// scales first.
    pub film: Option<&'a [f32]>,
    /// Factor of each element after the activation.
    pub mask: Option<Rows<'a>>,
    /// Valid frames of each sample; other frames become zeros.
    pub lengths: Option<&'a [usize]>,
}

/// Mean and reciprocal deviation of each sample's groups.
#[derive(Clone, Debug)]
pub struct Statistics(Vec<[f32; 2]>);

/// Gradients of a normalization's parameters.
pub struct NormGradients {
    /// Of the scales.
    pub weight: Vec<f32>,
    /// Of the shifts.
    pub bias: Vec<f32>,
    /// Of FiLM.
    pub film: Option<Vec<f32>>,
}

/// The maps `u = scale (x - mean) + shift` of a task's channels.
#[derive(Default)]
struct Affine {
    scale: Vec<f32>,
    shift: Vec<f32>,
    mean: Vec<f32>,
}

/// The statistics of every sample's groups over valid frames, in two passes, so that a large mean
/// loses no digits.
pub fn statistics(x: Rows<'_>, plan: &GroupNormPlan, lengths: Option<&[usize]>) -> Statistics {
    let size = x.channels / plan.groups;
    let tasks = column_tasks(x.batch, x.channels, size);
    let parts: Vec<Vec<[f32; 2]>> = team::map(tasks.len(), |task| {
        let task = tasks[task];
        let x = x.first(frames_of(lengths, task.sample, x.time));
        let count = (size * x.time) as f64;
        let over_groups = |sums: &[f32]| -> Vec<f64> {
            sums.chunks(size)
                .map(|sums| sums.iter().map(|&s| f64::from(s)).sum::<f64>() / count)
                .collect()
        };
        let mut sums = vec![0.0; task.channels];
        channel_sums(x, task, &mut sums, None);
        let means = over_groups(&sums);
        let spread: Vec<f32> = (0..task.channels).map(|c| means[c / size] as f32).collect();
        sums.fill(0.0);
        channel_sums(x, task, &mut sums, Some(&spread));
        let variances = over_groups(&sums);
        means
            .iter()
            .zip(variances)
            .map(|(mean, variance)| [*mean as f32, (variance + plan.eps).sqrt().recip() as f32])
            .collect()
    });
    Statistics(parts.concat())
}

/// Adds a task's channels, or their squared distances from `means`, over time to `sums`.
fn channel_sums(x: Rows<'_>, task: ColumnTask, sums: &mut [f32], means: Option<&[f32]>) {
    vectorized(
        #[inline(always)]
        || {
            for time in 0..x.time {
                let row = &x.row(task.sample, time)[task.first..][..task.channels];
                match means {
                    None => {
                        for (sum, x) in sums.iter_mut().zip(row) {
                            *sum += x;
                        }
                    }
                    Some(means) => {
                        for ((sum, x), mean) in sums.iter_mut().zip(row).zip(means) {
                            let distance = x - mean;
                            *sum += distance * distance;
                        }
                    }
                }
            }
        },
    );
}

/// The affine map of each of a task's channels.
fn affine(task: ColumnTask, channels: usize, norm: &Norm<'_>) -> Affine {
    let groups = norm.plan.groups;
    let size = channels / groups;
    let mut affine = Affine::default();
    for channel in task.first..task.first + task.channels {
        let [mean, reciprocal] = norm.statistics.0[task.sample * groups + channel / size];
        let scale = reciprocal * norm.weight[channel];
        let shift = norm.bias[channel];
        let (film_scale, film_shift) = film(task.sample, channel, channels, norm.film);
        affine.scale.push(scale * film_scale);
        affine.shift.push(shift * film_scale + film_shift);
        affine.mean.push(mean);
    }
    affine
}

/// Factor and shift of FiLM; 1 and 0 without FiLM.
fn film(sample: usize, channel: usize, channels: usize, film: Option<&[f32]>) -> (f32, f32) {
    match film {
        Some(film) => {
            let of_sample = &film[sample * 2 * channels..][..2 * channels];
            (1.0 + of_sample[channel], of_sample[channels + channel])
        }
        None => (1.0, 0.0),
    }
}

/// Writes every element of the normalized rows to `output`.
pub(crate) fn forward(x: Rows<'_>, norm: &Norm<'_>, output: SharedRows<'_, MaybeUninit<f32>>) {
    let tasks = column_tasks(x.batch, x.channels, x.channels / norm.plan.groups);
    team::for_each(tasks.len(), |task| {
        let task = tasks[task];
        let affine = affine(task, x.channels, norm);
        with_activation!(norm.plan.activation, |activation| vectorized(
            #[inline(always)]
            || {
                let frames = frames_of(norm.lengths, task.sample, x.time);
                let valid = x.first(frames);
                forward_task(valid, task, &affine, norm.mask, output, activation);
                for time in frames..x.time {
                    // SAFETY: a task owns its columns of its sample, and this is its only slice of
                    // them.
                    #[allow(unsafe_code)]
                    let out =
                        unsafe { output.segment(task.sample, time, task.first, task.channels) };
                    out.fill(MaybeUninit::new(0.0));
                }
            }
        ));
    });
}

#[inline(always)]
fn forward_task(
    x: Rows<'_>,
    task: ColumnTask,
    affine: &Affine,
    mask: Option<Rows<'_>>,
    output: SharedRows<'_, MaybeUninit<f32>>,
    activation: impl Pointwise,
) {
    for time in 0..x.time {
        let row = &x.row(task.sample, time)[task.first..][..task.channels];
        // SAFETY: a task owns its columns of its sample, and this is its only slice of them.
        #[allow(unsafe_code)]
        let out = unsafe { output.segment(task.sample, time, task.first, task.channels) };
        let maps = affine.scale.iter().zip(&affine.shift).zip(&affine.mean);
        let values = row.iter().zip(maps).map(
            #[inline(always)]
            |(x, ((scale, shift), mean))| activation.value((x - mean) * scale + shift),
        );
        match mask {
            Some(mask) => {
                let mask = &mask.row(task.sample, time)[task.first..][..task.channels];
                for ((out, value), mask) in out.iter_mut().zip(values).zip(mask) {
                    out.write(value * mask);
                }
            }
            None => {
                for (out, value) in out.iter_mut().zip(values) {
                    out.write(value);
                }
            }
        }
    }
}

/// Replaces the dense `gradient` of the output with the gradient of `x`, and returns the
/// parameters' gradients.
///
/// With `u` the affine part and `n` the normalized values, the sums `s1 = sum du` and `s2 = sum du
/// n` over a channel's time give the parameters' gradients. Their sums over a group give the two
/// means that are subtracted from the input's gradient.
pub(crate) fn backward(x: Rows<'_>, norm: &Norm<'_>, gradient: &mut [f32]) -> NormGradients {
    let channels = x.channels;
    let tasks = column_tasks(x.batch, channels, channels / norm.plan.groups);
    let output = SharedRows::dense(gradient, x.shape());
    let sums: Vec<(ColumnTask, Vec<[f32; 2]>)> = team::map(tasks.len(), |task| {
        let task = tasks[task];
        let affine = affine(task, channels, norm);
        let frames = frames_of(norm.lengths, task.sample, x.time);
        for time in frames..x.time {
            // SAFETY: a task owns its columns of its sample, and this is its only slice of them.
            #[allow(unsafe_code)]
            unsafe { output.segment(task.sample, time, task.first, task.channels) }.fill(0.0);
        }
        let x = x.first(frames);
        let sums = with_activation!(norm.plan.activation, |activation| vectorized(
            #[inline(always)]
            || { backward_activation(x, task, &affine, norm.mask, output, activation) }
        ));
        let sums = backward_affine(x, task, norm, output, &sums);
        (task, sums)
    });

    let mut gradients = NormGradients {
        weight: vec![0.0; channels],
        bias: vec![0.0; channels],
        film: norm.film.map(|film| vec![0.0; film.len()]),
    };
    for (task, sums) in sums {
        for (i, [s1, s2]) in sums.into_iter().enumerate() {
            let channel = task.first + i;
            let (factor, _) = film(task.sample, channel, channels, norm.film);
            gradients.weight[channel] += factor * s2;
            gradients.bias[channel] += factor * s1;
            if let Some(film) = &mut gradients.film {
                let of_sample = &mut film[task.sample * 2 * channels..][..2 * channels];
                of_sample[channel] = norm.weight[channel] * s2 + norm.bias[channel] * s1;
                of_sample[channels + channel] = s1;
            }
        }
    }
    gradients
}

/// Backward through mask and activation: `gradient` becomes that of `u`. Returns `sum du` and
/// `sum du (x - mean)` of each channel.
#[inline(always)]
fn backward_activation(
    x: Rows<'_>,
    task: ColumnTask,
    affine: &Affine,
    mask: Option<Rows<'_>>,
    gradient: SharedRows<'_>,
    activation: impl Pointwise,
) -> [Vec<f32>; 2] {
    let mut sums = vec![0.0; task.channels];
    let mut products = vec![0.0; task.channels];
    for time in 0..x.time {
        let row = &x.row(task.sample, time)[task.first..][..task.channels];
        // SAFETY: a task owns its columns of its sample, and this is its only slice of them.
        #[allow(unsafe_code)]
        let gradient = unsafe { gradient.segment(task.sample, time, task.first, task.channels) };
        if let Some(mask) = mask {
            let mask = &mask.row(task.sample, time)[task.first..][..task.channels];
            for (gradient, mask) in gradient.iter_mut().zip(mask) {
                *gradient *= mask;
            }
        }
        let maps = affine.scale.iter().zip(&affine.shift).zip(&affine.mean);
        let sums = sums.iter_mut().zip(&mut products);
        for (((gradient, x), ((scale, shift), mean)), (sum, product)) in
            gradient.iter_mut().zip(row).zip(maps).zip(sums)
        {
            let distance = x - mean;
            let du = *gradient * activation.derivative(distance * scale + shift);
            *gradient = du;
            *sum += du;
            *product += du * distance;
        }
    }
    [sums, products]
}

/// Backward through FiLM, scale and normalization: the gradient of `u` becomes that of `x`. Returns
/// `s1` and `s2` of each channel.
fn backward_affine(
    x: Rows<'_>,
    task: ColumnTask,
    norm: &Norm<'_>,
    gradient: SharedRows<'_>,
    [sums, products]: &[Vec<f32>; 2],
) -> Vec<[f32; 2]> {
    let channels = x.channels;
    let size = channels / norm.plan.groups;
    let count = (size * x.time) as f64;
    let first_group = task.sample * norm.plan.groups + task.first / size;
    let statistics = &norm.statistics.0[first_group..];
    let moments: Vec<[f32; 2]> = (0..task.channels)
        .map(|i| {
            let [_, reciprocal] = statistics[i / size];
            [sums[i], products[i] * reciprocal]
        })
        .collect();
    let factor = |i: usize| {
        let channel = task.first + i;
        f64::from(norm.weight[channel])
            * f64::from(film(task.sample, channel, channels, norm.film).0)
    };
    // dx = reciprocal (factor du - mean1 - n mean2), as a map of du and x - mean.
    let [mut of_du, mut of_distance, mut constants, mut centers] =
        [(); 4].map(|()| Vec::with_capacity(task.channels));
    for (group, moments) in moments.chunks(size).enumerate() {
        let mut means = [0.0_f64; 2];
        for (i, moments) in moments.iter().enumerate() {
            for (mean, moment) in means.iter_mut().zip(moments) {
                *mean += factor(group * size + i) * f64::from(*moment) / count;
            }
        }
        let [mean, reciprocal] = statistics[group].map(f64::from);
        let slope = -reciprocal * reciprocal * means[1];
        let constant = -reciprocal * means[0];
        for i in 0..size {
            of_du.push((reciprocal * factor(group * size + i)) as f32);
            of_distance.push(slope as f32);
            constants.push(constant as f32);
            centers.push(mean as f32);
        }
    }
    vectorized(
        #[inline(always)]
        || {
            for time in 0..x.time {
                let row = &x.row(task.sample, time)[task.first..][..task.channels];
                // SAFETY: a task owns its columns of its sample; this is its only slice of them
                // now.
                #[allow(unsafe_code)]
                let gradient =
                    unsafe { gradient.segment(task.sample, time, task.first, task.channels) };
                let slopes = of_du.iter().zip(&of_distance);
                let maps = slopes.zip(constants.iter().zip(&centers));
                for ((gradient, x), ((du, slope), (constant, center))) in
                    gradient.iter_mut().zip(row).zip(maps)
                {
                    *gradient = *gradient * du + (x - center) * slope + constant;
                }
            }
        },
    );
    moments
}
