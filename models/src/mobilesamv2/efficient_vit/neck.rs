//! The neck.

use candle_core::{Result, Tensor};

use super::blocks::{FusedMbConv, Sizes, normed};
use super::{Config, Work};
use crate::nn::{Activation, Conv2d, resize_bicubic};
use crate::{Observer, Weights};

/// Brings the last three stages to one grid, adds them, and works on the sum (`SamNeck`).
#[derive(Clone, Debug)]
pub(super) struct Neck {
    /// For stages 4, 3 and 2.
    inputs: [Conv2d; 3],
    middle: Vec<FusedMbConv>,
    output: Conv2d,
}

/// Which stages the neck works on, in the order of its inputs.
pub(super) const STAGES: [usize; 3] = [4, 3, 2];

impl Neck {
    /// Rows and columns of the grid.
    pub(super) const SIDE: usize = 64;

    /// Reads `input_ops`, `middle` and `output_ops` from `weights`.
    pub(super) fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let (channels, eps) = (config.head_width, config.norm_eps);
        let input = |i: usize| {
            let weights = weights.pp("input_ops").pp(i).pp("op_list").pp(0);
            normed(
                config.width_list[STAGES[i]],
                channels,
                (1, 1),
                eps,
                &weights,
            )
        };
        let sizes = Sizes::same(channels, config.expand_ratio);
        let middle = |i: usize| {
            let weights = weights.pp("middle").pp("op_list").pp(i).pp("main");
            FusedMbConv::new(sizes, eps, &weights)
        };
        let output = weights
            .pp("output_ops")
            .pp(0)
            .pp("op_list")
            .pp(0)
            .pp("conv");
        Ok(Self {
            inputs: [input(0)?, input(1)?, input(2)?],
            middle: (0..config.head_depth).map(middle).collect::<Result<_>>()?,
            output: Conv2d::new(channels, config.out_dim, 1, &output)?.laid_out()?,
        })
    }

    /// From what each stage made, (batch, 64, 64, out_dim). `observer` is shown `neck_in0`, `neck_in1`,
    /// `neck_in2` and `neck_middle`.
    pub(super) fn forward(
        &self,
        stages: &[Tensor],
        work: &Work,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let mut input = |i: usize| {
            let input = self.inputs[i].forward(&stages[STAGES[i]], Activation::Identity)?;
            let input = resize_bicubic(&input, Self::SIDE, Self::SIDE)?;
            observer.stage(&format!("neck_in{i}"), &|| Ok(input.clone()))?;
            Ok::<_, candle_core::Error>(input)
        };
        // In this order, as the original adds them.
        let mut x = (input(0)? + (input(1)? + input(2)?)?)?;
        observer.advance(work.neck_ends);
        for block in &self.middle {
            x = block.forward_add(&x)?;
            observer.advance(work.neck_block);
        }
        observer.stage("neck_middle", &|| Ok(x.clone()))?;
        self.output.forward(&x, Activation::Identity)
    }
}
