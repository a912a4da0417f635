use candle_core::Device;

use super::*;
use crate::Unobserved;
use crate::see3d::unet::Repeats;

fn config() -> Config {
    Config {
        in_channels: 3,
        model_channels: 32,
        num_res_blocks: Repeats::Same(1),
        channel_mult: vec![1, 2],
        attention_resolutions: vec![1],
        num_head_channels: 16,
        context_dim: 8,
        ..Config::released()
    }
}

fn network(config: &Config) -> Unet {
    let wave = |name: &str, shape: &[usize]| {
        let fan_in: usize = shape.iter().skip(1).product();
        let scale = (3.0 / fan_in as f32).sqrt().min(0.3);
        let value = |i: usize| ((i * 7919 + 31 * name.len()) as f32).sin() * scale;
        (0..shape.iter().product()).map(value).collect()
    };
    Unet::new(config, &Weights::from_fn(wave, &Device::Cpu)).unwrap()
}

fn random(shape: &[usize]) -> Tensor {
    Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
}

fn largest_difference(a: &Tensor, b: &Tensor) -> f32 {
    let difference = (a - b).unwrap().abs().unwrap().flatten_all().unwrap();
    difference.max(0).unwrap().to_scalar().unwrap()
}

#[test]
fn the_released_networks_tensors() {
    let tensors = Unet::tensors(&Config::released()).unwrap();
    let parameters: usize = tensors
        .values()
        .map(|shape| shape.iter().product::<usize>())
        .sum();
    assert_eq!((tensors.len(), parameters), (686, 865_925_124));
    for (name, shape) in [
        ("time_embed.2.weight", vec![1280, 1280]),
        ("input_blocks.0.0.weight", vec![320, 9, 3, 3]),
        (
            "input_blocks.4.0.skip_connection.weight",
            vec![640, 320, 1, 1],
        ),
        ("input_blocks.6.0.op.bias", vec![640]),
        (
            "middle_block.1.transformer_blocks.0.ff.net.0.proj.weight",
            vec![10240, 1280],
        ),
        ("output_blocks.2.1.conv.weight", vec![1280, 1280, 3, 3]),
        ("output_blocks.5.2.conv.weight", vec![1280, 1280, 3, 3]),
        ("output_blocks.8.0.in_layers.0.weight", vec![960]),
        (
            "output_blocks.11.1.transformer_blocks.0.attn2.to_k.weight",
            vec![320, 1024],
        ),
        ("out.2.weight", vec![4, 320, 3, 3]),
    ] {
        assert_eq!(tensors[name], shape, "{name}");
    }
    let camera = Config {
        camera_dim: Some(16),
        ..Config::released()
    };
    assert_eq!(Unet::tensors(&camera).unwrap(), tensors);
}

#[test]
fn groups_and_timesteps_do_not_know_of_each_other() {
    let network = network(&config());
    let (x, context) = (random(&[4, 4, 6, 3]), random(&[4, 5, 8]));
    let timesteps = [999.0, 999.0, 30.0, 7.0];
    let whole = network.context(&context).unwrap();
    let both = network
        .forward(&x, &timesteps, &whole, 2, &mut Unobserved)
        .unwrap();
    assert_eq!(both.dims(), [4, 4, 6, 4]);
    for group in 0..2 {
        let own = |t: &Tensor| t.narrow(0, 2 * group, 2).unwrap();
        let context = whole.narrow(2 * group, 2).unwrap();
        let timesteps = &timesteps[2 * group..][..2];
        let alone = network
            .forward(&own(&x), timesteps, &context, 2, &mut Unobserved)
            .unwrap();
        assert!(largest_difference(&alone, &own(&both)) < 1e-5);
    }
}

#[test]
fn one_row_of_context_stands_for_equal_rows() {
    let network = network(&config());
    let (x, row) = (random(&[3, 4, 4, 3]), random(&[1, 5, 8]));
    let rows = row.repeat((3, 1, 1)).unwrap();
    let of = |context: &Tensor| {
        let context = network.context(context).unwrap();
        network
            .forward(&x, &[5.0; 3], &context, 3, &mut Unobserved)
            .unwrap()
    };
    assert!(largest_difference(&of(&row), &of(&rows)) < 1e-5);
}

#[test]
fn reusing_the_same_call_gives_the_same_result() {
    let network = network(&config());
    let (x, context) = (
        random(&[2, 4, 4, 3]),
        network.context(&random(&[1, 5, 8])).unwrap(),
    );
    for split in 0..2 {
        let observer = &mut Unobserved;
        let (whole, deep) = network
            .forward_keeping(&x, &[9.0; 2], &context, 2, split, observer)
            .unwrap();
        let want = network
            .forward(&x, &[9.0; 2], &context, 2, observer)
            .unwrap();
        let again = network
            .forward_reusing(&x, &[9.0; 2], &context, 2, &deep, observer)
            .unwrap();
        assert_eq!(largest_difference(&whole, &want), 0.0);
        assert_eq!(largest_difference(&again, &want), 0.0);
        // Another input reaches the result through what is recomputed.
        let other = random(&[2, 4, 4, 3]);
        let got = network
            .forward_reusing(&other, &[9.0; 2], &context, 2, &deep, observer)
            .unwrap();
        assert!(largest_difference(&got, &want) > 1e-3);
        let small = random(&[2, 2, 4, 3]);
        assert!(
            network
                .forward_reusing(&small, &[9.0; 2], &context, 2, &deep, observer)
                .is_err()
        );
    }
    assert!(
        network
            .forward_keeping(&x, &[9.0; 2], &context, 2, 2, &mut Unobserved)
            .is_err()
    );
}

#[test]
fn work_adds_up() {
    #[derive(Default)]
    struct Done(f64);
    impl Observer for Done {
        fn advance(&mut self, multiply_adds: f64) {
            self.0 += multiply_adds;
        }
    }
    let config = config();
    let network = network(&config);
    let context = network.context(&random(&[1, 5, 8])).unwrap();
    let x = random(&[4, 8, 4, 3]);
    let work = Work::new(&config, Precision::Fast, 2, (8, 4));
    let mut done = Done::default();
    let (_, deep) = network
        .forward_keeping(&x, &[1.0; 4], &context, 2, 1, &mut done)
        .unwrap();
    assert_eq!(done.0, 2.0 * work.computed());
    let mut done = Done::default();
    network
        .forward_reusing(&x, &[1.0; 4], &context, 2, &deep, &mut done)
        .unwrap();
    assert!((done.0 / (2.0 * work.reusing(1)) - 1.0).abs() < 1e-12);
}

#[test]
fn what_does_not_fit_is_refused() {
    let network = network(&config());
    let context = network.context(&random(&[1, 5, 8])).unwrap();
    let of = |shape: &[usize], timesteps: &[f32], context: &Context, frames| {
        network.forward(&random(shape), timesteps, context, frames, &mut Unobserved)
    };
    assert!(of(&[2, 4, 4, 3], &[1.0; 2], &context, 2).is_ok());
    let two = network.context(&random(&[2, 5, 8])).unwrap();
    for (shape, timesteps, context, frames, problem) in [
        ([2, 4, 4, 4], 2, &context, 2, "3 channels"),
        ([2, 4, 5, 3], 2, &context, 2, "multiples of 2"),
        ([2, 0, 4, 3], 2, &context, 2, "multiples of 2"),
        ([3, 4, 4, 3], 3, &context, 2, "groups of 2"),
        ([2, 4, 4, 3], 2, &context, 0, "groups of 0"),
        ([2, 4, 4, 3], 1, &context, 2, "1 timesteps"),
        ([4, 4, 4, 3], 4, &two, 2, "2 rows"),
    ] {
        let message = of(&shape, &vec![1.0; timesteps], context, frames)
            .unwrap_err()
            .to_string();
        assert!(message.contains(problem), "{message}");
    }
    assert!(network.context(&random(&[1, 5, 9])).is_err());
}
