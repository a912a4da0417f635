//! Attention with a cost linear in the number of tokens.

use candle_core::{Result, Tensor, bail};

use super::cpu::{self, HostTensor, Isa};

/// `relu(q) (relu(k)^T v) / (relu(q) sum(relu(k)) + eps)` for each head, over all pixels of an image (Cai et
/// al. 2023, equation 2).
///
/// Each of `parts` is (batch, height, width, channels): queries, keys and values of a head, `dim`
/// channels each, lie side by side, head after head. The result (batch, height, width, heads * dim) has
/// the heads of all parts, in their order. In f32 everywhere.
///
/// # Errors
///
/// If there are no parts, or the shapes do not fit each other or `dim`.
pub fn linear_attention(parts: &[&Tensor], dim: usize, eps: f32) -> Result<Tensor> {
    let Some(first) = parts.first() else {
        bail!("there is nothing to attend to");
    };
    let (batch, height, width, _) = first.dims4()?;
    for part in parts {
        let (b, h, w, channels) = part.dims4()?;
        if (b, h, w) != (batch, height, width) {
            bail!(
                "{:?} and {:?} are of different images",
                first.shape(),
                part.shape()
            );
        }
        if dim == 0 || !channels.is_multiple_of(3 * dim) {
            bail!("{channels} channels are no queries, keys and values of {dim}");
        }
    }
    match parts.iter().all(|part| HostTensor::fits(part)) {
        true => cpu::linear_attention(Isa::current()?, parts, dim, eps),
        false => plain(parts, dim, eps),
    }
}

/// The same by candle's own operations.
fn plain(parts: &[&Tensor], dim: usize, eps: f32) -> Result<Tensor> {
    let gathered = parts.iter().map(|part| {
        let (batch, height, width, channels) = part.dims4()?;
        let heads = channels / (3 * dim);
        let by_head = part
            .contiguous()?
            .reshape((batch, height * width, heads, 3 * dim))?
            .transpose(1, 2)?;
        let of = |i: usize| by_head.narrow(3, i * dim, dim)?.contiguous();
        let (q, k, v) = (of(0)?.relu()?, of(1)?.relu()?, of(2)?);
        let values = q.matmul(&k.t()?.contiguous()?.matmul(&v)?)?;
        let weights = q.matmul(&k.sum_keepdim(2)?.t()?.contiguous()?)?;
        values
            .broadcast_div(&(weights + f64::from(eps))?)?
            .transpose(1, 2)?
            .contiguous()?
            .reshape((batch, height, width, heads * dim))
    });
    Tensor::cat(&gathered.collect::<Result<Vec<_>>>()?, 3)
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    const EPS: f32 = 1e-15;

    #[test]
    fn by_hand() {
        // One head of one channel, three pixels (q, k, v): negative queries and keys count as 0.
        let pixels = [1.0_f32, 2.0, 10.0, 3.0, 6.0, 2.0, -1.0, -5.0, 7.0];
        let x = Tensor::from_slice(&pixels, (1, 1, 3, 3), &Device::Cpu).unwrap();
        let y = linear_attention(&[&x, &(&x * 2.0).unwrap()], 1, EPS).unwrap();
        assert_eq!(y.dims(), [1, 1, 3, 2]);
        // (2 * 10 + 6 * 2) / (2 + 6) for whoever has a query at all.
        let y = y.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(y, [4.0, 8.0, 4.0, 8.0, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn as_by_candle(
            batch in 1_usize..3,
            width in 1_usize..30,
            heads in prop::collection::vec(0_usize..4, 1..3),
            dim in 1_usize..40,
        ) {
            let part = |&heads: &usize| {
                // Not at the start of its storage, and not contiguous.
                let shape = (batch, 3, width, heads * 3 * dim + 2);
                let x = Tensor::randn(0.1_f32, 1.0, shape, &Device::Cpu).unwrap();
                x.narrow(3, 1, heads * 3 * dim).unwrap()
            };
            let parts: Vec<Tensor> = heads.iter().map(part).collect();
            let parts: Vec<&Tensor> = parts.iter().collect();
            let want = plain(&parts, dim, EPS).unwrap();
            for isa in Isa::available() {
                let got = cpu::linear_attention(isa, &parts, dim, EPS).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                let flat = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    let bound = 1e-5 * (1.0 + want.abs());
                    prop_assert!((got - want).abs() < bound, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let zeros =
            |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap();
        let x = zeros(&[1, 2, 3, 12]);
        assert!(linear_attention(&[], 2, EPS).is_err());
        assert!(linear_attention(&[&x], 0, EPS).is_err());
        assert!(linear_attention(&[&x], 3, EPS).is_err());
        assert!(linear_attention(&[&x, &zeros(&[1, 2, 2, 12])], 2, EPS).is_err());
        assert!(linear_attention(&[&zeros(&[2, 3, 12])], 2, EPS).is_err());
        assert!(linear_attention(&[&zeros(&[1, 0, 3, 12])], 2, EPS).is_ok());
    }
}
