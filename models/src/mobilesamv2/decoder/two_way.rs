//! The transformer in which tokens and an image attend to each other.

use candle_core::{Result, Tensor, bail};

use super::MaskDecoderConfig;
use crate::nn::{Activation, LayerNorm, Linear, Memory, Told, attention, exchange};
use crate::{Observer, Weights};

/// Of all layer norms in the transformer.
const NORM_EPS: f64 = 1e-5;

/// Attention of several heads, with projections on all sides (the original's `Attention`).
#[derive(Clone, Debug)]
struct Attention {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    out_proj: Linear,
    heads: usize,
    /// What scores are multiplied with.
    scale: f64,
}

impl Attention {
    /// Reads `q_proj`, `k_proj`, `v_proj` (`channels` to `inner`) and `out_proj` (back).
    fn new(channels: usize, inner: usize, heads: usize, weights: &Weights) -> Result<Self> {
        let inwards = |name| Linear::new(channels, inner, &weights.pp(name));
        Ok(Self {
            q_proj: inwards("q_proj")?,
            k_proj: inwards("k_proj")?,
            v_proj: inwards("v_proj")?,
            out_proj: Linear::new(inner, channels, &weights.pp("out_proj"))?,
            heads,
            scale: (inner as f64 / heads as f64).powf(-0.5),
        })
    }

    /// What queries `q` receive of `k` and `v`, all (batch, tokens, channels).
    fn forward(&self, q: &Tensor, k: &Tensor, v: &Tensor) -> Result<Tensor> {
        let q = self.q_proj.forward(q, Activation::Identity)?;
        let attended = attention(
            &q,
            &[self.memory(k, v)?],
            self.heads,
            self.out_proj.compute_type(),
        )?;
        self.out_proj.forward(&attended, Activation::Identity)
    }

    /// Keys and values.
    fn memory(&self, k: &Tensor, v: &Tensor) -> Result<Memory> {
        Ok(Memory {
            k: self.k_proj.forward(k, Activation::Identity)?,
            v: self.v_proj.forward(v, Activation::Identity)?,
        })
    }

    /// What queries (boxes, tokens, channels) attend to in a memory (1, places, inner channels) that
    /// is the same for all boxes: (boxes, tokens, inner channels).
    fn attend(&self, q: &Tensor, memory: &Memory) -> Result<Tensor> {
        // The tokens of all boxes are as good as those of one.
        let q = self.q_proj.forward(q, Activation::Identity)?;
        let all = attention(
            &q.flatten_to(1)?.unsqueeze(0)?,
            std::slice::from_ref(memory),
            self.heads,
            self.out_proj.compute_type(),
        )?;
        all.reshape(q.shape())
    }

    /// What queries (boxes, tokens, channels) look for in the inputs of keys, for [`exchange`]:
    /// (boxes, tokens, heads, channels).
    ///
    /// The bias of keys adds the same to all scores of a query, which changes no weight.
    fn asked(&self, q: &Tensor) -> Result<Tensor> {
        let q = self.q_proj.forward(q, Activation::Identity)?;
        let (asked, _) = self.k_proj.pull_back(&(q * self.scale)?, self.heads)?;
        Ok(asked)
    }

    /// What queries attend to, (boxes, tokens, inner channels), from weighted sums of the inputs of
    /// values (boxes, tokens, heads, channels).
    fn answered(&self, found: &Tensor) -> Result<Tensor> {
        self.v_proj.forward_by_head(found)
    }

    /// What tokens `k` and `v` (boxes, tokens, channels) say to whatever attends to them.
    fn told(&self, k: &Tensor, v: &Tensor) -> Result<Told> {
        let memory = self.memory(k, v)?;
        let (keys, offsets) = self
            .q_proj
            .pull_back(&(memory.k * self.scale)?, self.heads)?;
        Ok(Told {
            keys,
            offsets,
            values: self.out_proj.shares(&memory.v, self.heads)?,
            bias: self.out_proj.bias_tensor()?,
        })
    }
}

/// A layer of the transformer (the original's `TwoWayAttentionBlock`).
#[derive(Clone, Debug)]
struct Layer {
    self_attn: Attention,
    norm1: LayerNorm,
    cross_attn_token_to_image: Attention,
    norm2: LayerNorm,
    mlp_lin1: Linear,
    mlp_lin2: Linear,
    norm3: LayerNorm,
    cross_attn_image_to_token: Attention,
    norm4: LayerNorm,
}

impl Layer {
    fn new(config: &MaskDecoderConfig, weights: &Weights) -> Result<Self> {
        let (channels, hidden) = (config.transformer_dim, config.mlp_dim);
        let norm = |name| LayerNorm::new(channels, NORM_EPS, &weights.pp(name));
        let attention = |name, inner| {
            let weights = weights.pp(name);
            Attention::new(channels, inner, config.num_heads, &weights)
        };
        let mlp = weights.pp("mlp");
        Ok(Self {
            self_attn: attention("self_attn", channels)?,
            norm1: norm("norm1")?,
            cross_attn_token_to_image: attention("cross_attn_token_to_image", config.inner_dim())?,
            norm2: norm("norm2")?,
            mlp_lin1: Linear::new(channels, hidden, &mlp.pp("lin1"))?,
            mlp_lin2: Linear::new(hidden, channels, &mlp.pp("lin2"))?,
            norm3: norm("norm3")?,
            cross_attn_image_to_token: attention("cross_attn_image_to_token", config.inner_dim())?,
            norm4: norm("norm4")?,
        })
    }

    /// Queries that have attended to each other; `prompts` are the tokens that the transformer got.
    fn self_attend(&self, queries: &Tensor, prompts: &Tensor) -> Result<Tensor> {
        let q = (queries + prompts)?;
        let attended = self.self_attn.forward(&q, &q, queries)?;
        self.norm1.forward(&(queries + attended)?)
    }

    /// The same in the first layer, where queries are the prompts themselves: without encoding, and
    /// without what they were before.
    fn first_self_attend(&self, prompts: &Tensor) -> Result<Tensor> {
        let attended = self.self_attn.forward(prompts, prompts, prompts)?;
        self.norm1.forward(&attended)
    }

    /// Queries that have received what they `attended` to in the image, and thought about it.
    fn receive(
        &self,
        queries: &Tensor,
        attended: &Tensor,
        name: &str,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let out_proj = &self.cross_attn_token_to_image.out_proj;
        observer.stage(&format!("{name}.cross_attn_token_to_image"), &|| {
            out_proj.forward(attended, Activation::Identity)
        })?;
        let queries = self
            .norm2
            .forward(&out_proj.forward_add(attended, queries)?)?;
        let hidden = self.mlp_lin1.forward(&queries, Activation::Relu)?;
        observer.stage(&format!("{name}.mlp"), &|| {
            self.mlp_lin2.forward(&hidden, Activation::Identity)
        })?;
        let queries = self.mlp_lin2.forward_add(&hidden, &queries)?;
        self.norm3.forward(&queries)
    }
}

/// An image, and what there is to know of it before any token.
#[derive(Clone, Debug)]
pub struct ImageSide {
    /// (1, places, channels).
    image: Tensor,
    /// (places, channels).
    encoding: Tensor,
    /// What the first layer's tokens attend to.
    memory: Memory,
}

/// SAM's two-way transformer.
///
/// Few tokens stand against thousands of places for each box, so the projections of places in the
/// attention between them are brought over to the tokens ([`exchange`]): for eight heads and seven
/// tokens, 56 vectors a box, where the original projects 4096 places. In the first layer the image is
/// the same for all boxes, and is projected once.
#[derive(Clone, Debug)]
pub struct TwoWayTransformer {
    layers: Vec<Layer>,
    final_attn_token_to_image: Attention,
    norm_final_attn: LayerNorm,
}

impl TwoWayTransformer {
    /// Reads `layers`, `final_attn_token_to_image` and `norm_final_attn`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &MaskDecoderConfig, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let layer = |i| Layer::new(config, &weights.pp("layers").pp(i));
        Ok(Self {
            layers: (0..config.depth).map(layer).collect::<Result<_>>()?,
            final_attn_token_to_image: Attention::new(
                config.transformer_dim,
                config.inner_dim(),
                config.num_heads,
                &weights.pp("final_attn_token_to_image"),
            )?,
            norm_final_attn: LayerNorm::new(
                config.transformer_dim,
                NORM_EPS,
                &weights.pp("norm_final_attn"),
            )?,
        })
    }

    /// Looks at an image (1, places, channels) whose places have this `encoding` (places, channels).
    ///
    /// # Errors
    ///
    /// If the shapes do not fit each other or these weights.
    pub fn look_at(&self, image: &Tensor, encoding: &Tensor) -> Result<ImageSide> {
        let keys = image.broadcast_add(encoding)?;
        if keys.dims() != image.dims() || image.dim(0)? != 1 {
            bail!(
                "{:?} is no encoding of {:?}",
                encoding.shape(),
                image.shape()
            );
        }
        let attention = &self.layers[0].cross_attn_token_to_image;
        Ok(ImageSide {
            memory: attention.memory(&keys, image)?,
            image: image.clone(),
            encoding: encoding.clone(),
        })
    }

    /// What becomes of `prompts` (boxes, tokens, channels) and, for each box, of the image (boxes,
    /// places, channels).
    ///
    /// `observer` is shown `queries<i>` and `keys<i>`, after layer i, and `tokens_out`; and what attention and
    /// MLP give before it is added to anything: `layer0.self_attn`, `layer<i>.cross_attn_token_to_image`,
    /// `layer<i>.mlp`, `layer<i>.cross_attn_image_to_token`.
    ///
    /// # Errors
    ///
    /// If the shapes do not fit these weights.
    pub fn forward(
        &self,
        side: &ImageSide,
        prompts: &Tensor,
        observer: &mut dyn Observer,
    ) -> Result<(Tensor, Tensor)> {
        let first = &self.layers[0];
        let mut queries = first.first_self_attend(prompts)?;
        observer.stage("layer0.self_attn", &|| {
            first.self_attn.forward(prompts, prompts, prompts)
        })?;
        let mut attended = first
            .cross_attn_token_to_image
            .attend(&(&queries + prompts)?, &side.memory)?;
        let mut image = side.image.clone();
        for (i, layer) in self.layers.iter().enumerate() {
            let name = format!("layer{i}");
            queries = layer.receive(&queries, &attended, &name, observer)?;
            observer.stage(&format!("queries{i}"), &|| Ok(queries.clone()))?;

            let encoded = (&queries + prompts)?;
            let to_tokens = &layer.cross_attn_image_to_token;
            let told = to_tokens.told(&encoded, &queries)?;
            observer.stage(&format!("{name}.cross_attn_image_to_token"), &|| {
                let places = image.broadcast_add(&side.encoding)?;
                let (_, count, channels) = places.dims3()?;
                let places = places.broadcast_as((prompts.dim(0)?, count, channels))?;
                to_tokens.forward(&places, &encoded, &queries)
            })?;
            // Tokens do not look at the image again before they ask the next layer's question.
            let asker = match self.layers.get(i + 1) {
                Some(next) => {
                    queries = next.self_attend(&queries, prompts)?;
                    &next.cross_attn_token_to_image
                }
                None => &self.final_attn_token_to_image,
            };
            let asked = asker.asked(&(&queries + prompts)?)?;
            let (places, found) = exchange(&image, &side.encoding, &told, &layer.norm4, &asked)?;
            image = places;
            attended = asker.answered(&found)?;
            observer.stage(&format!("keys{i}"), &|| Ok(image.clone()))?;
        }
        let out_proj = &self.final_attn_token_to_image.out_proj;
        let queries = out_proj.forward_add(&attended, &queries)?;
        let tokens = self.norm_final_attn.forward(&queries)?;
        observer.stage("tokens_out", &|| Ok(tokens.clone()))?;
        Ok((tokens, image))
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use crate::Unobserved;
    use crate::mobilesamv2::decoder::Config;

    fn config(depth: usize) -> MaskDecoderConfig {
        MaskDecoderConfig {
            transformer_dim: 32,
            depth,
            num_heads: 4,
            mlp_dim: 40,
            ..Config::released().mask_decoder
        }
    }

    /// Random numbers of the size that trained weights have.
    fn weights() -> Weights {
        let make = |name: &str, shape: &[usize]| {
            let size = match name.contains("norm") {
                true => 0.3,
                false => (shape[shape.len() - 1] as f32).powf(-0.5),
            };
            let mean = if name.contains("norm") { 1.0 } else { 0.0 };
            let numbers = Tensor::randn(mean, size, shape, &Device::Cpu).unwrap();
            numbers.flatten_all().unwrap().to_vec1().unwrap()
        };
        Weights::from_fn(make, &Device::Cpu)
    }

    /// The transformer as the original writes it, with every projection where it is there.
    fn as_published(
        transformer: &TwoWayTransformer,
        image: &Tensor,
        encoding: &Tensor,
        prompts: &Tensor,
    ) -> Result<(Tensor, Tensor)> {
        let (boxes, _, channels) = prompts.dims3()?;
        let shape = (boxes, encoding.dim(0)?, channels);
        let encoding = encoding.broadcast_as(shape)?.contiguous()?;
        let mut keys = image.broadcast_as(shape)?.contiguous()?;
        let mut queries = prompts.clone();
        for (i, layer) in transformer.layers.iter().enumerate() {
            queries = match i {
                0 => layer.self_attn.forward(&queries, &queries, &queries)?,
                _ => {
                    let q = (&queries + prompts)?;
                    (&queries + layer.self_attn.forward(&q, &q, &queries)?)?
                }
            };
            queries = layer.norm1.forward(&queries)?;
            let (q, k) = ((&queries + prompts)?, (&keys + &encoding)?);
            let attended = layer.cross_attn_token_to_image.forward(&q, &k, &keys)?;
            queries = layer.norm2.forward(&(queries + attended)?)?;
            let hidden = layer.mlp_lin1.forward(&queries, Activation::Relu)?;
            let thought = layer.mlp_lin2.forward(&hidden, Activation::Identity)?;
            queries = layer.norm3.forward(&(queries + thought)?)?;
            let (q, k) = ((&queries + prompts)?, (&keys + &encoding)?);
            let attended = layer.cross_attn_image_to_token.forward(&k, &q, &queries)?;
            keys = layer.norm4.forward(&(keys + attended)?)?;
        }
        let (q, k) = ((&queries + prompts)?, (&keys + &encoding)?);
        let attended = transformer
            .final_attn_token_to_image
            .forward(&q, &k, &keys)?;
        let queries = transformer
            .norm_final_attn
            .forward(&(queries + attended)?)?;
        Ok((queries, keys))
    }

    fn check(got: &Tensor, want: &Tensor) {
        assert_eq!(got.dims(), want.dims());
        let norm = |x: &Tensor| x.sqr()?.sum_all()?.sqrt()?.to_scalar::<f32>();
        let error = norm(&(got - want).unwrap()).unwrap() / norm(want).unwrap();
        assert!(error < 5e-6, "{error}");
    }

    #[test]
    fn projections_on_the_side_of_tokens_change_nothing() {
        let random = |shape: &[usize]| Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap();
        for depth in [1, 2, 3] {
            let transformer = TwoWayTransformer::new(&config(depth), &weights()).unwrap();
            let (image, encoding) = (random(&[1, 77, 32]), random(&[77, 32]));
            let prompts = random(&[3, 6, 32]);
            let side = transformer.look_at(&image, &encoding).unwrap();
            let got = transformer
                .forward(&side, &prompts, &mut Unobserved)
                .unwrap();
            let want = as_published(&transformer, &image, &encoding, &prompts).unwrap();
            check(&got.0, &want.0);
            check(&got.1, &want.1);
        }
    }
}
