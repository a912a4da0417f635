//! Layers of transformers.

use crate::{
    case::{Case, device},
    comparison::Comparison,
    mvdust3r::by_head,
};
use anyhow::Result;
use candle_core::{DType, Tensor};
use serde::Deserialize;
use tid3r_models::{
    mvdust3r::{ExpMode, postprocess},
    nn::{
        CrossAttention, DecoderBlock, EncoderBlock, LayerNorm, Mlp, NORM_EPS, Rope2d, Rotation,
        SelfAttention,
    },
};

/// The sizes of a block.
#[derive(Deserialize)]
struct Block {
    dim: usize,
    num_heads: usize,
    #[serde(default)]
    mlp_ratio: usize,
    freq: f32,
}

impl Block {
    fn rotation(&self, positions: &[[u32; 2]]) -> Result<Rotation> {
        let rope = Rope2d::new(self.dim / self.num_heads, self.freq)?;
        Ok(rope.rotation(positions, device()?)?)
    }
}

/// The input called `name`, positions (batch, tokens, 2), as one list for each item.
fn positions(case: &Case, name: &str) -> Result<Vec<Vec<[u32; 2]>>> {
    let items = case.input(name)?.to_dtype(DType::U32)?.to_vec3::<u32>()?;
    let list = |item: &Vec<Vec<u32>>| item.iter().map(|p| [p[0], p[1]]).collect();
    Ok(items.iter().map(list).collect())
}

/// Joins what `run` makes of each item of a batch (its index, its rotation): positions are an item's
/// own.
fn item_by_item<const N: usize>(
    rotations: &[Rotation],
    run: impl Fn(usize, &Rotation) -> Result<[Tensor; N]>,
) -> Result<[Tensor; N]> {
    let items = rotations.iter().enumerate();
    let results = items.map(|(i, rotation)| run(i, rotation));
    let results = results.collect::<Result<Vec<_>>>()?;
    let mut joined = Vec::new();
    for part in 0..N {
        let parts: Vec<_> = results
            .iter()
            .map(|tensors| tensors[part].clone())
            .collect();
        joined.push(Tensor::cat(&parts, 0)?);
    }
    joined
        .try_into()
        .map_err(|_| anyhow::anyhow!("as many tensors as there are parts"))
}

fn item(x: &Tensor, i: usize) -> Result<Tensor> {
    Ok(x.narrow(0, i, 1)?)
}

/// Rotary position embedding.
pub(crate) fn rope(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        freq: f32,
    }
    let Config { freq } = case.config()?;
    for name in case
        .inputs()
        .keys()
        .filter(|name| name.starts_with("tokens"))
    {
        let suffix = name.trim_start_matches("tokens");
        let tokens = case.input(name)?;
        let (_, heads, _, head_dim) = tokens.dims4()?;
        let flat = tokens.transpose(1, 2)?.flatten_from(2)?;
        let rope = Rope2d::new(head_dim, freq)?;
        let rotations = positions(case, &format!("positions{suffix}"))?
            .iter()
            .map(|positions| Ok(rope.rotation(positions, device()?)?))
            .collect::<Result<Vec<_>>>()?;
        let [out] = item_by_item(&rotations, |i, rotation| {
            let turned = rotation.apply(&item(&flat, i)?, heads)?;
            Ok([by_head(&turned, heads)?])
        })?;
        comparison.check(&format!("out{suffix}"), &out);
    }
    Ok(())
}

/// The rotations of a case about a block, one for each item of its batch.
fn rotations(case: &Case, block: &Block) -> Result<Vec<Rotation>> {
    let positions = positions(case, "positions")?;
    positions.iter().map(|item| block.rotation(item)).collect()
}

/// Self-attention.
pub(crate) fn self_attention(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let block: Block = case.config()?;
    let attention = SelfAttention::new(block.dim, block.num_heads, &case.weights()?)?;
    let x = case.input("x")?;
    let [q, k, out] = item_by_item(&rotations(case, &block)?, |i, rotation| {
        let x = item(x, i)?;
        let (q, memory) = attention.project(&x, rotation)?;
        let out = attention.forward_add(&x, rotation, &x.zeros_like()?)?;
        let heads = block.num_heads;
        Ok([by_head(&q, heads)?, by_head(&memory.k, heads)?, out])
    })?;
    comparison.check("q_rope", &q);
    comparison.check("k_rope", &k);
    comparison.check("out", &out);
    Ok(())
}

/// An encoder block.
pub(crate) fn encoder_block(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let sizes: Block = case.config()?;
    let (weights, hidden) = (case.weights()?, sizes.mlp_ratio * sizes.dim);
    let block = EncoderBlock::new(sizes.dim, sizes.num_heads, hidden, &weights)?;
    let mlp = Mlp::new(sizes.dim, hidden, &weights.pp("mlp"))?;
    let x = case.input("x")?;
    let [attended, out] = item_by_item(&rotations(case, &sizes)?, |i, rotation| {
        let x = item(x, i)?;
        Ok([block.attend(&x, rotation)?, block.forward(&x, rotation)?])
    })?;
    comparison.check("after_attn", &attended);
    comparison.check("mlp_of_x", &mlp.forward_add(x, &x.zeros_like()?)?);
    comparison.check("out", &out);
    Ok(())
}

/// A decoder block with several memories.
pub(crate) fn decoder_block(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let sizes: Block = case.config()?;
    let weights = case.weights()?;
    let (dim, heads) = (sizes.dim, sizes.num_heads);
    let block = DecoderBlock::new(dim, heads, sizes.mlp_ratio * dim, &weights)?;
    let norm = |name: &str| LayerNorm::new(dim, NORM_EPS, &weights.pp(name));
    let attn = SelfAttention::new(dim, heads, &weights.pp("attn"))?;
    let cross = CrossAttention::new(dim, heads, &weights.pp("cross_attn"))?;
    let (norm1, norm2) = (norm("norm1")?, norm("norm2")?);
    let (x, y) = (case.input("x")?, case.input("y")?);
    let views = y.dim(0)?;
    let [own, from_others, out] = item_by_item(&rotations(case, &sizes)?, |i, rotation| {
        let x = item(x, i)?;
        let others = (0..views)
            .map(|view| item(&y.get(view)?, i))
            .collect::<Result<Vec<_>>>()?;
        let memories = vec![block.memories(&others, rotation, usize::MAX)?];
        let nothing = x.zeros_like()?;
        let own = attn.forward_add(&norm1.forward(&x)?, rotation, &nothing)?;
        let attended = norm2.forward(&(&x + &own)?)?;
        let queries = cross.queries(&attended, rotation)?;
        let from_others = cross.forward_add(&queries, &memories, &nothing)?;
        let out = block.forward(&[x], rotation, &memories, usize::MAX)?;
        Ok([own, from_others, out[0].clone()])
    })?;
    comparison.check("self_attn", &own);
    comparison.check("cross_attn", &from_others);
    comparison.check("out", &out);
    Ok(())
}

/// What becomes of raw outputs.
pub(crate) fn postprocessing(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Config {
        depth_mode: ExpMode,
        conf_mode: ExpMode,
    }
    let config: Config = case.config()?;
    let run = |name: &str, conf_mode| -> Result<(Tensor, Tensor)> {
        let raw = case.input(name)?.permute((0, 2, 3, 1))?;
        Ok(postprocess(&raw, config.depth_mode, conf_mode)?)
    };
    let (points, confidence) = run("raw", config.conf_mode)?;
    comparison.check("pts3d", &points);
    comparison.check("conf", &confidence);
    comparison.check("near_zero", &points.get(0)?.get(0)?.narrow(0, 0, 3)?);
    let (points, confidence) = run("raw_big", config.conf_mode)?;
    comparison.check("pts3d_big", &points);
    comparison.check("conf_big", &confidence);
    let unbounded = ExpMode {
        high: f64::INFINITY,
        ..config.conf_mode
    };
    comparison.check("conf_big_unbounded", &run("raw_big", unbounded)?.1);
    Ok(())
}
