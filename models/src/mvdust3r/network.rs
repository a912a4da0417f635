//! The whole network.

use candle_core::{Device, Result, Tensor, bail};
use std::collections::BTreeMap;

use super::{
    Config, Decoder, Encoder, GaussianHead, Gaussians, Observer, PatchGrid, PointsHead,
    SkipOptions, Statistics, Work, postprocess,
};
use crate::Weights;
use crate::nn::Precision;

/// MV-DUSt3R or MV-DUSt3R+.
#[derive(Debug)]
pub struct MvDust3r {
    config: Config,
    /// That of the weights.
    device: Device,
    encoder: Encoder,
    decoder: Decoder,
    /// For the reference view, and for all others.
    points_heads: [PointsHead; 2],
    /// The same.
    gaussian_heads: Option<[GaussianHead; 2]>,
}

/// Whose outputs are wanted of MV-DUSt3R+, which looks at the scene from several reference views.
/// MV-DUSt3R has one path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Paths {
    /// Those of the path of view 0, which is what the original's demo shows.
    #[default]
    First,
    /// Those of every path.
    All,
}

/// What is wanted of a network, and how much it may take at a time.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Whose outputs are wanted.
    pub paths: Paths,
    /// Whether the Gaussian heads run.
    pub gaussians: bool,
    /// How the skip branch is computed. [`Statistics::Batch`] wants [`Paths::All`].
    pub skip: SkipOptions,
    /// Tokens that encoder and decoder work on at a time; fewer need less memory.
    pub rows: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            paths: Paths::First,
            gaussians: false,
            skip: SkipOptions {
                statistics: Statistics::Running,
                precision: Precision::Fast,
            },
            rows: 4096,
        }
    }
}

/// What the network says of one view.
#[derive(Clone, Debug)]
pub struct ViewOutput {
    /// The point of each pixel (batch, height, width, 3), in the camera frame of the path's reference
    /// view (OpenCV's: x right, y down, z forward), in one unknown scale for all views of a scene.
    pub points: Tensor,
    /// Confidence of each pixel (batch, height, width), above 1.
    pub confidence: Tensor,
    /// The Gaussians, if they were wanted.
    pub gaussians: Option<Gaussians>,
}

impl MvDust3r {
    /// Reads the network's tensors from `weights`. Gaussian heads are there if the configuration says so.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let points = |i| PointsHead::new(config, &weights.pp(format!("downstream_head{i}")));
        let gaussian = |i| GaussianHead::new(config, &weights.pp("downstream_GS_head").pp(i));
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            encoder: Encoder::new(config, weights)?,
            decoder: Decoder::new(config, weights)?,
            points_heads: [points(1)?, points(2)?],
            gaussian_heads: match config.gs {
                true => Some([gaussian(0)?, gaussian(1)?]),
                false => None,
            },
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// What the network says of each view, `[path][view]`.
    ///
    /// `images` is (views, batch, 3, height, width), colours in [-1, 1], all scenes of a batch
    /// independent of each other. View 0 is the reference; with MV-DUSt3R+ view r is that of path r.
    /// The order of the other views does not matter.
    ///
    /// `observer` is shown `patch_embed`, `enc_i` and `enc_norm` (views * batch, tokens, channels);
    /// `decoder_embed` and `dec_i` (views, batch, tokens, channels) or, with several paths, `dec_i`
    /// and `dec_i_cross` (paths, views, batch, tokens, channels); `dec_norm` (views, batch * paths,
    /// tokens, channels); for each path and view `head_skip.PATH.VIEW` and `head_raw.PATH.VIEW`
    /// (batch, 3 or 4, height, width).
    ///
    /// # Errors
    ///
    /// If there are fewer than two views or fewer than reference views, if `images` has another shape
    /// or sides that are no multiples of the patch, or if `options` ask for what this network has not.
    pub fn forward(
        &self,
        images: &Tensor,
        options: &Options,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Vec<ViewOutput>>> {
        let (views, batch, _, height, width) = images.dims5()?;
        if options.gaussians && self.gaussian_heads.is_none() {
            bail!("these weights have no Gaussian heads");
        }
        if options.skip.statistics == Statistics::Batch && options.paths != Paths::All {
            bail!("statistics of the batch are over all paths, so all paths must be wanted");
        }
        let grid = PatchGrid::new(height, width, self.config.patch_size)?;
        let images = &images.to_device(&self.device)?;
        let encoded = self
            .encoder
            .forward(&images.flatten(0, 1)?, options.rows, observer)?;
        let encoded = (0..views)
            .map(|view| encoded.narrow(0, view * batch, batch))
            .collect::<Result<Vec<_>>>()?;
        let tokens = self.decoder.forward(
            &encoded,
            &grid.positions(),
            options.paths,
            options.rows,
            observer,
        )?;
        drop(encoded);
        let images = (0..views)
            .map(|view| images.get(view))
            .collect::<Result<Vec<_>>>()?;
        self.heads(&tokens, &images, grid, options, observer)
    }

    /// The heads' outputs `[path][view]` for tokens `[path][view]`.
    fn heads(
        &self,
        tokens: &[Vec<Tensor>],
        images: &[Tensor],
        grid: PatchGrid,
        options: &Options,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Vec<ViewOutput>>> {
        let mut outputs: Vec<Vec<Option<ViewOutput>>> =
            vec![vec![None; images.len()]; tokens.len()];
        let work = Work::new(
            &self.config,
            1,
            grid.size(),
            Paths::First,
            options.gaussians,
        );
        let work = work.points_heads + work.gaussian_heads - work.saved;
        for slot in 0..images.len() {
            let items: Vec<(usize, usize)> = (0..tokens.len())
                .map(|path| (path, view_in_slot(slot, path)))
                .collect();
            // Batch norm makes items of a batch depend on each other only with their own statistics;
            // else one item at a time keeps memory low.
            let at_once = match options.skip.statistics {
                Statistics::Running => 1,
                Statistics::Batch => items.len(),
            };
            for items in items.chunks(at_once) {
                let joined = |of: &dyn Fn(usize, usize) -> Tensor| {
                    let parts = items.iter().map(|&(path, view)| of(path, view));
                    Tensor::cat(&parts.collect::<Vec<_>>(), 0)
                };
                let tokens = joined(&|path, view| tokens[path][view].clone())?;
                let images = joined(&|_, view| images[view].clone())?;
                let results = self.head(slot, &tokens, &images, grid, options, items, observer)?;
                for (&(path, view), result) in items.iter().zip(results) {
                    outputs[path][view] = Some(result);
                    observer.advance(work);
                }
            }
        }
        let complete = |views: Vec<Option<ViewOutput>>| views.into_iter().flatten().collect();
        Ok(outputs.into_iter().map(complete).collect())
    }

    /// The outputs of the heads of one slot for several items (path, view), whose tokens and images
    /// are joined.
    #[expect(clippy::too_many_arguments, reason = "the heads need all of it")]
    fn head(
        &self,
        slot: usize,
        tokens: &Tensor,
        images: &Tensor,
        grid: PatchGrid,
        options: &Options,
        items: &[(usize, usize)],
        observer: &mut dyn Observer,
    ) -> Result<Vec<ViewOutput>> {
        let kind = usize::from(slot > 0);
        let raw = self.points_heads[kind].forward(tokens, images, grid, options.skip, observer)?;
        let gaussians = match &self.gaussian_heads {
            Some(heads) if options.gaussians => Some(heads[kind].forward(tokens, grid)?),
            _ => None,
        };
        let config = &self.config;
        let (points, confidence) = postprocess(&raw.raw, config.depth_mode, config.conf_mode)?;
        let batch = tokens.dim(0)? / items.len();
        let part = |x: &Tensor, i: usize| x.narrow(0, i * batch, batch);
        let output = |(i, &(path, view)): (usize, &(usize, usize))| {
            let mut show = |name: &str, x: &Tensor| {
                let name = format!("{name}.{path}.{view}");
                observer.stage(&name, &|| part(x, i)?.permute((0, 3, 1, 2)))
            };
            if let Some(skip) = &raw.skip {
                show("head_skip", skip)?;
            }
            show("head_raw", &raw.raw)?;
            let host = |x: &Tensor| part(x, i)?.to_device(&Device::Cpu);
            let gaussians = match &gaussians {
                Some(all) => Some(Gaussians {
                    rgb: host(&all.rgb)?,
                    opacity: host(&all.opacity)?,
                    scale: host(&all.scale)?,
                    rotation: host(&all.rotation)?,
                }),
                None => None,
            };
            Ok(ViewOutput {
                points: part(&points, i)?,
                confidence: part(&confidence, i)?,
                gaussians,
            })
        };
        items.iter().enumerate().map(output).collect()
    }
}

/// Which view of `path` the heads treat in `slot`: the reference view in slot 0, whose own slot takes
/// view 0.
fn view_in_slot(slot: usize, path: usize) -> usize {
    match slot {
        0 => path,
        slot if slot == path => 0,
        slot => slot,
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;
    use crate::mvdust3r::Unobserved;

    /// A small network with `references` paths.
    fn config(references: usize) -> Config {
        Config {
            enc_embed_dim: 16,
            enc_depth: 1,
            enc_num_heads: 2,
            dec_embed_dim: 16,
            dec_depth: 2,
            dec_num_heads: 1,
            m_ref_flag: references > 1,
            n_ref: Some(references),
            skip_dim: 4,
            gs_mlp_dim: 8,
            ..Config::mv_dust3r()
        }
    }

    /// Numbers in [-1, 1) that depend on `seed` and their place.
    fn numbers(seed: u64, count: usize) -> Vec<f32> {
        let number = |i: u64| {
            let mixed =
                (seed ^ i.wrapping_mul(0x9E37_79B9_7F4A_7C15)).wrapping_mul(0xD6E8_FEB8_6659_FD93);
            (mixed >> 40) as f32 / (1 << 23) as f32 - 1.0
        };
        (1..=count as u64).map(number).collect()
    }

    fn network(config: &Config) -> MvDust3r {
        let make = |name: &str, shape: &[usize]| {
            let seed = name
                .bytes()
                .fold(7_u64, |h, b| h.wrapping_mul(31) + u64::from(b));
            let fan_in: usize = shape.iter().skip(1).product();
            let scale = (3.0 / fan_in as f32).sqrt();
            let values = numbers(seed, shape.iter().product());
            if name.ends_with("running_var") {
                return values.iter().map(|v| 1.0 + 0.5 * v).collect();
            }
            values.iter().map(|v| v * scale).collect()
        };
        MvDust3r::new(config, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    /// Images (views, batch, 3, height, width) of 32 x 48 pixels.
    fn images(views: usize, batch: usize) -> Tensor {
        let shape = [views, batch, 3, 32, 48];
        Tensor::from_vec(numbers(1, shape.iter().product()), &shape, &Device::Cpu).unwrap()
    }

    fn points(network: &MvDust3r, images: &Tensor) -> Vec<Tensor> {
        let outputs = network
            .forward(images, &Options::default(), &mut Unobserved)
            .unwrap();
        outputs[0].iter().map(|view| view.points.clone()).collect()
    }

    fn assert_close(a: &Tensor, b: &Tensor) {
        let largest = |x: &Tensor| {
            x.abs()
                .unwrap()
                .max_all()
                .unwrap()
                .to_scalar::<f32>()
                .unwrap()
        };
        let difference = largest(&(a - b).unwrap());
        assert!(difference < 1e-4 * largest(b).max(1.0), "{difference}");
    }

    #[test]
    fn exchanging_views_that_are_no_references_exchanges_their_outputs_alone() {
        for references in [1, 2] {
            let network = network(&config(references));
            let images = images(4, 1);
            let exchanged = images
                .index_select(&Tensor::new(&[0_u32, 1, 3, 2], &Device::Cpu).unwrap(), 0)
                .unwrap();
            let (before, after) = (points(&network, &images), points(&network, &exchanged));
            for (view, other) in [(0, 0), (1, 1), (2, 3), (3, 2)] {
                assert_close(&after[other], &before[view]);
            }
            // Which view is the reference does matter.
            let exchanged = images
                .index_select(&Tensor::new(&[1_u32, 0, 2, 3], &Device::Cpu).unwrap(), 0)
                .unwrap();
            let difference = (&points(&network, &exchanged)[2] - &before[2]).unwrap();
            let sum = difference.abs().unwrap().sum_all().unwrap();
            assert!(sum.to_scalar::<f32>().unwrap() > 1e-3);
        }
    }

    #[test]
    fn scenes_of_a_batch_are_independent() {
        let network = network(&config(2));
        let images = images(3, 2);
        let together = points(&network, &images);
        for scene in 0..2 {
            let alone = points(&network, &images.narrow(1, scene, 1).unwrap());
            for (alone, together) in alone.iter().zip(&together) {
                assert_close(alone, &together.narrow(0, scene, 1).unwrap());
            }
        }
    }

    #[test]
    fn what_the_network_cannot_take_is_refused() {
        let network = network(&config(3));
        let refused = |images: &Tensor, options: Options| {
            let error = network
                .forward(images, &options, &mut Unobserved)
                .unwrap_err();
            error.to_string()
        };
        let message = refused(&images(2, 1), Options::default());
        assert!(message.contains("at least 3 views"), "{message}");
        let odd = Tensor::zeros((3, 1, 3, 32, 40), DType::F32, &Device::Cpu).unwrap();
        let message = refused(&odd, Options::default());
        assert!(message.contains("multiples of 16"), "{message}");
        let grey = Tensor::zeros((3, 1, 1, 32, 32), DType::F32, &Device::Cpu).unwrap();
        let message = refused(&grey, Options::default());
        assert!(message.contains("3 colours"), "{message}");
        let options = Options {
            skip: SkipOptions {
                statistics: Statistics::Batch,
                ..SkipOptions::default()
            },
            ..Options::default()
        };
        assert!(refused(&images(3, 1), options).contains("all paths"));
    }

    #[test]
    fn a_missing_weight_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty.safetensors");
        std::fs::write(&path, [&2_u64.to_le_bytes()[..], b"{}"].concat()).unwrap();
        let weights = Weights::open(&path, &Device::Cpu).unwrap();
        let error = MvDust3r::new(&config(1), &weights).unwrap_err().to_string();
        assert!(error.contains("patch_embed.proj.weight"), "{error}");
        assert!(error.contains("empty.safetensors"), "{error}");
    }
}
