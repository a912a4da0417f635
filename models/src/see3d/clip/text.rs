//! The text encoder.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, bail};

use super::layer::{Layer, Mask};
use super::{TextConfig, Work};
use crate::nn::LayerNorm;
use crate::{ComputeType, Observer, Parameter, Unobserved, Weights};

/// CLIP's text encoder (`CLIPTextModel`): its last hidden state, after the final norm.
#[derive(Clone, Debug)]
pub struct TextEncoder {
    config: TextConfig,
    /// (vocabulary, channels).
    token_embedding: Parameter,
    /// (positions, channels).
    position_embedding: Parameter,
    layers: Vec<Layer>,
    final_layer_norm: LayerNorm,
}

impl TextEncoder {
    /// Reads `text_model` from `weights`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &TextConfig, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, eps) = (config.hidden_size, config.layer_norm_eps);
        let model = weights.pp("text_model");
        let embeddings = model.pp("embeddings");
        let positions = config.max_position_embeddings;
        // A few rows of it are looked up, so it stays in the file.
        let token_embedding = (embeddings.pp("token_embedding").in_type(ComputeType::F32))
            .get_stored([config.vocab_size, channels], "weight")?;
        Ok(Self {
            config: config.clone(),
            token_embedding,
            position_embedding: (embeddings.pp("position_embedding"))
                .get([positions, channels], "weight")?,
            layers: Layer::all(config.stack(), Mask::Causal, &model.pp("encoder"))?,
            final_layer_norm: LayerNorm::new(channels, eps, &model.pp("final_layer_norm"))?,
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &TextConfig) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// The configuration.
    pub fn config(&self) -> &TextConfig {
        &self.config
    }

    /// What each token of the texts `ids` (batch, tokens) of u32 means after those before it: (batch,
    /// tokens, channels). Padding counts as text.
    ///
    /// # Errors
    ///
    /// If `ids` are of another type, there are more tokens than positions, or none, or one is not in the
    /// vocabulary.
    pub fn forward(&self, ids: &Tensor) -> Result<Tensor> {
        self.forward_observed(ids, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown the tokens (batch, tokens, channels) before the first
    /// layer, `hidden_0`, and after each, `hidden_1`, ..
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(&self, ids: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let mut x = self.embed(ids)?;
        let work = Work::of_text(&self.config, x.dim(1)?);
        observer.stage("hidden_0", &|| Ok(x.clone()))?;
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x)?;
            observer.advance(work.layer);
            observer.stage(&format!("hidden_{}", i + 1), &|| Ok(x.clone()))?;
        }
        self.final_layer_norm.forward(&x)?.to_device(&Device::Cpu)
    }

    fn embed(&self, ids: &Tensor) -> Result<Tensor> {
        let positions = self.config.max_position_embeddings;
        let (batch, tokens) = match *ids.dims() {
            [batch, tokens] if ids.dtype() == DType::U32 && (1..=positions).contains(&tokens) => {
                (batch, tokens)
            }
            _ => bail!(
                "numbers of tokens (batch, up to {positions}) of u32 are wanted, got {:?} of {:?}",
                ids.shape(),
                ids.dtype()
            ),
        };
        let vocabulary = self.config.vocab_size;
        let ids = ids.flatten_all()?.to_vec1::<u32>()?;
        if let Some(id) = ids.iter().find(|&&id| id as usize >= vocabulary) {
            bail!(
                "token {id} is not among the {vocabulary} of this text encoder: is the tokenizer another's?"
            );
        }
        let embedded = self.token_embedding.rows(&ids)?;
        let embedded = embedded.reshape((batch, tokens, self.config.hidden_size))?;
        embedded.broadcast_add(&self.position_embedding.tensor()?.narrow(0, 0, tokens)?)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn config() -> TextConfig {
        TextConfig {
            vocab_size: 9,
            hidden_size: 12,
            intermediate_size: 20,
            num_hidden_layers: 2,
            num_attention_heads: 3,
            max_position_embeddings: 6,
            ..TextConfig::default()
        }
    }

    fn network() -> TextEncoder {
        let wave = |name: &str, shape: &[usize]| {
            let value = |i: usize| ((i * 7919 + name.len()) as f32).sin() * 0.3;
            (0..shape.iter().product()).map(value).collect()
        };
        TextEncoder::new(&config(), &Weights::from_fn(wave, &Device::Cpu)).unwrap()
    }

    fn ids(ids: &[u32]) -> Tensor {
        Tensor::from_slice(ids, (1, ids.len()), &Device::Cpu).unwrap()
    }

    #[test]
    fn the_released_network_has_these_tensors() {
        let tensors = TextEncoder::tensors(&TextConfig::released()).unwrap();
        assert_eq!(tensors.len(), 372);
        let count = |shape: &Vec<usize>| shape.iter().product::<usize>();
        assert_eq!(tensors.values().map(count).sum::<usize>(), 340_387_840);
        let name = "text_model.embeddings.position_embedding.weight";
        assert_eq!(tensors[name], [77, 1024]);
    }

    #[test]
    fn tokens_do_not_know_of_later_ones() {
        let network = network();
        let of = |list: &[u32]| {
            let x = network.forward(&ids(list)).unwrap();
            assert_eq!(x.dims(), [1, list.len(), 12]);
            x.squeeze(0).unwrap().to_vec2::<f32>().unwrap()
        };
        let (long, other, short) = (of(&[3, 1, 4, 1, 5]), of(&[3, 1, 4, 8, 0]), of(&[3, 1, 4]));
        for (i, row) in short.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - long[i][j]).abs() < 1e-5);
                assert!((value - other[i][j]).abs() < 1e-5);
            }
        }
        let differ = |i: usize| {
            long[i]
                .iter()
                .zip(&other[i])
                .any(|(a, b)| (a - b).abs() > 1e-3)
        };
        assert!(differ(3) && differ(4));
    }

    #[test]
    fn what_is_no_text_is_refused() {
        let message = |ids: &Tensor| network().forward(ids).unwrap_err().to_string();
        assert!(message(&ids(&[0; 7])).contains("up to 6"));
        assert!(message(&ids(&[])).contains("up to 6"));
        assert!(message(&ids(&[1, 9])).contains("token 9"));
        let floats = Tensor::new(&[[1.0_f32]], &Device::Cpu).unwrap();
        assert!(message(&floats).contains("u32"));
    }
}
