use candle_core::Device;
use serde_json::json;

use super::*;

fn schedule() -> Schedule {
    Schedule::new(&Config::released()).unwrap()
}

fn tensor(values: &[f64]) -> Tensor {
    Tensor::new(values, &Device::Cpu).unwrap()
}

fn values(x: &Tensor) -> Vec<f64> {
    x.flatten_all().unwrap().to_vec1().unwrap()
}

fn close(got: &Tensor, want: &[f64]) {
    for (got, want) in values(got).iter().zip(want) {
        assert!((got - want).abs() < 1e-9, "{got} {want}");
    }
}

#[test]
fn the_released_alphas() {
    let schedule = schedule();
    assert_eq!(schedule.alpha(999).unwrap(), 0.0);
    for (timestep, want, digit) in [
        (998, 1.968e-7, 1e-10),
        (980, 7.708e-5, 1e-8),
        (500, 0.241_019, 1e-6),
        (199, 0.738_700, 1e-6),
        (0, 0.999_150, 1e-6),
    ] {
        let got = schedule.alpha(timestep).unwrap();
        assert!((got - want).abs() < digit, "{timestep}: {got}");
    }
    assert_eq!(schedule.final_alpha(), schedule.alpha(0).unwrap());
    assert!(schedule.alpha(1000).is_err());
    let clean = Config {
        set_alpha_to_one: true,
        ..Config::released()
    };
    assert_eq!(Schedule::new(&clean).unwrap().final_alpha(), 1.0);
}

#[test]
fn visited_timesteps() {
    let schedule = schedule();
    let fifty = schedule.timesteps(50).unwrap();
    assert_eq!(
        (fifty.len(), &fifty[..2], &fifty[51..]),
        (53, &[999, 980][..], &[30, 11][..])
    );
    let thirty = schedule.timesteps(30).unwrap();
    assert_eq!((thirty.len(), &thirty[29..]), (31, &[42, 9][..]));
    // Steps go to 20 below, although the next timestep is 19 below.
    assert_eq!(schedule.previous(999, 50).unwrap(), Some(979));
    assert_eq!(schedule.previous(11, 50).unwrap(), None);
    assert_eq!(
        schedule.previous_alpha(11, 50).unwrap(),
        schedule.final_alpha()
    );
    assert_eq!(schedule.timesteps(1).unwrap(), [999]);
    assert_eq!(schedule.timesteps(999).unwrap().len(), 999);
    for steps in [0, 1000, usize::MAX] {
        assert!(schedule.timesteps(steps).is_err());
    }
}

#[test]
fn the_schedulers_own_timesteps() {
    let of = |spacing, steps| {
        let config = Config {
            timestep_spacing: spacing,
            timestep_scaling: Some("no".to_owned()),
            ..Config::released()
        };
        Schedule::new(&config).unwrap().timesteps(steps).unwrap()
    };
    assert_eq!(of(Spacing::Leading, 5), [801, 601, 401, 201, 1]);
    assert_eq!(of(Spacing::Trailing, 4), [999, 749, 499, 249]);
    assert_eq!(of(Spacing::Trailing, 3), [999, 666, 332]);
    assert_eq!(of(Spacing::Linspace, 4), [999, 666, 333, 0]);
    assert_eq!(of(Spacing::Linspace, 1), [0]);
}

#[test]
fn every_prediction_leads_to_the_same_step() {
    let (sample, noise) = (tensor(&[1.0, -2.0, 0.5]), tensor(&[0.3, 0.1, -1.0]));
    let timestep = 505;
    let alpha = schedule().alpha(timestep).unwrap();
    let (a, s) = (alpha.sqrt(), (1.0 - alpha).sqrt());
    let noisy = schedule().add_noise(&sample, &noise, timestep).unwrap();
    close(&noisy, &[a + 0.3 * s, -2.0 * a + 0.1 * s, 0.5 * a - s]);
    let v = ((&noise * a).unwrap() - (&sample * s).unwrap()).unwrap();
    let before = schedule().alpha(485).unwrap();
    let (a, s) = (before.sqrt(), (1.0 - before).sqrt());
    let want = [a + 0.3 * s, -2.0 * a + 0.1 * s, 0.5 * a - s];
    for (prediction_type, output) in [
        (Prediction::V, &v),
        (Prediction::Epsilon, &noise),
        (Prediction::Sample, &sample),
    ] {
        let config = Config {
            prediction_type,
            ..Config::released()
        };
        let schedule = Schedule::new(&config).unwrap();
        close(&schedule.step(output, &noisy, timestep, 50).unwrap(), &want);
        let first = schedule.step(output, &noisy, 999, 50);
        match prediction_type {
            Prediction::Epsilon => assert!(first.unwrap_err().to_string().contains("epsilon")),
            _ => assert!(
                values(&first.unwrap())
                    .iter()
                    .all(|value| value.is_finite())
            ),
        }
    }
}

#[test]
fn the_first_step_of_v_prediction_by_hand() {
    // Nothing but noise: the sample is -v, the noise is the sample.
    let (v, x) = (tensor(&[0.5]), tensor(&[2.0]));
    let alpha = schedule().alpha(979).unwrap();
    let want = alpha.sqrt() * -0.5 + (1.0 - alpha).sqrt() * 2.0;
    close(&schedule().step(&v, &x, 999, 50).unwrap(), &[want]);
}

#[test]
fn weights_of_projections() {
    for (warp, want) in [
        (199, 0.998_57),
        (60, 0.8),
        (59, 0.742_19),
        (2, 0.010_33),
        (300, 1.0),
    ] {
        let got = Schedule::warp_weight(warp);
        assert!((got - want).abs() < 1e-5, "{warp}: {got}");
    }
    assert_eq!(Schedule::warp_timestep(304), 60);
    let (projection, noise, latents) = (tensor(&[2.0]), tensor(&[1.0]), tensor(&[-1.0]));
    let alpha = schedule().alpha(60).unwrap();
    let want = 0.8 * (alpha.sqrt() * 2.0 + (1.0 - alpha).sqrt()) - 0.2;
    close(
        &schedule()
            .warp_mix(&projection, &noise, &latents, 300)
            .unwrap(),
        &[want],
    );
}

#[test]
fn guidance_by_hand() {
    let of = |rows: [[f64; 2]; 2]| Tensor::new(&rows, &Device::Cpu).unwrap();
    let (c, u) = (of([[1.0, 3.0], [0.0, 2.0]]), of([[0.0, 0.0], [2.0, 0.0]]));
    let twice = guided(&c, &u, 2.0).unwrap();
    close(&twice, &[3.0, 9.0, -4.0, 6.0]);
    // Deviations of the rows: sqrt(2) and sqrt(2) against 3 sqrt(2) and 5 sqrt(2).
    close(&rescaled(&twice, &c, 1.0).unwrap(), &[1.0, 3.0, -0.8, 1.2]);
    close(&rescaled(&twice, &c, 0.5).unwrap(), &[2.0, 6.0, -2.4, 3.6]);
    close(&rescaled(&twice, &c, 0.0).unwrap(), &[3.0, 9.0, -4.0, 6.0]);
}

#[test]
fn settings_are_read_and_refused_by_name() {
    let read = |value| serde_json::from_value::<Config>(value);
    let file = json!({
        "_class_name": "DDIMScheduler", "num_train_timesteps": 1000, "beta_start": 0.00085,
        "beta_end": 0.012, "beta_schedule": "scaled_linear", "clip_sample": false,
        "set_alpha_to_one": false, "steps_offset": 1, "prediction_type": "v_prediction",
        "timestep_scaling": "trailing", "skip_prk_steps": true, "trained_betas": null
    });
    let config = read(file).unwrap();
    assert_eq!(config, Config::released());
    assert_eq!(config.warning(), None);
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
    let empty = read(json!({})).unwrap();
    assert_eq!(empty, Config::default());
    assert!(empty.warning().unwrap().contains("timestep_scaling"));
    for (change, part) in [
        (
            json!({"beta_schedule": "squaredcos_cap_v2"}),
            "squaredcos_cap_v2",
        ),
        (json!({"trained_betas": [0.1]}), "trained_betas"),
        (json!({"thresholding": true}), "thresholding"),
        (json!({"num_train_timesteps": 999}), "num_train_timesteps"),
        (
            json!({"num_train_timesteps": 1_000_000_000_000_u64}),
            "num_train_timesteps",
        ),
        (json!({"beta_start": 0.0}), "beta_start"),
        (json!({"beta_start": 0.5}), "beta_start"),
        (json!({"beta_end": 1.0}), "beta_end"),
    ] {
        let message = Schedule::new(&read(change).unwrap())
            .unwrap_err()
            .to_string();
        assert!(message.contains(part), "{message}");
    }
    assert!(read(json!({"prediction_type": "flow"})).is_err());
}
