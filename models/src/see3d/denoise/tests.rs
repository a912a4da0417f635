mod fast;

use candle_core::Device;

use super::*;
use crate::nn::Precision;
use crate::see3d::schedule;
use crate::see3d::unet::{Config, Repeats, Unet};
use crate::{Observer, Unobserved, Weights};

fn config() -> Config {
    Config {
        model_channels: 32,
        num_res_blocks: Repeats::Same(1),
        channel_mult: vec![1, 1],
        attention_resolutions: vec![2],
        num_head_channels: 16,
        context_dim: 8,
        ..Config::released()
    }
}

fn unet() -> Unet {
    let noise = |name: &str, shape: &[usize]| {
        let scale = (1.0 / shape.iter().skip(1).product::<usize>() as f32).sqrt();
        let wave = |i: usize| ((i + 31 * name.len()) as f32 * 12.9898).sin() * 43758.547;
        (0..shape.iter().product())
            .map(|i| wave(i).fract() * scale)
            .collect()
    };
    Unet::new(&config(), &Weights::from_fn(noise, &Device::Cpu)).unwrap()
}

fn released() -> Schedule {
    Schedule::new(&schedule::Config::released()).unwrap()
}

/// The same numbers for the same draw, and which draws there were.
#[derive(Default)]
struct Waves(Vec<Draw>);

impl Noise for Waves {
    fn draw(&mut self, draw: Draw, shape: (usize, usize, usize, usize)) -> Result<Tensor> {
        self.0.push(draw);
        let seed = match draw {
            Draw::Latents => 0.5,
            Draw::Warp(step) => 1.5 + step as f32,
        };
        let count = shape.0 * shape.1 * shape.2 * shape.3;
        let values = (0..count).map(|i| 1.4 * (seed * 7.3 + i as f32 * 1.234).sin());
        Tensor::from_vec(values.collect::<Vec<_>>(), shape, &Device::Cpu)
    }
}

fn waves(shape: (usize, usize, usize, usize), draw: Draw) -> Tensor {
    Waves::default().draw(draw, shape).unwrap()
}

fn conditions() -> Conditions {
    let mask = waves((3, 4, 4, 1), Draw::Warp(9)).ge(0.0).unwrap();
    Conditions {
        latents: waves((3, 4, 4, 4), Draw::Warp(8)),
        mask: mask.to_dtype(candle_core::DType::F32).unwrap(),
        references: 1,
    }
}

fn run(sampler: &Sampler, observer: &mut dyn Observer) -> (Tensor, Vec<Draw>) {
    let unet = unet();
    let context = unet
        .context(&waves((1, 1, 5, 8), Draw::Latents).get(0).unwrap())
        .unwrap();
    let mut noise = Waves::default();
    let (schedule, conditions) = (released(), conditions());
    let latents = denoise(
        &unet,
        &context,
        &conditions,
        &schedule,
        sampler,
        &mut noise,
        observer,
    )
    .unwrap();
    (latents, noise.0)
}

fn largest_difference(a: &Tensor, b: &Tensor) -> f32 {
    let difference = (a - b).unwrap().abs().unwrap().flatten_all().unwrap();
    difference.max(0).unwrap().to_scalar().unwrap()
}

fn targets(x: &Tensor) -> Tensor {
    x.narrow(0, 1, 2).unwrap()
}

fn sampler(quality: Quality, steps: usize) -> Sampler {
    Sampler {
        quality,
        steps,
        ..Sampler::released(Variant::Main)
    }
}

/// What is shown and told.
#[derive(Default)]
struct Seen {
    inputs: Vec<Tensor>,
    latents: Vec<Tensor>,
    done: f64,
}

impl Observer for Seen {
    fn stage(&mut self, name: &str, tensor: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        match name {
            "unet_input" => self.inputs.push(tensor()?),
            "latents" => self.latents.push(tensor()?),
            _ => {}
        }
        Ok(())
    }

    fn advance(&mut self, multiply_adds: f64) {
        self.done += multiply_adds;
    }
}

#[test]
fn halves_in_turn_change_nothing() {
    for quality in [
        Quality::Exact,
        Quality::Fast(Reuse::EverySecond { split: 0 }),
    ] {
        let together = sampler(quality, 4);
        let in_turn = Sampler {
            halves: Halves::InTurn,
            ..together
        };
        let (a, b) = (
            run(&together, &mut Unobserved).0,
            run(&in_turn, &mut Unobserved).0,
        );
        assert_eq!(largest_difference(&a, &b), 0.0);
    }
}

#[test]
fn what_the_network_is_given() {
    let mut seen = Seen::default();
    let (latents, draws) = run(&sampler(Quality::Exact, 4), &mut seen);
    // 999, 750, 501, 252, 3.
    assert_eq!(seen.inputs.len(), 5);
    let warps = (0..5).map(Draw::Warp);
    assert_eq!(
        draws,
        [Draw::Latents].into_iter().chain(warps).collect::<Vec<_>>()
    );
    assert_eq!(largest_difference(&seen.latents[4], &latents), 0.0);
    let conditions = conditions();
    let input = &seen.inputs[1];
    assert_eq!(input.dims(), [6, 4, 4, 9]);
    let part = |frame: usize, channel: usize, channels: usize| {
        input
            .narrow(0, frame, 1)
            .unwrap()
            .narrow(3, channel, channels)
            .unwrap()
    };
    let own = |x: &Tensor, frame| x.narrow(0, frame, 1).unwrap();
    let same = |a: &Tensor, b: &Tensor| assert!(largest_difference(a, b) < 1e-6);
    for half in [0, 3] {
        // The reference is clean, and conditioned on itself.
        same(&part(half, 0, 4), &own(&conditions.latents, 0));
        same(&part(half, 4, 4), &own(&conditions.latents, 0));
        same(&part(half, 8, 1), &own(&conditions.mask, 0));
        same(&part(half + 1, 0, 4), &own(&seen.latents[0], 1));
    }
    let mix = released().warp_mix(
        &own(&conditions.latents, 2),
        &own(&waves((3, 4, 4, 4), Draw::Warp(1)), 2),
        &own(&seen.latents[0], 2),
        750,
    );
    same(&part(2, 4, 4), &mix.unwrap());
    same(&part(2, 8, 1), &own(&conditions.mask, 2));
    same(&part(5, 4, 5), &part(5, 4, 5).zeros_like().unwrap());
}

#[test]
fn super_resolution_keeps_its_condition() {
    let mut seen = Seen::default();
    let own = Sampler {
        steps: 2,
        ..Sampler::released(Variant::SuperResolution)
    };
    let (_, draws) = run(&own, &mut seen);
    assert_eq!(draws, [Draw::Latents]);
    for input in &seen.inputs {
        let condition = input.narrow(0, 0, 3).unwrap().narrow(3, 4, 4).unwrap();
        assert_eq!(largest_difference(&condition, &conditions().latents), 0.0);
    }
}

#[test]
fn without_guidance_the_network_is_asked_once() {
    let mut seen = Seen::default();
    let own = Sampler {
        guidance: 0.0,
        ..sampler(Quality::Exact, 2)
    };
    run(&own, &mut seen);
    assert_eq!(seen.inputs[0].dims(), [3, 4, 4, 9]);
}

#[test]
fn progress_is_what_was_announced() {
    let work = Work::new(&config(), Precision::Fast, 3, (4, 4));
    for (quality, steps, guidance) in [
        (Quality::Exact, 4, 2.0),
        (Quality::Exact, 4, 0.0),
        (Quality::Fast(Reuse::Never), 3, 2.0),
        (Quality::Fast(Reuse::EverySecond { split: 1 }), 4, 2.0),
        (Quality::Fast(Reuse::EverySecond { split: 0 }), 5, 2.0),
    ] {
        let (mut seen, own) = (
            Seen::default(),
            Sampler {
                guidance,
                ..sampler(quality, steps)
            },
        );
        run(&own, &mut seen);
        let announced = own.computed(&work, &released()).unwrap();
        assert!((seen.done / announced - 1.0).abs() < 1e-12, "{quality:?}");
    }
}

#[test]
fn the_observer_can_end_a_run() {
    struct Stops;
    impl Observer for Stops {
        fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
            if name == "guided" {
                bail!("stopped");
            }
            Ok(())
        }
    }
    let unet = unet();
    let context = unet
        .context(&waves((1, 1, 5, 8), Draw::Latents).get(0).unwrap())
        .unwrap();
    let own = sampler(Quality::Exact, 4);
    let (conditions, noise) = (conditions(), &mut Waves::default());
    let run = denoise(
        &unet,
        &context,
        &conditions,
        &released(),
        &own,
        noise,
        &mut Stops,
    );
    assert!(run.unwrap_err().to_string().contains("stopped"));
}

#[test]
fn what_does_not_fit_is_refused() {
    let unet = unet();
    let rows = |rows| {
        let context = waves((1, rows, 5, 8), Draw::Latents).get(0).unwrap();
        unet.context(&context).unwrap()
    };
    let of = |conditions: &Conditions, sampler: &Sampler, context| {
        let noise = &mut Waves::default();
        let run = denoise(
            &unet,
            &context,
            conditions,
            &released(),
            sampler,
            noise,
            &mut Unobserved,
        );
        run.map(|_| ()).map_err(|e| e.to_string())
    };
    let (good, own) = (conditions(), sampler(Quality::Exact, 1));
    of(&good, &own, rows(1)).unwrap();
    of(&good, &own, rows(6)).unwrap();
    let mask = good.mask.narrow(0, 0, 2).unwrap();
    for (conditions, sampler, context, problem) in [
        (good.clone(), own, rows(3), "3 rows"),
        (
            Conditions {
                references: 0,
                ..good.clone()
            },
            own,
            rows(1),
            "reference",
        ),
        (
            Conditions {
                references: 3,
                ..good.clone()
            },
            own,
            rows(1),
            "reference",
        ),
        (
            Conditions {
                mask,
                ..good.clone()
            },
            own,
            rows(1),
            "mask",
        ),
        (
            good.clone(),
            Sampler {
                guidance: -1.0,
                ..own
            },
            rows(1),
            "guidance",
        ),
        (
            good.clone(),
            Sampler {
                guidance: f64::NAN,
                ..own
            },
            rows(1),
            "guidance",
        ),
        (
            good.clone(),
            Sampler {
                rescale: 1.5,
                ..own
            },
            rows(1),
            "rescaled",
        ),
        (good.clone(), Sampler { steps: 0, ..own }, rows(1), "steps"),
    ] {
        let message = of(&conditions, &sampler, context).unwrap_err();
        assert!(message.contains(problem), "{message}");
    }
}
