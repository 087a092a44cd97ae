//! The interface between a diffusion process and a network, and classifier-free guidance.

use burn::tensor::Tensor;

use crate::Time;

/// A network that makes a prediction for a noisy motion. The process's `prediction_type` names the
/// predicted quantity.
pub trait Denoiser {
    /// The condition, for the whole batch: audio features `[batch, channels, time]`, a text
    /// embedding, or nothing.
    type Cond;

    /// The prediction at these noise levels, one per sample.
    ///
    /// # Shapes
    /// - x_t, output: `[batch, channels, time]`
    fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &Self::Cond) -> Tensor<3>;

    /// The null condition of training, in the shape of `cond`.
    fn null_cond(&self, cond: &Self::Cond) -> Self::Cond;

    /// `cond` without its style, for networks whose style can have its own guidance scale. The null
    /// condition has no style either.
    fn null_style(&self, _cond: &Self::Cond) -> Option<Self::Cond> {
        None
    }
}

/// Guidance scales of the conditions; 1 disables guidance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuidanceScales {
    /// Scale of the condition without its style.
    pub cond: f64,
    /// Scale of the style.
    pub style: f64,
}

impl GuidanceScales {
    /// Scales of the condition and of the style; `None` uses `cond` for the style.
    pub fn new(cond: f64, style: Option<f64>) -> Self {
        Self {
            cond,
            style: style.unwrap_or(cond),
        }
    }

    /// Maximum number of network calls for one prediction.
    pub fn calls(&self) -> u64 {
        match (self.cond == self.style, self.cond == 1.0) {
            (true, true) => 1,
            (true, false) | (false, true) => 2,
            (false, false) => 3,
        }
    }
}

impl From<f64> for GuidanceScales {
    /// One scale for all conditions.
    fn from(scale: f64) -> Self {
        Self::new(scale, None)
    }
}

/// The prediction under classifier-free guidance (CC-MotionGen, section 8.3; docs/sources.md,
/// section 1.9; Ho and Salimans 2022, <https://arxiv.org/abs/2207.12598>, equation 6):
/// `uncond + guidance_scale (cond - uncond)`.
///
/// A scale of 1 is the conditional prediction, a scale of 0 the unconditional one. Scales of 0 and
/// 1 call the network once, other scales twice.
///
/// The outputs are combined before any conversion. The result is the same for every prediction
/// type: for a fixed `x_t`, noise, clean motion and velocity are affine in each other, and the
/// factors `1 - scale` and `scale` add up to 1. Clipping must follow the guidance.
///
/// If the style has a different scale, condition and style are composed as in InstructPix2Pix
/// (Brooks et al. 2023, <https://arxiv.org/abs/2211.09800>, equation 3):
///
/// ```text
/// uncond + scales.cond (unstyled - uncond) + scales.style (cond - unstyled)
/// ```
///
/// # Shapes
/// - x_t, output: `[batch, channels, time]`
pub fn guided<D: Denoiser + ?Sized>(
    denoiser: &D,
    x_t: Tensor<3>,
    time: &[Time],
    cond: &D::Cond,
    scales: impl Into<GuidanceScales>,
) -> Tensor<3> {
    let scales = scales.into();
    let guidance_scale = scales.cond;
    if scales.style != guidance_scale
        && let Some(unstyled_cond) = denoiser.null_style(cond)
    {
        let unstyled = denoiser.predict(x_t.clone(), time, &unstyled_cond);
        let followed = if guidance_scale == 1.0 {
            unstyled.clone()
        } else {
            let null = denoiser.null_cond(cond);
            let uncond = denoiser.predict(x_t.clone(), time, &null);
            uncond.clone() + (unstyled.clone() - uncond) * guidance_scale
        };
        if scales.style == 0.0 {
            return followed;
        }
        let styled = denoiser.predict(x_t, time, cond);
        return followed + (styled - unstyled) * scales.style;
    }
    if guidance_scale == 1.0 {
        return denoiser.predict(x_t, time, cond);
    }
    let uncond = denoiser.predict(x_t.clone(), time, &denoiser.null_cond(cond));
    if guidance_scale == 0.0 {
        return uncond;
    }
    let cond = denoiser.predict(x_t, time, cond);
    uncond.clone() + (cond - uncond) * guidance_scale
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use burn::tensor::{Device, TensorData};
    use kinegrad_random::{Key, Purpose};

    use super::*;
    use crate::{DiffusionConfig, GaussianDiffusion, PredictionType};

    /// Predicts `x_t cond + t` and counts its calls.
    struct Scale(Cell<usize>);

    impl Denoiser for Scale {
        type Cond = f64;

        fn predict(&self, x_t: Tensor<3>, time: &[Time], cond: &f64) -> Tensor<3> {
            self.0.set(self.0.get() + 1);
            x_t * *cond + time[0].0
        }

        fn null_cond(&self, _: &f64) -> f64 {
            0.0
        }
    }

    fn ones() -> Tensor<3> {
        Tensor::ones([1, 2, 3], &Device::flex())
    }

    #[test]
    fn guidance_extrapolates_from_the_null_condition() {
        // uncond = 7, cond = 2 + 7: 7 + scale 2.
        for (scale, expected, calls) in [(1.0, 9.0, 1), (0.0, 7.0, 1), (3.0, 13.0, 2)] {
            let network = Scale(Cell::new(0));
            let found = guided(&network, ones(), &[Time(7.0)], &2.0, scale);
            assert_eq!(
                found.into_data().try_to_vec::<f32>().unwrap(),
                [expected; 6]
            );
            assert_eq!(network.0.get(), calls, "calls at scale {scale}");
        }
    }

    /// Predicts `audio + 10 style`, null being 0 for both, and counts its calls.
    struct Styled(Cell<usize>);

    impl Denoiser for Styled {
        type Cond = (f64, Option<f64>);

        fn predict(&self, x_t: Tensor<3>, _: &[Time], cond: &Self::Cond) -> Tensor<3> {
            self.0.set(self.0.get() + 1);
            // The effect of the style depends on the audio, so the order of the terms matters.
            let (audio, style) = (cond.0, cond.1.unwrap_or(0.0));
            x_t * 0.0 + (audio + 10.0 * style + audio * style)
        }

        fn null_cond(&self, _: &Self::Cond) -> Self::Cond {
            (0.0, None)
        }

        fn null_style(&self, cond: &Self::Cond) -> Option<Self::Cond> {
            cond.1.map(|_| (cond.0, None))
        }
    }

    #[test]
    fn conditions_with_scales_of_their_own_are_composed() {
        // The predictions are 0 (null), 2 (audio) and 2 + 30 + 6 = 38 (audio and style).
        let cond = (2.0, Some(3.0));
        for (scales, expected, calls) in [
            ((1.0, Some(2.0)), 2.0 + 2.0 * 36.0, 2),
            ((3.0, Some(2.0)), 3.0 * 2.0 + 2.0 * 36.0, 3),
            ((3.0, Some(0.0)), 3.0 * 2.0, 2),
            ((0.0, Some(2.0)), 2.0 * 36.0, 3),
            ((3.0, Some(3.0)), 3.0 * 38.0, 2),
            ((3.0, None), 3.0 * 38.0, 2),
            ((1.0, None), 38.0, 1),
        ] {
            let network = Styled(Cell::new(0));
            let scales = GuidanceScales::new(scales.0, scales.1);
            let found = guided(&network, ones(), &[Time(7.0)], &cond, scales);
            assert_eq!(
                found.into_data().try_to_vec::<f32>().unwrap(),
                [expected as f32; 6],
                "{scales:?}"
            );
            assert_eq!(network.0.get(), calls, "calls at {scales:?}");
            assert!(calls as u64 <= scales.calls());
        }
        // A condition without style uses only the condition's scale.
        let network = Styled(Cell::new(0));
        let scales = GuidanceScales::new(3.0, Some(7.0));
        let found = guided(&network, ones(), &[Time(7.0)], &(2.0, None), scales);
        assert_eq!(found.into_data().try_to_vec::<f32>().unwrap(), [6.0; 6]);
        assert_eq!(network.0.get(), 2);
    }

    #[test]
    fn mixing_before_or_after_a_conversion_is_the_same() {
        let process = GaussianDiffusion::new(&DiffusionConfig::default()).unwrap();
        let normal = |seed| {
            let values = Key::new(seed, Purpose::Noise).normals(15);
            Tensor::<3>::from_data(TensorData::new(values, [1, 3, 5]), &Device::flex())
        };
        let (uncond, cond, x_t) = (normal(1), normal(2), normal(3));
        let mix = |u: Tensor<3>, c: Tensor<3>| u.clone() + (c - u) * 2.5;
        let (from, to) = (PredictionType::Epsilon, PredictionType::VPrediction);
        let convert = |x: Tensor<3>| process.convert(x, x_t.clone(), &[400], from, to);
        let before = convert(mix(uncond.clone(), cond.clone()));
        let after = mix(convert(uncond), convert(cond));
        let error: f32 = (before - after).abs().max().into_scalar();
        assert!(error < 1e-5, "{error}");
    }
}
