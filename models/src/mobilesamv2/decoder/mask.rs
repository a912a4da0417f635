//! Masks from tokens and an image.

use candle_core::{Result, Tensor};

use super::{ImageSide, MaskDecoderConfig, TwoWayTransformer};
use crate::nn::{Activation, Linear, Upscaling};
use crate::{Observer, Parameter, Weights};

use super::network::{Masks, Output};

/// SAM's mask decoder.
#[derive(Clone, Debug)]
pub struct MaskDecoder {
    transformer: TwoWayTransformer,
    /// (1, channels).
    iou_token: Parameter,
    /// (masks, channels).
    mask_tokens: Parameter,
    output_upscaling: Upscaling,
    /// For each mask.
    output_hypernetworks_mlps: Vec<Mlp>,
    iou_prediction_head: Mlp,
}

/// Affine maps with ReLU between them (the original's `MLP`).
#[derive(Clone, Debug)]
struct Mlp(Vec<Linear>);

impl Mlp {
    /// Reads `layers.<i>`, of which `widths` are the inputs, and after the last its outputs.
    fn new(widths: &[usize], weights: &Weights) -> Result<Self> {
        let layers = weights.pp("layers");
        let layer = |(i, w): (usize, &[usize])| Linear::new(w[0], w[1], &layers.pp(i));
        Ok(Self(
            widths
                .windows(2)
                .enumerate()
                .map(layer)
                .collect::<Result<_>>()?,
        ))
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.clone();
        for (i, layer) in self.0.iter().enumerate() {
            let activation = match i + 1 == self.0.len() {
                true => Activation::Identity,
                false => Activation::Relu,
            };
            x = layer.forward(&x, activation)?;
        }
        Ok(x)
    }
}

impl MaskDecoder {
    /// Reads `transformer`, `iou_token`, `mask_tokens`, `output_upscaling`, `output_hypernetworks_mlps` and
    /// `iou_prediction_head`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &MaskDecoderConfig, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, masks) = (config.transformer_dim, config.masks());
        let hypernetworks = weights.pp("output_hypernetworks_mlps");
        let hypernetwork = |i| {
            let widths = [channels, channels, channels, channels / 8];
            Mlp::new(&widths, &hypernetworks.pp(i))
        };
        let mut iou_widths = vec![config.iou_head_hidden_dim; config.iou_head_depth + 1];
        iou_widths[0] = channels;
        iou_widths[config.iou_head_depth] = masks;
        Ok(Self {
            transformer: TwoWayTransformer::new(config, &weights.pp("transformer"))?,
            iou_token: weights.pp("iou_token").get([1, channels], "weight")?,
            mask_tokens: weights.pp("mask_tokens").get([masks, channels], "weight")?,
            output_upscaling: Upscaling::new(channels, &weights.pp("output_upscaling"))?,
            output_hypernetworks_mlps: (0..masks).map(hypernetwork).collect::<Result<_>>()?,
            iou_prediction_head: Mlp::new(&iou_widths, &weights.pp("iou_prediction_head"))?,
        })
    }

    /// Looks at an image (1, height, width, channels), whose places have this `encoding` (height, width,
    /// channels).
    ///
    /// # Errors
    ///
    /// If the shapes do not fit each other or these weights.
    pub fn look_at(&self, image: &Tensor, encoding: &Tensor) -> Result<ImageSide> {
        let (image, encoding) = (image.flatten(1, 2)?, encoding.flatten(0, 1)?);
        self.transformer.look_at(&image, &encoding)
    }

    /// The masks for boxes, of which `corners` (boxes, 2, channels) are the tokens, in an image of
    /// `size` (height, width).
    ///
    /// `observer` is shown the stages of [`TwoWayTransformer::forward`], and `upscaled` (boxes, channels / 8, 4
    /// height, 4 width).
    ///
    /// # Errors
    ///
    /// If the shapes do not fit these weights.
    pub fn forward(
        &self,
        side: &ImageSide,
        (height, width): (usize, usize),
        corners: &Tensor,
        output: Output,
        observer: &mut dyn Observer,
    ) -> Result<Masks> {
        let (boxes, _, channels) = corners.dims3()?;
        let own = Tensor::cat(&[self.iou_token.tensor()?, self.mask_tokens.tensor()?], 0)?;
        let own = own
            .unsqueeze(0)?
            .broadcast_as((boxes, own.dim(0)?, channels))?;
        let prompts = Tensor::cat(&[&own.contiguous()?, corners], 1)?;
        let (tokens, image) = self.transformer.forward(side, &prompts, observer)?;
        let image = image.reshape((boxes, height, width, channels))?;
        observer.stage("upscaled", &|| {
            self.output_upscaling.forward(&image)?.permute((0, 3, 1, 2))
        })?;

        let masks = match output {
            Output::Single => 0..1,
            Output::Multi => 1..self.output_hypernetworks_mlps.len(),
        };
        let vectors = masks
            .clone()
            .map(|mask| {
                let token = tokens.narrow(1, 1 + mask, 1)?;
                self.output_hypernetworks_mlps[mask].forward(&token)
            })
            .collect::<Result<Vec<_>>>()?;
        let vectors = Tensor::cat(&vectors, 1)?;
        let iou = self.iou_prediction_head.forward(&tokens.narrow(1, 0, 1)?)?;
        Ok(Masks {
            logits: self.output_upscaling.products(&image, &vectors)?,
            iou: iou.squeeze(1)?.narrow(1, masks.start, masks.len())?,
        })
    }
}
