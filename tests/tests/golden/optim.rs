//! Moving average, AdamW, clipping and learning rates against golden files 09 and 11.

use kinegrad_tests::golden::Golden;
use kinegrad_tests::trials;
use kinegrad_tests::trials::GoldenTest;
use kinegrad_train::config::{EmaConfig, LrSchedule, OptimConfig};
use kinegrad_train::optim::{AdamW, Moments, clip_factor, learning_rate, norm_of_squares, squares};

const TOLERANCE: f64 = 2e-6;

/// Three roundings of a parameter that has moved by some hundredths.
const CHANGE: f64 = 1e-5;

/// The tests of this file.
pub fn tests() -> Vec<GoldenTest> {
    trials![
        golden_ema("ccmotion/09_ema.safetensors"),
        golden_adamw_with_clipping("ccmotion/11_optim.safetensors"),
        golden_learning_rates("ccmotion/11_optim.safetensors"),
    ]
}

fn golden_ema(golden: Golden) {
    for name in golden.names_under("out.shadow.") {
        let (parameter, setting) = name.split_once(".decay").expect("parameter and decay");
        let (decay, every) = setting.split_once(".every").expect("decay and interval");
        let config = EmaConfig {
            decay: decay.parse().expect("a decay"),
            update_every: every.parse().expect("an interval"),
            inv_gamma: 0.0,
            power: 1.0,
        };
        let given = golden.get(&format!("in.params.{parameter}"));
        let size: usize = given.shape[1..].iter().product();
        let values = given.f32s();
        let mut steps = values.chunks(size);
        let mut average = steps.next().expect("initial values").to_vec();
        let mut shadows = average.clone();
        for (step, values) in (1..).zip(steps) {
            if let Some(share) = config.share_at(step) {
                // A step that changes only the average.
                let mut optimizer = AdamW::new(&OptimConfig::default(), 0);
                optimizer.begin_step();
                let moved = Some((&mut average[..], share));
                let mut values = values.to_vec();
                let step = optimizer.step(0, 1.0, 0.0);
                Moments::zeros(size).update(step, &mut values, &vec![0.0; size], moved);
            }
            shadows.extend(&average);
        }
        golden
            .reference(&format!("out.shadow.{name}"))
            .assert_close_f32(&name, &shadows, 5e-6);
    }
}

fn golden_adamw_with_clipping(golden: Golden) {
    let parameters = golden.names_under("in.param.");
    // The settings of the cases (docs/sources.md, section 1.10).
    for (case, learning_rate, weight_decay, max_norm) in [
        ("spec", 1e-4, 1e-4, 1.0),
        ("strong", 1e-2, 0.1, 1.0),
        ("strong_noclip", 1e-2, 0.1, 0.0),
    ] {
        let config = OptimConfig {
            learning_rate,
            weight_decay,
            ..OptimConfig::default()
        };
        let mut values: Vec<Vec<f32>> = parameters
            .iter()
            .map(|name| golden.get(&format!("in.param.{name}")).f32s())
            .collect();
        let mut adamw = AdamW::new(&config, 0);
        let moments = values.iter().map(|values| Moments::zeros(values.len()));
        let mut moments: Vec<Moments> = moments.collect();
        let names = golden.names_under(&format!("out.adamw.{case}.step"));
        let steps = names.iter().filter(|name| name.ends_with(".total_norm"));
        let steps = steps.count();
        assert!(steps > 0, "no step of {case}");
        let before = values.clone();
        for step in 1..=steps {
            let key = |what: &str| format!("out.adamw.{case}.step{step}.{what}");
            let gradients: Vec<Vec<f32>> = parameters
                .iter()
                .map(|name| golden.get(&format!("in.grad.step{step}.{name}")).f32s())
                .collect();
            let norm = norm_of_squares(&squares(&gradients));
            golden
                .reference(&key("total_norm"))
                .assert_close("norm", &[norm], TOLERANCE);
            let scale = clip_factor(norm, max_norm);
            adamw.begin_step();
            for (index, name) in parameters.iter().enumerate() {
                let numbers = adamw.step(index, scale, learning_rate);
                let moments = &mut moments[index];
                moments.update(numbers, &mut values[index], &gradients[index], None);
                let clipped: Vec<f32> = gradients[index].iter().map(|g| g * scale as f32).collect();
                for (what, actual) in [
                    ("clipped_grad", &clipped),
                    ("param", &values[index]),
                    ("exp_avg", &moments.exp_avg),
                    ("exp_avg_sq", &moments.exp_avg_sq),
                ] {
                    let key = key(&format!("{what}.{name}"));
                    golden
                        .reference(&key)
                        .assert_close_f32(&key, actual, TOLERANCE);
                }
            }
        }
        // One case has the total change of all steps.
        if case == "strong" {
            for (index, name) in parameters.iter().enumerate() {
                let moved = values[index].iter().zip(&before[index]);
                let moved: Vec<f64> = moved
                    .map(|(after, before)| f64::from(*after) - f64::from(*before))
                    .collect();
                let reference = golden.get(&format!("delta64.adamw.{case}.{name}"));
                let what = format!("{case} change of {name}");
                reference.assert_close(&what, &moved, CHANGE);
            }
        }
    }
}

fn golden_learning_rates(golden: Golden) {
    let base = golden.metadata("base_lr").parse().expect("a rate");
    let warmup_steps = golden
        .metadata("warmup")
        .parse()
        .expect("a number of steps");
    let max_steps = golden
        .metadata("total_steps")
        .parse()
        .expect("a number of steps");
    let steps = golden.get("in.lr.steps").indices();
    for (name, lr_schedule) in [
        ("cosine", LrSchedule::Cosine),
        ("linear", LrSchedule::Linear),
        ("constant", LrSchedule::Constant),
    ] {
        let config = OptimConfig {
            warmup_steps,
            lr_schedule,
            ..OptimConfig::default()
        };
        let rates: Vec<f64> = steps
            .iter()
            .map(|&s| learning_rate(&config, base, s as u64, max_steps))
            .collect();
        golden
            .get(&format!("out64.lr.{name}"))
            .assert_close(name, &rates, 1e-12);
    }
}
