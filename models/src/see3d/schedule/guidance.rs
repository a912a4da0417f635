//! Guidance without a classifier.

use candle_core::{Result, Tensor};

/// What a network says, exaggerated: `(1 + scale) conditional - scale unconditional`. This is how See3D
/// counts; others say `scale + 1`.
///
/// # Errors
///
/// If shapes differ.
pub fn guided(conditional: &Tensor, unconditional: &Tensor, scale: f64) -> Result<Tensor> {
    (conditional * (1.0 + scale))? - (unconditional * scale)?
}

/// `guided` (frames, ..) with, for each frame, a share `rescale` of it brought to the standard deviation of
/// `conditional` (Lin et al. 2024, section 3.4).
///
/// # Errors
///
/// If shapes differ.
pub fn rescaled(guided: &Tensor, conditional: &Tensor, rescale: f64) -> Result<Tensor> {
    let deviation = |x: &Tensor| x.flatten_from(1)?.var_keepdim(1)?.sqrt();
    let ratio = (deviation(conditional)? / deviation(guided)?)?;
    let factor = ((ratio * rescale)? + (1.0 - rescale))?;
    let mut shape = vec![1; guided.rank()];
    shape[0] = guided.dim(0)?;
    guided.broadcast_mul(&factor.reshape(shape)?)
}
