//! The network's prediction for noised clips.

use std::sync::Arc;

use burn::tensor::{Tensor, TensorData};
use kinegrad_data::humanml::Clip;
use kinegrad_diffusion::{ClipRange, Prediction, Space as _, Time, guided};
use kinegrad_motion::humanml::Features;
use kinegrad_random::{Key, Purpose};
use kinegrad_settings::in_range;
use kinegrad_train::Error;
use kinegrad_train::clips::captions::ClipText;
use kinegrad_train::sampling::item_seed;

use super::ClipGenerator;
use crate::recipe_name::RecipeName;

impl ClipGenerator {
    /// A motion model's one-step prediction of each clip, noised to `timestep`: a measure of
    /// accuracy at the end of sampling. Clips are cut to the training length. A clip's noise
    /// depends on `seed` and the clip's id.
    ///
    /// # Errors
    /// [`Error::Usage`] for a trajectory model or an unknown caption; [`Error::SampleNotFinite`];
    /// an error if the process has no such timestep.
    pub fn predict_once(
        &self,
        clips: &[Arc<Clip>],
        timestep: usize,
        guidance_scale: f64,
        seed: u64,
    ) -> Result<Vec<Features>, Error> {
        if RecipeName::of(self.config()) != RecipeName::Motion {
            return Err(Error::usage(
                format!("`{}` predicts paths", self.config().run.name),
                "name a run of recipe `gmd_motion`",
            ));
        }
        let last = self.diffusion.config.num_train_timesteps - 1;
        in_range("timestep", timestep, 0..=last)?;
        let (batch, channels) = (clips.len(), self.channels);
        let humanml3d = &self.config().data.humanml3d;
        let frames = self.config().data.target_frames;
        let on_device = |values: Vec<f32>, shape: [usize; 3]| {
            Tensor::<3>::from_data(TensorData::new(values, shape), &self.device)
        };
        let (mut starts, mut noise, mut texts) = (Vec::new(), Vec::new(), Vec::new());
        for clip in clips {
            let length = clip.features.frames().min(frames);
            let rows = clip.features.with_root(humanml3d.root);
            let rows = rows.as_slice()[..length * channels].to_vec();
            let motion = on_device(rows, [1, length, channels]).swap_dims(1, 2);
            let known = self.space.to_network(motion);
            let padding = Tensor::zeros([1, channels, frames - length], &self.device);
            starts.push(Tensor::cat(vec![known, padding], 2));
            let key = Key::new(item_seed(seed, &clip.id), Purpose::Noise);
            noise.extend(key.normals(channels * frames));
            texts.extend(self.text.values_or_zeros(ClipText::of(clip).as_ref())?);
        }
        let noise = on_device(noise, [batch, channels, frames]);
        let cond = on_device(texts, [batch, self.text.channels(), 1]);
        let timesteps = vec![timestep; batch];
        let x_start = Tensor::cat(starts, 0);
        let x_t = self.diffusion.add_noise(x_start, noise, &timesteps);
        let time = Time::of(&timesteps);
        let output = guided(&self.plain, x_t.clone(), &time, &cond, guidance_scale);
        let range = ClipRange::None;
        let prediction = Prediction::new(&self.diffusion, output, x_t, &timesteps, &range)?;
        let predicted = self.features(prediction.x_start)?;
        let cut = predicted.iter().zip(clips);
        let cut = cut.map(|(features, clip)| features.slice(0..clip.features.frames().min(frames)));
        Ok(cut.collect())
    }
}
