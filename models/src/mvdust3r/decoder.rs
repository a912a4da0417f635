//! The decoder: views exchange what they know.

use candle_core::{Result, Tensor, bail};

use super::{Config, Observer, Paths, Work};
use crate::Weights;
use crate::nn::{DecoderBlock, LayerNorm, Linear, Memory, NORM_EPS, Rope2d, Rotation};

/// The decoder of MV-DUSt3R and MV-DUSt3R+.
///
/// A *path* is one state of all views, seen from a reference view of its own. MV-DUSt3R has one
/// path, with view 0 as its reference. In MV-DUSt3R+ the first views are the references of a path
/// each, and after every layer each view looks at itself in the other paths.
///
/// All views are updated at once, from the previous layer's tokens. What a block's queries attend to
/// depends on (block, view) only, so it is made once for each view, not for each pair of views.
#[derive(Clone, Debug)]
pub struct Decoder {
    embed: Linear,
    rope: Rope2d,
    layers: Vec<Layer>,
    norm: LayerNorm,
    config: Config,
}

#[derive(Clone, Debug)]
struct Layer {
    /// For the reference view of a path (`dec_blocks`).
    reference: DecoderBlock,
    /// For all its other views (`dec_blocks2`).
    other: DecoderBlock,
    /// For a view and its likes in the other paths (`dec_same_view_blocks`).
    same_view: Option<DecoderBlock>,
}

/// The tokens of all paths: `[path][view]`, each (batch, tokens, channels).
type PathTokens = Vec<Vec<Tensor>>;

impl Decoder {
    /// Reads `decoder_embed`, `dec_blocks`, `dec_blocks2`, `dec_same_view_blocks` (MV-DUSt3R+) and
    /// `dec_norm` from `weights`, those of the network.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, heads) = (config.dec_embed_dim, config.dec_num_heads);
        let block = |kind: &str, layer: usize| {
            let weights = weights.pp(kind).pp(layer);
            DecoderBlock::new(channels, heads, config.mlp_ratio * channels, &weights)
        };
        let layer = |i| {
            Ok(Layer {
                reference: block("dec_blocks", i)?,
                other: block("dec_blocks2", i)?,
                same_view: (config.m_ref_flag)
                    .then(|| block("dec_same_view_blocks", i))
                    .transpose()?,
            })
        };
        Ok(Self {
            embed: Linear::new(config.enc_embed_dim, channels, &weights.pp("decoder_embed"))?,
            rope: Rope2d::new(channels / heads, config.pos_embed.base)?,
            layers: (0..config.dec_depth).map(layer).collect::<Result<_>>()?,
            norm: LayerNorm::new(channels, NORM_EPS, &weights.pp("dec_norm"))?,
            config: config.clone(),
        })
    }

    /// The tokens `[path][view]` (batch, tokens, decoder channels) of the encoder's tokens of each
    /// view (batch, tokens, encoder channels), whose patches are at `positions`.
    ///
    /// With [`Paths::First`] there is one path in the result, the same as with [`Paths::All`]: the
    /// others are worked on as far as the first looks at them. Products with weights take `rows`
    /// tokens at a time.
    ///
    /// # Errors
    ///
    /// If there are fewer than two views or fewer than references, or tokens of other shapes than
    /// these weights and positions.
    pub fn forward(
        &self,
        encoded: &[Tensor],
        positions: &[[u32; 2]],
        paths: Paths,
        rows: usize,
        observer: &mut dyn Observer,
    ) -> Result<PathTokens> {
        let references = self.config.references();
        let least = references.max(2);
        if encoded.len() < least {
            bail!("at least {least} views are needed, got {}", encoded.len());
        }
        let rotation = self.rope.rotation(positions, encoded[0].device())?;
        let embedded = encoded
            .iter()
            .map(|tokens| self.embed.forward(tokens, crate::nn::Activation::Identity))
            .collect::<Result<Vec<_>>>()?;
        observer.stage("decoder_embed", &|| Tensor::stack(&embedded, 0))?;
        let mut tokens = vec![embedded; references];
        for (i, layer) in self.layers.iter().enumerate() {
            let wanted = match paths {
                Paths::First if i + 1 == self.layers.len() => 1,
                _ => references,
            };
            tokens = if i == 0 {
                layer.first_exchange(&tokens, &rotation, rows)?
            } else {
                layer.exchange(&tokens, wanted, &rotation, rows)?
            };
            if layer.same_view.is_some() {
                observer.stage(&format!("dec_{i}_cross"), &|| stacked(&tokens))?;
                tokens = layer.compare_paths(&tokens, wanted, &rotation, rows)?;
            }
            tokens.truncate(wanted);
            observer.stage(&format!("dec_{i}"), &|| match references {
                1 => Tensor::stack(&tokens[0], 0),
                _ => stacked(&tokens),
            })?;
            let (batch, patches, _) = tokens[0][0].dims3()?;
            let work = Work::decoder_layer(&self.config, i, patches, encoded.len(), paths);
            observer.advance(work * batch as f64);
        }
        let normed = |tokens: &Tensor| self.norm.forward(tokens);
        let tokens: PathTokens = tokens
            .iter()
            .map(|views| views.iter().map(normed).collect())
            .collect::<Result<_>>()?;
        observer.stage("dec_norm", &|| by_view(&tokens))?;
        Ok(tokens)
    }
}

impl Layer {
    /// [`Self::exchange`] while all paths still hold the same tokens: what a view becomes in the
    /// paths whose reference it is not is the same in all of them.
    fn first_exchange(
        &self,
        tokens: &PathTokens,
        rotation: &Rotation,
        rows: usize,
    ) -> Result<PathTokens> {
        let (views, references) = (&tokens[0], tokens.len());
        let memories = self.other.memories(views, rotation, rows)?;
        // With one path, nobody needs view 0 as a view that is no reference.
        let first = usize::from(references == 1);
        let lists: Vec<_> = (first..views.len())
            .map(|view| without(&memories, view))
            .collect();
        let mut others = self
            .other
            .forward(&views[first..], rotation, &lists, rows)?;
        if first == 1 {
            others.insert(0, views[0].clone());
        }
        let memories = self.reference.memories(views, rotation, rows)?;
        let lists: Vec<_> = (0..references).map(|r| without(&memories, r)).collect();
        let own = self
            .reference
            .forward(&views[..references], rotation, &lists, rows)?;
        let path = |(r, own): (usize, Tensor)| {
            let mut views = others.clone();
            views[r] = own;
            views
        };
        Ok(own.into_iter().enumerate().map(path).collect())
    }

    /// Within each path, every view looks at all other views of the path.
    fn exchange(
        &self,
        tokens: &PathTokens,
        wanted: usize,
        rotation: &Rotation,
        rows: usize,
    ) -> Result<PathTokens> {
        // Paths that nobody wants are needed all the same if the wanted ones look at them.
        let paths = match self.same_view {
            Some(_) => tokens.len(),
            None => wanted,
        };
        let mut exchanged = Vec::with_capacity(paths);
        for (r, views) in tokens[..paths].iter().enumerate() {
            let memories = self.other.memories(views, rotation, rows)?;
            let is_other = |view: &usize| *view != r;
            let lists: Vec<_> = (0..views.len())
                .filter(is_other)
                .map(|view| without(&memories, view))
                .collect();
            let others = without(views, r);
            let mut updated = self.other.forward(&others, rotation, &lists, rows)?;
            let memories = self.reference.memories(&others, rotation, rows)?;
            let own = self
                .reference
                .forward(&views[r..=r], rotation, &[memories], rows)?;
            updated.splice(r..r, own);
            exchanged.push(updated);
        }
        Ok(exchanged)
    }

    /// Each view in each of the `wanted` paths looks at itself in all other paths.
    fn compare_paths(
        &self,
        tokens: &PathTokens,
        wanted: usize,
        rotation: &Rotation,
        rows: usize,
    ) -> Result<PathTokens> {
        let Some(block) = &self.same_view else {
            return Ok(tokens.clone());
        };
        let memories = tokens
            .iter()
            .map(|views| block.memories(views, rotation, rows))
            .collect::<Result<Vec<_>>>()?;
        let path = |r: usize| {
            let lists: Vec<Vec<Memory>> = (0..tokens[r].len())
                .map(|view| {
                    let of_view = memories.iter().map(|path| path[view].clone());
                    without(&of_view.collect::<Vec<_>>(), r)
                })
                .collect();
            block.forward(&tokens[r], rotation, &lists, rows)
        };
        (0..wanted).map(path).collect()
    }
}

/// All but the item at `index`.
fn without<T: Clone>(items: &[T], index: usize) -> Vec<T> {
    let others = items.iter().enumerate().filter(|(i, _)| *i != index);
    others.map(|(_, item)| item.clone()).collect()
}

/// (paths, views, batch, tokens, channels).
fn stacked(tokens: &PathTokens) -> Result<Tensor> {
    let paths = tokens.iter().map(|views| Tensor::stack(views, 0));
    Tensor::stack(&paths.collect::<Result<Vec<_>>>()?, 0)
}

/// (views, batch * paths, tokens, channels), paths innermost.
fn by_view(tokens: &PathTokens) -> Result<Tensor> {
    stacked(tokens)?.permute((1, 2, 0, 3, 4))?.flatten(1, 2)
}
