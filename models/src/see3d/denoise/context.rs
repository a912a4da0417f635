//! What frames attend to besides each other.

use candle_core::{Result, Tensor, bail};

/// The context (rows, tokens, channels) of `groups * frames` frames, all with the condition before all without: `text`
/// (rows, tokens, channels) are the embeddings of the negative and the positive prompt, or one for both,
/// `image` (channels) that of the first reference.
///
/// If the prompts are the same the context has one row for all. Else it has one for each frame, of the two
/// prompts *in turn*: the original repeats the pair for the frames, while these come by halves, so that a
/// frame's number says which prompt it gets. Without guidance the original takes the positive prompt alone:
/// give it as the only one.
///
/// # Errors
///
/// If there are other numbers of rows or channels.
pub fn context(text: &Tensor, image: &Tensor, groups: usize, frames: usize) -> Result<Tensor> {
    /// Of the image among the words.
    const SHARE: f64 = 0.2;
    let (rows, _, channels) = text.dims3()?;
    if image.dims() != [channels] || !(1..=2).contains(&rows) {
        bail!(
            "embeddings of one or two texts (rows, tokens, channels) and of an image (channels) are \
             wanted, got {:?} and {:?}",
            text.shape(),
            image.shape()
        );
    }
    let all = text.broadcast_add(&(image * SHARE)?)?;
    let first = all.narrow(0, 0, 1)?;
    let differ = match rows {
        1 => false,
        _ => largest(&(all.narrow(0, 1, 1)? - &first)?)? > 0.0,
    };
    match differ {
        false => Ok(first),
        true => all.repeat((groups * frames / 2, 1, 1)),
    }
}

fn largest(x: &Tensor) -> Result<f32> {
    x.abs()?.flatten_all()?.max(0)?.to_scalar()
}
