//! MV-DUSt3R's encoder against that of the original code, inside whole networks.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use crate::harness::{Case, reference};
use candle_core::{DType, Device, Result, Shape, Tensor};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};
use tid3r_models::mvdust3r::{Config, Encoder, PatchGrid};
use tid3r_models::nn::{EncoderBlock, Rope2d};
use tid3r_weights_convert::{Manifest, synth};

/// Compares all of the encoder's tensors that the case called `name` records.
fn compare(name: &str) {
    let case = Case::load(name);
    let config: Config = case.config();
    let images = case.input("img");
    let (views, scenes) = (images.dim(0).unwrap(), images.dim(1).unwrap());
    let by_view = |x: &Tensor| {
        let dims = [&[views, scenes][..], &x.dims()[1..]].concat();
        x.reshape(dims).unwrap()
    };

    let encoder = Encoder::new(&config, case.weights()).unwrap();
    let mut parity = case.parity();
    let mut first_tokens = None;
    encoder
        .forward_observed(&images.flatten(0, 1).unwrap(), |stage, tokens| {
            if stage == "patch_embed" {
                first_tokens = Some(tokens.clone());
            }
            if parity.expects(stage) {
                parity.check(stage, &by_view(tokens));
            }
        })
        .unwrap();

    if parity.expects("enc0_q_rope") {
        let (channels, heads) = (config.enc_embed_dim, config.enc_num_heads);
        let weights = case.weights().pp("enc_blocks.0");
        let block =
            EncoderBlock::new(channels, heads, config.mlp_ratio * channels, weights).unwrap();
        let grid = PatchGrid {
            rows: images.dim(3).unwrap() / config.patch_size,
            columns: images.dim(4).unwrap() / config.patch_size,
        };
        let rotation = Rope2d::new(channels / heads, config.pos_embed.base)
            .unwrap()
            .rotation(&grid.positions(), &Device::Cpu)
            .unwrap();
        let heads = block.heads(&first_tokens.unwrap(), &rotation).unwrap();
        parity.check("enc0_q_rope", &by_view(&heads.q));
        parity.check("enc0_k_rope", &by_view(&heads.k));
    }
    parity
        .finish(|name| name == "patch_embed" || name.starts_with("enc"))
        .unwrap();
}

#[test]
fn two_views() {
    compare("mvdust3r/mvd_tiny_2v_32x32");
}

#[test]
fn three_landscape_views() {
    compare("mvdust3r/mvd_tiny_3v_32x48");
}

#[test]
fn released_widths() {
    compare("mvdust3r/mvd_wide_2v_32x48");
}

/// Remembers which tensors a network asks for, and gives it zeros: a single one, broadcast.
#[derive(Default)]
struct Recorder(Arc<Mutex<BTreeMap<String, Vec<usize>>>>);

impl SimpleBackend for Recorder {
    fn get(
        &self,
        shape: Shape,
        name: &str,
        _: Init,
        dtype: DType,
        device: &Device,
    ) -> Result<Tensor> {
        let asked = shape.dims().to_vec();
        self.0.lock().unwrap().insert(name.to_owned(), asked);
        Tensor::zeros((), dtype, device)?.broadcast_as(shape)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> Result<Tensor> {
        candle_core::bail!("{name} was asked for without a shape")
    }

    fn contains_tensor(&self, _: &str) -> bool {
        true
    }
}

#[test]
fn the_released_encoder_asks_for_exactly_its_tensors() {
    let recorder = Recorder::default();
    let asked = Arc::clone(&recorder.0);
    let vb = VarBuilder::from_backend(Box::new(recorder), DType::F32, Device::Cpu);
    Encoder::new(&Config::released(), vb).unwrap();

    let manifest = Manifest::read(&reference("mvdust3r/state_dict_mvd.json")).unwrap();
    let listed: BTreeMap<_, _> = manifest
        .tensors()
        .iter()
        .filter(|(name, _)| name.starts_with("patch_embed.") || name.starts_with("enc_"))
        .map(|(name, spec)| (name.clone(), spec.shape().to_vec()))
        .collect();
    assert_eq!(listed.len(), 2 + 24 * 12 + 2);
    assert_eq!(*asked.lock().unwrap(), listed);
}

fn tiny() -> (Config, Encoder) {
    let case = Case::load("mvdust3r/mvd_tiny_2v_32x32");
    let config = case.config();
    let encoder = Encoder::new(&config, case.weights()).unwrap();
    (config, encoder)
}

#[test]
fn images_of_a_batch_are_independent() {
    let (config, encoder) = tiny();
    let shape = [3, 3, 2 * config.patch_size, 3 * config.patch_size];
    let images = Tensor::from_vec(synth::input("images", &shape), &shape, &Device::Cpu).unwrap();
    let together = encoder.forward(&images).unwrap();
    for i in 0..3 {
        let alone = encoder.forward(&images.narrow(0, i, 1).unwrap()).unwrap();
        let difference = (alone - together.narrow(0, i, 1).unwrap()).unwrap();
        let largest = difference.abs().unwrap().max_all().unwrap();
        assert!(largest.to_scalar::<f32>().unwrap() < 1e-5);
    }
}

#[test]
fn images_that_cannot_be_cut_into_patches_are_refused() {
    let (_, encoder) = tiny();
    for shape in [
        &[1, 3, 32, 40][..],
        &[1, 3, 0, 32],
        &[1, 1, 32, 32],
        &[3, 32, 32],
    ] {
        let images = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
        assert!(encoder.forward(&images).is_err(), "{shape:?}");
    }
}

#[test]
fn a_missing_weight_is_named() {
    let vb = VarBuilder::from_tensors([].into(), DType::F32, &Device::Cpu);
    let error = Encoder::new(&Config::released(), vb)
        .unwrap_err()
        .to_string();
    assert!(error.contains("patch_embed.proj.weight"), "{error}");
}
