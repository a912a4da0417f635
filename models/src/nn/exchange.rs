//! Few tokens and many places of an image that attend to each other.

use candle_core::{Device, Result, Tensor, bail};

use super::LayerNorm;
use super::attention::softmax;
use super::cpu::{self, ExchangeInputs, HostTensor, Isa};

/// What tokens say to whatever attends to them.
///
/// Projections are brought over to the tokens ([`super::Linear::pull_back`],
/// [`super::Linear::shares`]), so that places of the image need none.
#[derive(Clone, Debug)]
pub struct Told {
    /// A place `x` has the score `x keys + offsets` with each token, (boxes, tokens, heads, channels).
    pub keys: Tensor,
    /// (boxes, tokens, heads).
    pub offsets: Tensor,
    /// What a place receives of a token if it has all the weight, (boxes, tokens, heads, channels).
    pub values: Tensor,
    /// What every place receives, (channels).
    pub bias: Tensor,
}

/// Lets every place of an image attend to tokens, then tokens to the image.
///
/// For each box, the places `x` of `image` (1 or boxes, places, channels) become
///
/// ```text
/// y = norm(x + bias + sum over heads, tokens of softmax over tokens((x + e) keys + offsets) values)
/// ```
///
/// with `e` their `encoding` (places, channels), and the result for `asked` (boxes, tokens, heads,
/// channels) is
///
/// ```text
/// found = sum over places of softmax over places((y + e) asked) y
/// ```
///
/// Returns `y` (boxes, places, channels) and `found`, of the shape of `asked`.
///
/// # Errors
///
/// If the shapes do not fit each other.
pub fn exchange(
    image: &Tensor,
    encoding: &Tensor,
    told: &Told,
    norm: &LayerNorm,
    asked: &Tensor,
) -> Result<(Tensor, Tensor)> {
    let (boxes, tokens, heads, channels) = told.keys.dims4()?;
    let (places, width) = encoding.dims2()?;
    let of_told = [&told.keys, &told.values, asked].map(|x| x.dims());
    if of_told != [&[boxes, tokens, heads, channels]; 3]
        || told.offsets.dims() != [boxes, tokens, heads]
        || told.bias.dims() != [channels]
        || ![1, boxes].contains(&image.dim(0)?)
        || image.dims()[1..] != [places, channels]
        || width != channels
        || norm.weight.shape() != [channels]
    {
        bail!(
            "tokens {of_told:?}, an image {:?} and its encoding {:?} do not fit each other",
            image.shape(),
            encoding.shape()
        );
    }
    let tensors = [
        image,
        encoding,
        &told.keys,
        &told.offsets,
        &told.values,
        &told.bias,
        asked,
    ];
    match norm.weight.host() {
        Some(_) if tensors.iter().all(|x| HostTensor::fits(x)) => {
            by_kernel(Isa::current()?, image, encoding, told, norm, asked)
        }
        _ => plain(image, encoding, told, norm, asked),
    }
}

/// The exchange of tensors in the CPU's memory that fit each other.
fn by_kernel(
    isa: Isa,
    image: &Tensor,
    encoding: &Tensor,
    told: &Told,
    norm: &LayerNorm,
    asked: &Tensor,
) -> Result<(Tensor, Tensor)> {
    let (boxes, tokens, heads, channels) = told.keys.dims4()?;
    let tensors = [
        image,
        encoding,
        &told.keys,
        &told.offsets,
        &told.values,
        &told.bias,
        &(asked * (channels as f64).sqrt())?,
    ];
    let tensors: Vec<Tensor> = tensors
        .iter()
        .map(|x| x.contiguous())
        .collect::<Result<_>>()?;
    let hosts: Vec<HostTensor<'_>> = tensors.iter().map(HostTensor::new).collect::<Result<_>>()?;
    let numbers = |i: usize| -> Result<&[f32]> { Ok(&hosts[i].data()?[..tensors[i].elem_count()]) };
    let inputs = ExchangeInputs {
        image: numbers(0)?,
        encoding: numbers(1)?,
        keys: numbers(2)?,
        offsets: numbers(3)?,
        values: numbers(4)?,
        bias: numbers(5)?,
        norm: [&norm.weight, &norm.bias].map(|x| x.host().unwrap_or_default()),
        eps: norm.eps,
        asked: numbers(6)?,
        tokens,
        heads,
    };
    let (places, found) = cpu::exchange(isa, inputs)?;
    let shape = (boxes, encoding.dim(0)?, channels);
    Ok((
        Tensor::from_vec(places, shape, &Device::Cpu)?,
        Tensor::from_vec(found, asked.shape(), &Device::Cpu)?,
    ))
}

/// The exchange by candle's own operations.
fn plain(
    image: &Tensor,
    encoding: &Tensor,
    told: &Told,
    norm: &LayerNorm,
    asked: &Tensor,
) -> Result<(Tensor, Tensor)> {
    let (boxes, tokens, heads, channels) = told.keys.dims4()?;
    let places = encoding.dim(0)?;
    let keys = told.keys.reshape((boxes, tokens * heads, channels))?;
    let scores = image
        .broadcast_add(encoding)?
        .broadcast_matmul(&keys.t()?)?
        .broadcast_add(&told.offsets.reshape((boxes, 1, tokens * heads))?)?
        .reshape((boxes, places, tokens, heads))?;
    let weights = softmax(&scores, 2)?.reshape((boxes, places, tokens * heads))?;
    let received = weights.matmul(&told.values.reshape((boxes, tokens * heads, channels))?)?;
    let image = received.broadcast_add(&told.bias)?.broadcast_add(image)?;
    let image = norm.forward(&image)?;
    let rows = asked.reshape((boxes, (), channels))?;
    let scores = rows.matmul(&image.broadcast_add(encoding)?.t()?)?;
    let found = softmax(&scores, 2)?.matmul(&image)?;
    Ok((image, found.reshape(asked.shape())?))
}

#[cfg(test)]
mod tests {
    use candle_core::DType;
    use proptest::prelude::*;

    use super::*;
    use crate::Weights;

    /// Numbers around 0, as far apart as `size`.
    fn tensor(size: f32, shape: &[usize]) -> Tensor {
        Tensor::randn(0.0_f32, size, shape, &Device::Cpu).unwrap()
    }

    fn norm(channels: usize) -> LayerNorm {
        let make = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        LayerNorm::new(channels, 1e-5, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn told(size: f32, shape: &[usize; 4]) -> Told {
        Told {
            keys: tensor(size, shape),
            offsets: tensor(1.0, &shape[..3]),
            values: tensor(1.0, shape),
            bias: tensor(1.0, &shape[3..]),
        }
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    proptest! {
        #[test]
        fn as_by_candle(
            boxes in 1_usize..4,
            shared: bool,
            places in 1_usize..150,
            tokens in 1_usize..9,
            heads in 1_usize..5,
            channels in 2_usize..70,
        ) {
            let shape = [boxes, tokens, heads, channels];
            let size = (channels as f32).powf(-0.5);
            let told = told(size, &shape);
            let asked = tensor(size, &shape);
            let images = if shared { 1 } else { boxes };
            let image = tensor(1.0, &[images, places, channels]);
            let encoding = tensor(1.0, &[places, channels]);
            let norm = norm(channels);
            let want = plain(&image, &encoding, &told, &norm, &asked).unwrap();
            for isa in Isa::available() {
                let got = by_kernel(isa, &image, &encoding, &told, &norm, &asked).unwrap();
                for (got, want) in [(&got.0, &want.0), (&got.1, &want.1)] {
                    prop_assert_eq!(got.dims(), want.dims());
                    for (got, want) in flat(got).iter().zip(flat(want)) {
                        // Of two channels, nearly equal ones are far apart once normalised.
                        let bound = if channels < 8 { 1e-1 } else { 1e-3 };
                        prop_assert!((got - want).abs() < bound, "{isa}: {got} {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn by_hand() {
        // With one token, all weight is on it: every place receives 4 + 1 and 0 + 1, and becomes 10 and 2, or
        // 2 and 6; normalised, plus or minus one. With the encoding, their second channels are -1 and 1.5,
        // their scores -0.4 ln(3) and 0.6 ln(3): the second has three times the weight.
        let of = |numbers: &[f32], shape: &[usize]| {
            Tensor::from_slice(numbers, shape, &Device::Cpu).unwrap()
        };
        let told = Told {
            keys: of(&[1.0, 2.0], &[1, 1, 1, 2]),
            offsets: of(&[3.0], &[1, 1, 1]),
            values: of(&[4.0, 0.0], &[1, 1, 1, 2]),
            bias: of(&[1.0, 1.0], &[2]),
        };
        let image = of(&[5.0, 1.0, -3.0, 5.0], &[1, 2, 2]);
        let encoding = of(&[0.0, 0.0, 0.0, 0.5], &[2, 2]);
        let make = |name: &str, _: &[usize]| match name {
            "weight" => vec![1.0; 2],
            _ => vec![0.0; 2],
        };
        let norm = LayerNorm::new(2, 0.0, &Weights::from_fn(make, &Device::Cpu)).unwrap();
        let asked = of(&[0.0, 0.4 * 3.0_f32.ln()], &[1, 1, 1, 2]);
        let (image, found) = exchange(&image, &encoding, &told, &norm, &asked).unwrap();
        assert_eq!(flat(&image), [1.0, -1.0, -1.0, 1.0]);
        for (got, want) in flat(&found).iter().zip([-0.5, 0.5]) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn great_scores_do_not_overflow() {
        let shape = [1, 3, 2, 16];
        let image = tensor(1.0, &[1, 50, 16]);
        let encoding = Tensor::zeros((50, 16), DType::F32, &Device::Cpu).unwrap();
        let (told, asked) = (told(1e4, &shape), tensor(1e4, &shape));
        let (image, found) = exchange(&image, &encoding, &told, &norm(16), &asked).unwrap();
        for x in [flat(&image), flat(&found)].concat() {
            assert!(x.is_finite());
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let of = |image: [usize; 3], encoding: [usize; 2], asked: [usize; 4], channels| {
            let told = told(1.0, &[2, 3, 4, 8]);
            let (image, encoding) = (tensor(1.0, &image), tensor(1.0, &encoding));
            exchange(
                &image,
                &encoding,
                &told,
                &norm(channels),
                &tensor(1.0, &asked),
            )
        };
        assert!(of([1, 5, 8], [5, 8], [2, 3, 4, 8], 8).is_ok());
        assert!(of([2, 5, 8], [5, 8], [2, 3, 4, 8], 8).is_ok());
        assert!(of([3, 5, 8], [5, 8], [2, 3, 4, 8], 8).is_err());
        assert!(of([1, 5, 8], [6, 8], [2, 3, 4, 8], 8).is_err());
        assert!(of([1, 5, 7], [5, 7], [2, 3, 4, 8], 8).is_err());
        assert!(of([1, 5, 8], [5, 8], [2, 3, 4, 7], 8).is_err());
        assert!(of([1, 5, 8], [5, 8], [2, 3, 4, 8], 9).is_err());
    }
}
