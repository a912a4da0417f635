//! The layers of MV-DUSt3R's encoder against those of the original code.

use crate::harness::Case;
use candle_core::{Device, Module, Tensor};
use candle_nn::VarBuilder;
use serde::Deserialize;
use tid3r_models::nn::{self, Mlp, Rope2d, Rotation, SelfAttention};

/// The configuration of a layer's case.
#[derive(Deserialize)]
struct Layer {
    dim: usize,
    num_heads: usize,
    freq: f32,
}

impl Layer {
    fn rotation(&self, case: &Case) -> Rotation {
        let positions = case.positions("positions");
        assert!(positions.iter().all(|item| *item == positions[0]));
        let rope = Rope2d::new(self.dim / self.num_heads, self.freq).unwrap();
        rope.rotation(&positions[0], &Device::Cpu).unwrap()
    }
}

/// Rotates each item of `tokens` by its own positions.
fn rotate(case: &Case, freq: f32, tokens: &str, positions: &str) -> Tensor {
    let tokens = case.input(tokens);
    let rope = Rope2d::new(tokens.dims4().unwrap().3, freq).unwrap();
    let items: Vec<_> = case
        .positions(positions)
        .iter()
        .enumerate()
        .map(|(i, positions)| {
            let rotation = rope.rotation(positions, &Device::Cpu).unwrap();
            rotation.apply(&tokens.narrow(0, i, 1).unwrap()).unwrap()
        })
        .collect();
    Tensor::cat(&items, 0).unwrap()
}

#[test]
fn rope2d() {
    #[derive(Deserialize)]
    struct Config {
        freq: f32,
    }
    let case = Case::load("mvdust3r/rope2d");
    let Config { freq } = case.config();
    let mut parity = case.parity();
    parity.check("out", &rotate(&case, freq, "tokens", "positions"));
    parity.check("out_64", &rotate(&case, freq, "tokens_64", "positions_64"));
    parity.finish(|_| true).unwrap();
}

#[test]
fn self_attention() {
    let case = Case::load("mvdust3r/attention");
    let layer: Layer = case.config();
    let attention = SelfAttention::new(layer.dim, layer.num_heads, case.weights()).unwrap();
    let (x, rotation) = (case.input("x"), layer.rotation(&case));
    let heads = attention.heads(x, &rotation).unwrap();
    let mut parity = case.parity();
    parity.check("q_rope", &heads.q);
    parity.check("k_rope", &heads.k);
    parity.check("out", &attention.forward(x, &rotation).unwrap());
    parity.finish(|_| true).unwrap();
}

#[test]
fn encoder_block() {
    let case = Case::load("mvdust3r/encoder_block");
    let layer: Layer = case.config();
    let hidden = 4 * layer.dim;
    let weights: VarBuilder = case.weights();
    let mlp = Mlp::new(layer.dim, hidden, weights.pp("mlp")).unwrap();
    let block = nn::EncoderBlock::new(layer.dim, layer.num_heads, hidden, weights).unwrap();
    let (x, rotation) = (case.input("x"), layer.rotation(&case));
    let mut parity = case.parity();
    parity.check("mlp_of_x", &mlp.forward(x).unwrap());
    parity.check("after_attn", &block.attend(x, &rotation).unwrap());
    parity.check("out", &block.forward(x, &rotation).unwrap());
    parity.finish(|_| true).unwrap();
}

#[test]
fn the_comparison_can_fail() {
    let case = Case::load("mvdust3r/rope2d");
    let (out, out_64) = (case.expected("out"), case.expected("out_64"));
    let compare = |got: Option<Tensor>| {
        let mut parity = case.parity();
        parity.check("out_64", out_64);
        if let Some(got) = got {
            parity.check("out", &got);
        }
        parity.finish(|_| true)
    };
    assert_eq!(compare(Some(out.clone())), Ok(0.0));
    for (got, reason) in [
        (None, "out: not compared"),
        (Some(out * 1.0001), "out: relative L2 error 1.00e-4"),
        (Some(out * f64::NAN), "out: holds NaN"),
        (Some(out.flatten_to(1)), "out: shape [6, 15, 16]"),
    ]
    .map(|(got, reason)| (got.map(|got| got.unwrap()), reason))
    {
        let report = compare(got).unwrap_err();
        assert!(report.contains(reason), "{report}");
    }
}
