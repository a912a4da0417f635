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

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn largest_difference(a: &Tensor, b: &Tensor) -> f32 {
        largest(&(a - b).unwrap()).unwrap()
    }

    #[test]
    fn equal_prompts_have_one_row_of_context() {
        let text = Tensor::randn(0.0_f32, 1.0, (2, 5, 8), &Device::Cpu).unwrap();
        let image =
            Tensor::new(&[1.0_f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -5.0], &Device::Cpu).unwrap();
        let row = |i| text.narrow(0, i, 1).unwrap();
        let equal = Tensor::cat(&[row(0), row(0)], 0).unwrap();
        let [one, both] = [row(0), equal].map(|text| context(&text, &image, 2, 3).unwrap());
        assert_eq!(one.dims(), [1, 5, 8]);
        assert_eq!(largest_difference(&one, &both), 0.0);
        let added = (&one - &row(0)).unwrap().get(0).unwrap().get(2).unwrap();
        let want =
            Tensor::new(&[0.2_f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], &Device::Cpu).unwrap();
        assert!(largest_difference(&added, &want) < 1e-6);
        // Different ones take turns, whatever the half.
        let rows = context(&text, &image, 2, 3).unwrap();
        assert_eq!(rows.dims(), [6, 5, 8]);
        for i in 0..6 {
            let own = context(&row(i % 2), &image, 2, 3).unwrap();
            assert_eq!(
                largest_difference(&rows.narrow(0, i, 1).unwrap(), &own),
                0.0
            );
        }
        assert!(context(&text, &image.narrow(0, 0, 7).unwrap(), 2, 3).is_err());
    }
}
