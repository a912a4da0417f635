//! The whole decoder.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, bail};

use super::{Config, MaskDecoder, PromptEncoder, Work};
use crate::{Observer, Weights};

/// The prompt encoder and the mask decoder.
#[derive(Clone, Debug)]
pub struct Decoder {
    config: Config,
    /// That of the weights.
    device: Device,
    prompt_encoder: PromptEncoder,
    mask_decoder: MaskDecoder,
}

/// Which masks are wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// The one that is trained for prompts that leave no doubt, as boxes do.
    #[default]
    Single,
    /// The others: the whole, a part, a part of a part.
    Multi,
}

/// What is wanted of the decoder, and how much it may take at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Which masks are wanted.
    pub output: Output,
    /// Boxes that are worked on at a time; fewer need less memory. Results do not depend on it.
    pub boxes: usize,
}

impl Default for Options {
    /// The single mask; as many boxes at a time as there are threads, each of which takes one, and at
    /// least four. Up to seven, the images of boxes are below 32 MB: what glibc at most keeps for the next
    /// ones. Beyond that they are new memory each time, which is a fifth of all time on two threads.
    fn default() -> Self {
        Self {
            output: Output::Single,
            boxes: rayon::current_num_threads().max(4),
        }
    }
}

/// Masks of some boxes.
#[derive(Clone, Debug)]
pub struct Masks {
    /// Above 0 where the object is, (boxes, masks, 4 height, 4 width): over all of the padded image, with
    /// a quarter of the distance of the embedding's places.
    pub logits: Tensor,
    /// What the decoder thinks is the intersection over union of each mask with the true one, (boxes,
    /// masks).
    pub iou: Tensor,
}

impl Decoder {
    /// Reads `prompt_encoder` and `mask_decoder`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let prompt_encoder = weights.pp("prompt_encoder");
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            prompt_encoder: PromptEncoder::new(&config.prompt_encoder, &prompt_encoder)?,
            mask_decoder: MaskDecoder::new(&config.mask_decoder, &weights.pp("mask_decoder"))?,
        })
    }

    /// The names and shapes of all tensors that a decoder of this configuration reads.
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

    /// The masks of `boxes` in an image.
    ///
    /// `image` is its embedding (1, height, width, channels) by an image encoder. `boxes` (boxes, 4)
    /// are f64: x and y of two corners, in pixels of the padded image, 0 being the middle of the first
    /// pixel.
    ///
    /// `observer` is shown the stages of [`MaskDecoder::forward`], for each chunk of boxes in turn.
    ///
    /// # Errors
    ///
    /// If `image` or `boxes` have another shape or type.
    pub fn forward(
        &self,
        image: &Tensor,
        boxes: &Tensor,
        options: &Options,
        observer: &mut dyn Observer,
    ) -> Result<Masks> {
        let [height, width] = self.config.prompt_encoder.image_embedding_size;
        let channels = self.config.prompt_encoder.embed_dim;
        if image.dims() != [1, height, width, channels] {
            bail!(
                "an embedding (1, {height}, {width}, {channels}) is wanted, got {:?}",
                image.shape()
            );
        }
        // Devices have no tensors of nothing.
        let count = boxes.dims2()?.0;
        if count == 0 {
            let masks = match options.output {
                Output::Single => 1,
                Output::Multi => self.config.mask_decoder.num_multimask_outputs,
            };
            let none = |shape: &[usize]| Tensor::zeros(shape, DType::F32, image.device());
            return Ok(Masks {
                logits: none(&[0, masks, 4 * height, 4 * width])?,
                iou: none(&[0, masks])?,
            });
        }
        let corners = self.prompt_encoder.boxes(boxes)?;
        let image = image.to_device(&self.device)?;
        let image = image.broadcast_add(&self.prompt_encoder.no_mask()?)?;
        let side = (self.mask_decoder).look_at(&image, &self.prompt_encoder.places()?)?;
        let work = Work::new(&self.config);
        observer.advance(work.image);
        let at_once = options.boxes.max(1);
        let (logits, iou) = (0..count)
            .step_by(at_once)
            .map(|start| {
                let corners = corners.narrow(0, start, at_once.min(count - start))?;
                let masks = self.mask_decoder.forward(
                    &side,
                    (height, width),
                    &corners,
                    options.output,
                    observer,
                )?;
                observer.advance(corners.dim(0)? as f64 * work.of_box());
                Ok((
                    masks.logits.to_device(&Device::Cpu)?,
                    masks.iou.to_device(&Device::Cpu)?,
                ))
            })
            .collect::<Result<(Vec<_>, Vec<_>)>>()?;
        Ok(Masks {
            logits: Tensor::cat(&logits, 0)?,
            iou: Tensor::cat(&iou, 0)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use crate::Unobserved;
    use crate::mobilesamv2::decoder::MaskDecoderConfig;

    fn decoder() -> Decoder {
        let mut config = Config::released();
        config.prompt_encoder.embed_dim = 32;
        config.prompt_encoder.image_embedding_size = [5, 7];
        config.mask_decoder = MaskDecoderConfig {
            transformer_dim: 32,
            num_heads: 4,
            mlp_dim: 40,
            iou_head_hidden_dim: 24,
            ..config.mask_decoder
        };
        let make = |name: &str, shape: &[usize]| {
            let seed = name
                .bytes()
                .fold(7.0, |h, b| (h * 1.3 + f32::from(b)) % 100.0);
            let numbers = (0..shape.iter().product()).map(|i: usize| (seed + 7.0 * i as f32).sin());
            let size = (shape[shape.len() - 1] as f32).powf(-0.5);
            match name.contains("norm") {
                true => numbers.map(|x| 1.0 + 0.3 * x).collect(),
                false => numbers.map(|x| x * size).collect(),
            }
        };
        Decoder::new(&config, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn image() -> Tensor {
        let numbers: Vec<f32> = (0..5 * 7 * 32).map(|i| (i as f32 * 0.37).sin()).collect();
        Tensor::from_vec(numbers, (1, 5, 7, 32), &Device::Cpu).unwrap()
    }

    fn boxes(count: usize) -> Tensor {
        let numbers: Vec<f64> = (0..4 * count).map(|i| (i * 997 % 1000) as f64).collect();
        Tensor::from_vec(numbers, (count, 4), &Device::Cpu).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    fn masks(boxes: &Tensor, options: Options) -> Masks {
        let decoder = decoder();
        decoder
            .forward(&image(), boxes, &options, &mut Unobserved)
            .unwrap()
    }

    #[test]
    fn results_depend_on_neither_chunks_nor_threads() {
        let boxes = boxes(5);
        let of = |at_once, threads| {
            let options = Options {
                boxes: at_once,
                ..Options::default()
            };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let masks = pool.build().unwrap().install(|| masks(&boxes, options));
            (flat(&masks.logits), flat(&masks.iou))
        };
        let all = of(8, 1);
        assert_eq!(all.0.len(), 5 * 20 * 28);
        assert!(all.0.iter().any(|&x| x != all.0[0]));
        for (at_once, threads) in [(1, 1), (2, 3), (5, 2), (0, 1)] {
            assert!(of(at_once, threads) == all, "{at_once} {threads}");
        }
    }

    #[test]
    fn the_other_masks_are_others() {
        let options = Options {
            output: Output::Multi,
            ..Options::default()
        };
        let (single, multi) = (
            masks(&boxes(2), Options::default()),
            masks(&boxes(2), options),
        );
        assert_eq!(single.iou.dims(), [2, 1]);
        assert_eq!(multi.logits.dims(), [2, 3, 20, 28]);
        assert_eq!(multi.iou.dims(), [2, 3]);
        let first = flat(&single.logits.get(0).unwrap());
        for mask in 0..3 {
            let other = multi.logits.get(0).unwrap().get(mask).unwrap();
            assert_ne!(flat(&other), first);
        }
    }

    #[test]
    fn no_boxes_have_no_masks() {
        let none = masks(&boxes(0), Options::default());
        assert_eq!(none.logits.dims(), [0, 1, 20, 28]);
        assert_eq!(none.iou.dims(), [0, 1]);
    }

    #[test]
    fn other_images_are_refused() {
        let image = image().narrow(1, 0, 4).unwrap();
        let options = Options::default();
        let error = decoder()
            .forward(&image, &boxes(1), &options, &mut Unobserved)
            .unwrap_err()
            .to_string();
        assert!(error.contains("(1, 5, 7, 32)"), "{error}");
    }
}
