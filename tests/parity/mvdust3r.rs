//! MV-DUSt3R and MV-DUSt3R+: whole networks, and their heads.

use crate::{
    case::{Case, device},
    comparison::Comparison,
};
use anyhow::{Context, Result, ensure};
use candle_core::Tensor;
use serde::Deserialize;
use std::collections::BTreeMap;
use tid3r_models::{
    mvdust3r::{
        Config, ExpMode, GaussianHead, MvDust3r, Observer, Options, PatchGrid, Paths, PointsHead,
        SkipOptions, Statistics, Unobserved, ViewOutput, postprocess,
    },
    nn::{DecoderBlock, EncoderBlock, Precision, Rope2d, Rotation},
};

/// What a case's configuration says beyond the network's own.
#[derive(Deserialize)]
struct Run {
    #[serde(default)]
    bn_batch_stats: bool,
}

impl Run {
    /// As exact as can be: cases record the skip branch itself.
    fn skip(&self) -> SkipOptions {
        SkipOptions {
            statistics: match self.bn_batch_stats {
                true => Statistics::Batch,
                false => Statistics::Running,
            },
            precision: Precision::Exact,
        }
    }
}

/// Keeps the tensors of all stages that a case expects, and of heads.
struct Stages<'a, 'b> {
    comparison: &'a Comparison<'b>,
    seen: BTreeMap<String, Tensor>,
}

impl Observer for Stages<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        let stem = name.split('.').next().unwrap_or(name);
        if self.comparison.expects(stem) || name == "patch_embed" || name == "decoder_embed" {
            self.seen.insert(name.to_owned(), tensor()?);
        }
        Ok(())
    }
}

/// The whole network: every tensor that the case expects; and, as users run it, the first path alone
/// with fast convolutions, which must be as close.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let (config, run): (Config, Run) = (case.config()?, case.config()?);
    let weights = case.weights()?;
    let network = MvDust3r::new(&config, &weights)?;
    let images = case.input("img")?;
    let (views, batch, _, height, width) = images.dims5()?;
    let options = Options {
        paths: Paths::All,
        gaussians: ["rgb", "opacity", "scale", "rotation"]
            .iter()
            .any(|name| comparison.expects(name)),
        skip: run.skip(),
        ..Options::default()
    };
    let mut stages = Stages {
        comparison,
        seen: BTreeMap::new(),
    };
    let outputs = network.forward(images, &options, &mut stages)?;
    let mut seen = stages.seen;

    let first = seen["patch_embed"].clone();
    let embedded = seen["decoder_embed"].clone();
    let grid = PatchGrid::new(height, width, config.patch_size)?;
    if comparison.expects("enc0_q_rope") {
        let (q, k) = encoder_rotations(case, &config, grid, &first)?;
        comparison.check("enc0_q_rope", &by_view(&q, views)?);
        comparison.check("enc0_k_rope", &by_view(&k, views)?);
    }
    if comparison.expects("dec0_cross_q_rope") {
        let (q, k) = decoder_rotations(case, &config, grid, &embedded)?;
        comparison.check("dec0_cross_q_rope", &q);
        comparison.check("dec0_cross_k_rope", &k);
    }
    for (name, tensor) in &mut seen {
        if name == "patch_embed" || name.starts_with("enc") {
            *tensor = by_view(tensor, views)?;
        }
        if !name.contains('.') {
            comparison.check_if_expected(name, tensor);
        }
    }

    let paths = outputs.len();
    for head in ["head_skip", "head_raw"] {
        if comparison.expects(head) {
            let part = |path, view| Ok(seen[&format!("{head}.{path}.{view}")].clone());
            comparison.check(head, &by_slot(views, paths, &part)?);
        }
    }
    let output = |name: &str, of: &dyn Fn(&ViewOutput) -> Option<&Tensor>| {
        by_slot(views, paths, &|path, view| {
            let tensor = of(&outputs[path][view]).with_context(|| format!("no {name}"));
            Ok(tensor?.clone())
        })
    };
    type Of = fn(&ViewOutput) -> Option<&Tensor>;
    let parts: [(&str, Of); 6] = [
        ("pts3d", |view| Some(&view.points)),
        ("conf", |view| Some(&view.confidence)),
        ("rgb", |view| view.gaussians.as_ref().map(|g| &g.rgb)),
        ("opacity", |view| {
            view.gaussians.as_ref().map(|g| &g.opacity)
        }),
        ("scale", |view| view.gaussians.as_ref().map(|g| &g.scale)),
        ("rotation", |view| {
            view.gaussians.as_ref().map(|g| &g.rotation)
        }),
    ];
    for (name, of) in parts {
        if comparison.expects(name) {
            comparison.check(name, &output(name, &of)?);
        }
    }
    if !run.bn_batch_stats {
        let alone = network.forward(
            images,
            &Options {
                rows: grid.tokens() * batch,
                ..Options::default()
            },
            &mut Unobserved,
        )?;
        for (alone, wanted) in alone[0].iter().zip(&outputs[0]) {
            close(&alone.points, &wanted.points, case.tolerance())?;
            close(&alone.confidence, &wanted.confidence, case.tolerance())?;
        }
    }
    Ok(())
}

/// What users get is what all paths, computed exactly, give.
fn close(got: &Tensor, want: &Tensor, tolerance: f64) -> Result<()> {
    let norm = |x: &Tensor| -> Result<f32> { Ok(x.sqr()?.sum_all()?.to_scalar::<f32>()?.sqrt()) };
    let error = f64::from(norm(&(got - want)?)? / norm(want)?);
    ensure!(
        error <= tolerance,
        "the first path alone, computed fast, is off by {error:.1e}"
    );
    Ok(())
}

/// (views * batch, ..) to (views, batch, ..).
fn by_view(x: &Tensor, views: usize) -> Result<Tensor> {
    let dims = [&[views, x.dim(0)? / views], &x.dims()[1..]].concat();
    Ok(x.reshape(dims)?)
}

/// Joins parts (batch, ..) of (path, view) to (slots, batch * paths, ..), paths innermost; in path r,
/// slots 0 and r are exchanged.
fn by_slot(
    views: usize,
    paths: usize,
    part: &dyn Fn(usize, usize) -> Result<Tensor>,
) -> Result<Tensor> {
    let view = |slot: usize, path: usize| match slot {
        0 => path,
        slot if slot == path => 0,
        slot => slot,
    };
    let slot = |slot: usize| -> Result<Tensor> {
        let parts = (0..paths).map(|path| part(path, view(slot, path)));
        let parts = parts.collect::<Result<Vec<_>>>()?;
        Ok(Tensor::stack(&parts, 1)?.flatten(0, 1)?)
    };
    let slots = (0..views).map(slot).collect::<Result<Vec<_>>>()?;
    Ok(Tensor::stack(&slots, 0)?)
}

fn rotation(channels: usize, heads: usize, base: f32, grid: PatchGrid) -> Result<Rotation> {
    let rope = Rope2d::new(channels / heads, base)?;
    Ok(rope.rotation(&grid.positions(), device()?)?)
}

/// (batch, tokens, channels) to (batch, heads, tokens, head_dim).
pub(crate) fn by_head(x: &Tensor, heads: usize) -> Result<Tensor> {
    let (batch, tokens, channels) = x.dims3()?;
    let x = x
        .contiguous()?
        .reshape((batch, tokens, heads, channels / heads))?;
    Ok(x.transpose(1, 2)?)
}

/// Rotated queries and keys of the first encoder block.
fn encoder_rotations(
    case: &Case,
    config: &Config,
    grid: PatchGrid,
    tokens: &Tensor,
) -> Result<(Tensor, Tensor)> {
    let (channels, heads) = (config.enc_embed_dim, config.enc_num_heads);
    let weights = case.weights()?.pp("enc_blocks.0");
    let block = EncoderBlock::new(channels, heads, config.mlp_ratio * channels, &weights)?;
    let rotation = rotation(channels, heads, config.pos_embed.base, grid)?;
    let (q, memory) = block.project(tokens, &rotation)?;
    Ok((by_head(&q, heads)?, by_head(&memory.k, heads)?))
}

/// Rotated queries and keys of the reference view's first cross-attention.
fn decoder_rotations(
    case: &Case,
    config: &Config,
    grid: PatchGrid,
    tokens: &Tensor,
) -> Result<(Tensor, Tensor)> {
    let (channels, heads) = (config.dec_embed_dim, config.dec_num_heads);
    let weights = case.weights()?.pp("dec_blocks.0");
    let block = DecoderBlock::new(channels, heads, config.mlp_ratio * channels, &weights)?;
    let rotation = rotation(channels, heads, config.pos_embed.base, grid)?;
    let views = (0..tokens.dim(0)?)
        .map(|view| tokens.get(view))
        .collect::<candle_core::Result<Vec<_>>>()?;
    let q = block.cross_queries(&views[0], &rotation)?;
    let memories = block.memories(&views[1..], &rotation, usize::MAX)?;
    let keys: Vec<_> = memories.iter().map(|memory| memory.k.clone()).collect();
    Ok((
        by_head(&q, heads)?,
        by_head(&Tensor::cat(&keys, 1)?, heads)?,
    ))
}

/// The head of a case that is about one, whose configuration is not that of a whole network.
#[derive(Deserialize)]
struct HeadConfig {
    dec_embed_dim: usize,
    patch_size: usize,
    height: usize,
    width: usize,
    depth_mode: ExpMode,
    conf_mode: ExpMode,
    #[serde(default)]
    pts_head_config: tid3r_models::mvdust3r::PointsHeadConfig,
    skip_dim: Option<usize>,
    gs_mlp_dim: Option<usize>,
    #[serde(default)]
    sh_degree: usize,
    #[serde(flatten)]
    run: Run,
}

impl HeadConfig {
    fn network(&self) -> Config {
        let released = Config::mv_dust3r();
        Config {
            dec_embed_dim: self.dec_embed_dim,
            patch_size: self.patch_size,
            depth_mode: self.depth_mode,
            conf_mode: self.conf_mode,
            pts_head_config: self.pts_head_config,
            skip_dim: self.skip_dim.unwrap_or(released.skip_dim),
            gs_mlp_dim: self.gs_mlp_dim.unwrap_or(released.gs_mlp_dim),
            sh_degree: self.sh_degree,
            ..released
        }
    }

    fn grid(&self) -> Result<PatchGrid> {
        Ok(PatchGrid::new(self.height, self.width, self.patch_size)?)
    }
}

/// Every `step`-th entry along some dimensions: how cases keep pictures small.
fn subsampled(x: &Tensor, dims: &[usize], step: usize) -> Result<Tensor> {
    let mut x = x.clone();
    for &dim in dims {
        let kept: Vec<u32> = (0..x.dim(dim)? as u32).step_by(step).collect();
        x = x
            .contiguous()?
            .index_select(&Tensor::new(kept, x.device())?, dim)?;
    }
    Ok(x)
}

/// Keeps the tensors of all stages.
struct Branch(Vec<(String, Tensor)>);

impl Observer for Branch {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        self.0.push((name.to_owned(), tensor()?));
        Ok(())
    }
}

/// A points head alone.
pub(crate) fn points_head(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config: HeadConfig = case.config()?;
    let network = config.network();
    let head = PointsHead::new(&network, &case.weights()?)?;
    let (tokens, images) = (case.input("tokens")?, case.input("img")?);
    let mut branch = Branch(Vec::new());
    let raw = head.forward(
        tokens,
        images,
        config.grid()?,
        config.run.skip(),
        &mut branch,
    )?;
    let planes = |x: &Tensor| x.permute((0, 3, 1, 2));
    comparison.check_if_expected("proj", &head.project(tokens)?);
    for (name, tensor) in branch.0 {
        let name = format!("{name}_s8");
        if comparison.expects(&name) {
            let channels = subsampled(&tensor, &[1], 16)?;
            comparison.check(&name, &subsampled(&channels, &[2, 3], 8)?);
        }
    }
    if let Some(skip) = &raw.skip {
        comparison.check_if_expected("skip", &planes(skip)?);
    }
    comparison.check_if_expected("raw", &planes(&raw.raw)?);
    let (points, confidence) = postprocess(&raw.raw, network.depth_mode, network.conf_mode)?;
    comparison.check_if_expected("pts3d", &points);
    comparison.check_if_expected("conf", &confidence);
    Ok(())
}

/// A Gaussian head alone.
pub(crate) fn gaussian_head(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config: HeadConfig = case.config()?;
    let head = GaussianHead::new(&config.network(), &case.weights()?)?;
    let gaussians = head.forward(case.input("tokens")?, config.grid()?)?;
    for (name, tensor) in [
        ("rgb", &gaussians.rgb),
        ("opacity", &gaussians.opacity),
        ("scale", &gaussians.scale),
        ("rotation", &gaussians.rotation),
    ] {
        comparison.check(name, &subsampled(tensor, &[1, 2], 2)?);
    }
    Ok(())
}
