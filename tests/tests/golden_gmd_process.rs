//! The steered diffusion process of Guided Motion Diffusion against the golden files of `gmd`, with
//! their toy denoiser.

use burn::tensor::{Device, Tensor};
use kinegrad_diffusion::{
    BetaSchedule, Clip, Denoiser, DiffusionConfig, GaussianDiffusion, Goal, Guidance, Imputation,
    Networks, PredictionType, SamplerConfig, Space, SteeredInput, SteeredOutput, Steering,
    TimestepSpacing, steered_step, timesteps,
};
use kinegrad_motion::emphasis::EmphasisProjection;
use kinegrad_motion::goal::{
    Goal as RootGoal, GuidanceConfig, GuidanceLoss, GuidanceNorm, Keyframe, Obstacle,
};
use kinegrad_tests::golden::{Golden, GoldenTensors, Reference, ReferenceTensors};
use kinegrad_train::clips::{FeatureSpace, GroundGoal};
use kinegrad_train::recipes::clips::weighted_masked_mse;

fn process(prediction_type: PredictionType) -> GaussianDiffusion {
    GaussianDiffusion::new(&DiffusionConfig {
        beta_schedule: BetaSchedule::Cosine,
        beta_min: 0.0,
        beta_max: 0.999,
        prediction_type,
        ..DiffusionConfig::default()
    })
    .expect("a valid process")
}

/// `s tanh(W x + v t / 1000)` of every frame.
struct Toy {
    w: Tensor<3>,
    v: Tensor<3>,
    s: f64,
}

impl Toy {
    fn read(golden: &Golden, prefix: &str, device: &Device) -> Self {
        let w = golden.tensor::<2>(&format!("{prefix}W"), device);
        let v = golden.tensor::<1>(&format!("{prefix}v"), device);
        Self {
            w: w.unsqueeze(),
            v: v.unsqueeze::<2>().unsqueeze_dim(2),
            s: golden.get(&format!("{prefix}s")).scalar(),
        }
    }
}

impl Denoiser for Toy {
    type Cond = Tensor<3>;

    fn predict(&self, x_t: Tensor<3>, timesteps: &[usize], _: &Tensor<3>) -> Tensor<3> {
        let t = timesteps[0] as f64 / 1000.0;
        (self.w.clone().matmul(x_t) + self.v.clone() * t).tanh() * self.s
    }

    fn null_cond(&self, cond: &Tensor<3>) -> Tensor<3> {
        cond.clone()
    }
}

/// A toy denoiser on both devices and what it works on.
struct Bench {
    golden: Golden,
    device: Device,
    tracked: Toy,
    plain: Toy,
    diffusion: GaussianDiffusion,
    clip: Clip,
}

impl Bench {
    fn new(golden: Golden, prefix: &str, prediction_type: PredictionType) -> Self {
        let device = Device::flex();
        Self {
            tracked: Toy::read(&golden, prefix, &device.clone().autodiff()),
            plain: Toy::read(&golden, prefix, &device),
            diffusion: process(prediction_type),
            clip: match prediction_type {
                PredictionType::Sample => Clip::None,
                _ => Clip::Symmetric(6.0),
            },
            golden,
            device,
        }
    }

    fn input(&self, name: &str) -> Tensor<3> {
        self.golden.get(name).flat().tensor(&self.device)
    }

    fn timesteps(&self) -> Vec<usize> {
        self.golden.get("in.timesteps").indices()
    }

    /// Part `index` of the leading axis.
    fn part(&self, name: &str, index: usize) -> Reference {
        self.golden.get(name).part(index).flat()
    }

    fn step(
        &self,
        x_t: Tensor<3>,
        timestep: usize,
        noise: Option<Tensor<3>>,
        imputation_noise: Option<Tensor<3>>,
        steering: &Steering<'_>,
    ) -> SteeredOutput {
        let input = SteeredInput {
            prev_timestep: timestep.checked_sub(1),
            guidance_scale: 1.0,
            // No noise is added at timestep 0.
            noise: noise.filter(|_| timestep > 0),
            imputation_noise,
            timestep,
            x_t: x_t.clone(),
        };
        let networks = Networks {
            tracked: &self.tracked,
            plain: &self.plain,
        };
        steered_step(&self.diffusion, networks, input, &x_t, &self.clip, steering)
            .expect("sizes fit")
    }
}

/// The first `channels` statistics of a file, and its projection where the network has one.
fn space(golden: &Golden, channels: usize, projected: bool, device: &Device) -> FeatureSpace {
    let numbers = |name: &str| golden.get(name).values[..channels].to_vec();
    let projection = projected.then(|| {
        let matrix = golden.get("in.P").f32s();
        EmphasisProjection::from_matrix(&matrix, channels, 10.0, &[0, 1, 2]).expect("a projection")
    });
    let (mean, std) = (numbers("in.mean"), numbers("in.std"));
    FeatureSpace::new(&mean, &std, projection.as_ref(), device)
}

#[test]
fn golden_gmd_schedule() {
    let Some(golden) = Golden::open("gmd", "schedule_cosine1000.safetensors") else {
        return;
    };
    let schedule = process(PredictionType::Sample).schedule;
    let same = |name: &str, values: &[f64]| {
        let reference = golden.get(name);
        assert_eq!(reference.values.len(), values.len(), "{name}");
        let mut worst = 0.0f64;
        for (found, expected) in values.iter().zip(&reference.values) {
            let error = (found - expected).abs() / expected.abs().max(1e-300);
            worst = worst.max(if expected == &0.0 { found.abs() } else { error });
        }
        println!("{name}: {worst:.1e} of 1e-12");
        assert!(worst <= 1e-12, "{name}: {worst:e}");
    };
    same("out.betas_initial", &schedule.betas);
    same("out.alphas_cumprod", &schedule.alphas_cumprod);
    same("out.alphas_cumprod_prev", &schedule.alphas_cumprod_prev);
    same("out.sqrt_alphas_cumprod", &schedule.sqrt_alphas_cumprod);
    same(
        "out.sqrt_recip_alphas_cumprod",
        &schedule.sqrt_recip_alphas_cumprod,
    );
    same("out.posterior_mean_coef1", &schedule.posterior_mean_coef1);
    same("out.posterior_mean_coef2", &schedule.posterior_mean_coef2);
    same("out.posterior_variance", &schedule.posterior_variance);
    // Equations 1 and 2 of the appendix.
    let (a, b) = (
        &schedule.posterior_mean_coef1,
        &schedule.posterior_mean_coef2,
    );
    same("out.coef_a_x0", a);
    same("out.coef_b_xt", b);
    let of_both = |value: &dyn Fn(usize) -> f64| (0..a.len()).map(value).collect::<Vec<f64>>();
    let (root, noise) = (
        &schedule.sqrt_alphas_cumprod,
        &schedule.sqrt_one_minus_alphas_cumprod,
    );
    same("out.coef_c_eps_xt", &of_both(&|t| a[t] / root[t] + b[t]));
    same("out.coef_d_eps", &of_both(&|t| a[t] * noise[t] / root[t]));

    let respaced = SamplerConfig {
        num_inference_steps: golden.get("out.ddim100_timestep_map").values.len(),
        timestep_spacing: TimestepSpacing::Leading,
        ..SamplerConfig::default()
    };
    let mut kept = timesteps(&respaced, a.len());
    kept.reverse();
    assert_eq!(kept, golden.get("out.ddim100_timestep_map").indices());
    let kept: Vec<f64> = kept.iter().map(|&t| schedule.alphas_cumprod[t]).collect();
    same("out.ddim100_alphas_cumprod", &kept);
}

#[test]
fn golden_gmd_p_sample() {
    for (kind, prediction_type) in [
        ("x0", PredictionType::Sample),
        ("eps", PredictionType::Epsilon),
    ] {
        let Some(golden) = Golden::open("gmd", "p_sample.safetensors") else {
            return;
        };
        let timesteps = golden.get("in.timesteps").indices();
        let bench = Bench::new(golden, "model.", prediction_type);
        let none = Steering::default();
        for (index, &timestep) in timesteps.iter().enumerate() {
            let at = |name: &str| bench.part(&format!("out.{kind}.{name}"), index);
            let noise = Some(bench.part("in.noise", index).tensor(&bench.device));
            let x_t = bench.input("in.x_t");
            let step = bench.step(x_t.clone(), timestep, noise, None, &none);
            at("sample").assert_within("sample", step.prev_sample, 1e-5, 0.0);
            let x_start = step.pred_original_sample;
            at("pred_xstart").assert_within("pred_xstart", x_start, 1e-5, 0.0);
            let mean = bench.step(x_t, timestep, None, None, &none).prev_sample;
            at("mean").assert_within("mean", mean, 1e-5, 0.0);
        }
        let mut x = bench.input("in.x_t");
        for (index, timestep) in (0..6).rev().enumerate() {
            let noise = bench.part(&format!("in.{kind}.loop_noise"), index);
            let noise = Some(noise.tensor(&bench.device));
            x = bench.step(x, timestep, noise, None, &none).prev_sample;
            let expected = bench.part(&format!("out.{kind}.loop"), index);
            expected.assert_within("loop", x.clone(), 1e-5, 0.0);
        }
    }
}

/// The goals of the file, one for each sample; with its obstacles where they count.
fn goals(golden: &Golden, obstacles: bool) -> Vec<RootGoal> {
    let (mask, target) = (golden.get("in.target_mask"), golden.get("in.target_xz"));
    let [batch, frames] = mask.shape[..] else {
        panic!("a mask for each sample and frame");
    };
    let discs = golden.get("in.obstacles");
    (0..batch)
        .map(|sample| {
            let mut goal = RootGoal::new(frames);
            goal.keyframes = (0..frames)
                .filter(|frame| mask.values[sample * frames + frame] != 0.0)
                .map(|frame| {
                    let place = 2 * (sample * frames + frame);
                    Keyframe {
                        frame,
                        x: target.values[place],
                        z: target.values[place + 1],
                    }
                })
                .collect();
            if obstacles {
                goal.obstacles = discs
                    .values
                    .chunks(3)
                    .map(|disc| Obstacle::Disc {
                        x: disc[0],
                        z: disc[1],
                        radius: disc[2],
                    })
                    .collect();
            }
            goal
        })
        .collect()
}

#[test]
fn golden_gmd_guidance() {
    for (kind, prediction_type) in [
        ("traj", PredictionType::Epsilon),
        ("motion", PredictionType::Sample),
    ] {
        let Some(golden) = Golden::open("gmd", "guidance.safetensors") else {
            return;
        };
        let bench = Bench::new(golden, &format!("model.{kind}."), prediction_type);
        let golden = &bench.golden;
        let x_t = bench.input(&format!("in.{kind}.x_t"));
        let [_, channels, frames] = x_t.dims();
        let space = space(golden, channels, kind == "motion", &bench.device);
        // The inverse projection has a condition number of some hundreds.
        let (absolute, relative) = match kind {
            "motion" => (1e-4, 1e-3),
            _ => (1e-4, 1e-4),
        };
        let timesteps = golden.get("in.timesteps").indices();
        for variant in ["l1", "mse", "sdf_l1"] {
            let gradient_name = format!("out.{kind}.{variant}.scaled_grad");
            if !golden.has(&gradient_name) {
                continue;
            }
            let config = GuidanceConfig {
                norm: match variant {
                    "mse" => GuidanceNorm::Mse,
                    _ => GuidanceNorm::L1,
                },
                frame_limit: None,
            };
            let goals = goals(golden, variant == "sdf_l1");
            let loss = GuidanceLoss::new(&config, &goals, frames).expect("goals");
            let goal = GroundGoal {
                space: &space,
                loss: &loss,
            };
            for (index, &timestep) in timesteps.iter().enumerate() {
                let steering = Steering {
                    guidance: Some(Guidance {
                        goal: &goal as &dyn Goal,
                        scale: 100.0,
                    }),
                    imputation: None,
                };
                let none = Steering::default();
                let step = |steering| bench.step(x_t.clone(), timestep, None, None, steering);
                bench
                    .part(&format!("out.{kind}.unguided_mean"), index)
                    .assert_within("unguided mean", step(&none).prev_sample, 1e-4, 1e-4);
                // Guidance acts while t >= 20 alone; the file's obstacles act always.
                let acts = timestep >= 20 || variant == "sdf_l1";
                let steering = if acts { &steering } else { &none };
                let led = step(steering);
                let what = |of: &str| format!("{kind} {variant} {of} at {timestep}");
                let scaled_gradient = led.scaled_gradient.unwrap_or_else(|| x_t.zeros_like());
                bench.part(&gradient_name, index).assert_within(
                    &what("scaled gradient"),
                    scaled_gradient,
                    absolute,
                    relative,
                );
                let mean_name = format!("out.{kind}.{variant}.mean");
                if golden.has(&mean_name) {
                    bench.part(&mean_name, index).assert_within(
                        &what("mean"),
                        led.prev_sample,
                        absolute,
                        relative,
                    );
                }
                let sample_name = format!("out.{kind}.{variant}.sample");
                if golden.has(&sample_name) {
                    let noise = bench.part(&format!("in.{kind}.noise"), index);
                    let noise = Some(noise.tensor(&bench.device));
                    let step = bench.step(x_t.clone(), timestep, noise, None, steering);
                    bench.part(&sample_name, index).assert_within(
                        &what("sample"),
                        step.prev_sample,
                        absolute,
                        relative,
                    );
                }
            }
        }
    }
}

fn imputation<'a>(
    bench: &Bench,
    space: &'a FeatureSpace,
    target: Tensor<3>,
    mask: &str,
) -> Imputation<'a> {
    Imputation {
        space,
        target,
        mask: bench.input(mask),
    }
}

#[test]
fn golden_gmd_imputation_of_motion() {
    for variant in ["plain", "proj"] {
        let Some(golden) = Golden::open("gmd", "imputation.safetensors") else {
            return;
        };
        let bench = Bench::new(golden, "model.motion.", PredictionType::Sample);
        let x_t = bench.input("in.motion.x_t");
        let channels = x_t.dims()[1];
        let space = space(&bench.golden, channels, variant == "proj", &bench.device);
        let target = bench.input("in.motion.target");
        for (index, &timestep) in bench.timesteps().iter().enumerate() {
            let known = || imputation(&bench, &space, target.clone(), "in.motion.mask");
            let steering = Steering {
                guidance: None,
                imputation: (timestep >= 20).then(known),
            };
            let at = |name: &str| bench.part(&format!("out.motion.{variant}.{name}"), index);
            let noise = bench.part("in.motion.noise", index);
            let noise = Some(noise.tensor(&bench.device));
            let step = bench.step(x_t.clone(), timestep, noise, None, &steering);
            let what = format!("{variant} at {timestep}");
            at("sample").assert_within(&what, step.prev_sample, 1e-4, 0.0);
            let x_start = step.pred_original_sample;
            at("pred_xstart").assert_within("prediction", x_start, 1e-4, 0.0);
            let step = bench.step(x_t.clone(), timestep, None, None, &steering);
            let mean = step.prev_sample;
            at("mean").assert_within("mean", mean, 1e-4, 0.0);
        }
    }
}

#[test]
fn golden_gmd_imputation_of_trajectories() {
    let Some(golden) = Golden::open("gmd", "imputation.safetensors") else {
        return;
    };
    let bench = Bench::new(golden, "model.traj.", PredictionType::Epsilon);
    let x_t = bench.input("in.traj.x_t");
    let space = space(&bench.golden, x_t.dims()[1], false, &bench.device);
    let target = space.to_motion(bench.input("in.traj.target_model_space"));
    for (index, &timestep) in bench.timesteps().iter().enumerate() {
        let mask = match timestep {
            100.. => Some("in.traj.mask_dense"),
            20..100 => Some("in.traj.mask_points"),
            _ => None,
        };
        let steering = Steering {
            guidance: None,
            imputation: mask.map(|mask| imputation(&bench, &space, target.clone(), mask)),
        };
        let part = |name: &str| Some(bench.part(name, index).tensor(&bench.device));
        let (noise, noise_q) = (part("in.traj.noise"), part("in.traj.noise_q"));
        let step = bench.step(x_t.clone(), timestep, noise, noise_q, &steering);
        let (sample, x_start) = (step.prev_sample, step.pred_original_sample);
        bench.part("out.traj.sample", index).assert_within(
            &format!("sample at {timestep}"),
            sample,
            1e-4,
            0.0,
        );
        bench
            .part("out.traj.pred_xstart", index)
            .assert_within("prediction", x_start, 1e-4, 0.0);
    }
}

/// The goals that values in metres `[batch, channels, frames]` state where the mask is 1.
fn goals_of(target: &Tensor<3>, mask: &Reference) -> Vec<RootGoal> {
    let [batch, channels, frames] = target.dims();
    let target = target
        .clone()
        .try_into_vec_as::<f32>()
        .expect("a float32 tensor");
    let [_, masked, _] = mask.shape[..] else {
        panic!("a mask of three axes");
    };
    (0..batch)
        .map(|sample| {
            let mut goal = RootGoal::new(frames);
            let at = |channel: usize, frame: usize| {
                f64::from(target[(sample * channels + channel) * frames + frame])
            };
            goal.keyframes = (0..frames)
                .filter(|frame| mask.values[(sample * masked + 1) * frames + frame] != 0.0)
                .map(|frame| Keyframe {
                    frame,
                    x: at(1, frame),
                    z: at(2, frame),
                })
                .collect();
            goal
        })
        .collect()
}

#[test]
fn golden_gmd_guided_imputation() {
    for (kind, prediction_type) in [
        ("traj", PredictionType::Epsilon),
        ("motion", PredictionType::Sample),
    ] {
        let Some(golden) = Golden::open("gmd", "guided_imputation.safetensors") else {
            return;
        };
        let bench = Bench::new(golden, &format!("model.{kind}."), prediction_type);
        let x_t = bench.input(&format!("in.{kind}.x_t"));
        let [batch, channels, frames] = x_t.dims();
        let space = space(&bench.golden, channels, kind == "motion", &bench.device);
        let target = match kind {
            "traj" => space.to_motion(bench.input("in.traj.target_model_space")),
            _ => bench.input("in.motion.target"),
        };
        let points = bench.golden.get("in.mask_points").flat();
        let goals = goals_of(&target, &points);
        let loss = GuidanceLoss::new(&GuidanceConfig::default(), &goals, frames).expect("goals");
        let goal = GroundGoal {
            space: &space,
            loss: &loss,
        };
        // The masks are of the trajectory's channels; the motion's others are free.
        let mask = |name: &str| {
            let mask = bench.input(name);
            let free = channels - mask.dims()[1];
            match free {
                0 => mask,
                _ => {
                    let zeros = Tensor::zeros([batch, free, frames], &bench.device);
                    Tensor::cat(vec![mask, zeros], 1)
                }
            }
        };
        for (index, &timestep) in bench.timesteps().iter().enumerate() {
            // The motion model has the key points alone in this file.
            let name = match (kind, timestep) {
                ("traj", 100..) => "in.mask_dense",
                _ => "in.mask_points",
            };
            let steering = match timestep {
                20.. => Steering {
                    guidance: Some(Guidance {
                        goal: &goal,
                        scale: 100.0,
                    }),
                    imputation: Some(Imputation {
                        space: &space,
                        target: target.clone(),
                        mask: mask(name),
                    }),
                },
                _ => Steering::default(),
            };
            let part = |name: String| {
                let noise = bench.golden.has(&name).then(|| bench.part(&name, index));
                noise.map(|noise| noise.tensor(&bench.device))
            };
            let noise = part(format!("in.{kind}.noise"));
            let noise_q = part(format!("in.{kind}.noise_q"));
            let step = bench.step(x_t.clone(), timestep, noise, noise_q, &steering);
            let sample = step.prev_sample;
            let tolerance = match (kind, timestep) {
                ("motion", 999) => 2e-3,
                _ => 1e-4,
            };
            bench
                .part(&format!("out.{kind}.sample"), index)
                .assert_within(&format!("{kind} at {timestep}"), sample, tolerance, 0.0);
        }
    }
}

#[test]
fn golden_gmd_trajectory_loss() {
    let Some(golden) = Golden::open("gmd", "trajectory_loss.safetensors") else {
        return;
    };
    let device = Device::flex().autodiff();
    let w = golden.tensor::<2>("model.W", &device).require_grad();
    let v = golden.tensor::<1>("model.v", &device).require_grad();
    let s = golden.get("model.s").scalar();
    let timesteps = golden.get("in.t").indices();
    let input = |name: &str| golden.get(name).flat().tensor::<3>(&device);
    let (x_start, noise) = (input("in.x0"), input("in.noise"));
    let [batch, channels, frames] = x_start.dims();
    let mask = golden.get("in.mask").tensor::<4>(&device);
    let mask = mask.reshape([batch, frames]);
    for (kind, prediction_type) in [
        ("x0", PredictionType::Sample),
        ("eps", PredictionType::Epsilon),
    ] {
        let diffusion = process(prediction_type);
        for k in golden.get("in.k").values {
            let x_t = diffusion.add_noise(x_start.clone(), noise.clone(), &timesteps);
            golden.get(&format!("out.{kind}.x_t")).flat().assert_within(
                "x_t",
                x_t.clone(),
                1e-5,
                0.0,
            );
            let times: Vec<f32> = timesteps.iter().map(|&t| t as f32 / 1000.0).collect();
            let times = burn::tensor::TensorData::new(times, [batch, 1, 1]);
            let times: Tensor<3> = Tensor::from_data(times, &device);
            let told = v.clone().unsqueeze::<2>().unsqueeze_dim::<3>(2) * times;
            let output = (w.clone().unsqueeze::<3>().matmul(x_t) + told).tanh() * s;
            let target = diffusion.target(x_start.clone(), noise.clone(), &timesteps);
            let mut weights = vec![1.0; channels];
            weights[..4].fill(k * k);
            // The loss of each sample, then the batch's mean.
            let name = format!("{kind}.k{k}");
            for sample in 0..batch {
                let of = |x: &Tensor<3>| x.clone().narrow(0, sample, 1);
                let masked = mask.clone().narrow(0, sample, 1);
                let loss = weighted_masked_mse(of(&output), of(&target), masked, &weights);
                let expected = golden.get(&format!("out.{name}.loss")).values[sample];
                let found = f64::from(loss.into_scalar::<f32>());
                assert!(
                    (found / expected - 1.0).abs() < 1e-5,
                    "{name}: {found} for {expected}"
                );
            }
            let loss = weighted_masked_mse(output, target, mask.clone(), &weights);
            let gradients = loss.backward();
            golden.get(&format!("grad.{name}.W")).assert_close_tensor(
                "dW",
                w.grad(&gradients).expect("one"),
                1e-4,
            );
            golden.get(&format!("grad.{name}.v")).assert_close_tensor(
                "dv",
                v.grad(&gradients).expect("one"),
                1e-4,
            );
        }
    }
}
