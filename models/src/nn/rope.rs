//! Rotary position embedding on a plane.

use candle_core::{Device, Result, Tensor, bail};

use super::cpu::{self, HostTensor, Isa};

/// RoPE in two dimensions, as CroCo v2 has it (Weinzaepfel et al. 2023, after Su et al. 2021).
///
/// The first half of a head's channels is rotated by the token's row, the second half by its
/// column. Within a half of `2 q` channels, channel `i` and channel `q + i` form a pair (halves,
/// not neighbours), which turns by `position / base^(i / q)` radians.
#[derive(Clone, Debug)]
pub struct Rope2d {
    /// Radians that a pair turns for each step; one for each of the `q` pairs of a half.
    frequencies: Vec<f32>,
}

impl Rope2d {
    /// For heads of `head_dim` channels.
    ///
    /// # Errors
    ///
    /// If `head_dim` is not a multiple of 4 or zero, or `base` is not a positive number.
    pub fn new(head_dim: usize, base: f32) -> Result<Self> {
        if head_dim == 0 || !head_dim.is_multiple_of(4) {
            bail!("RoPE needs a head size that is a multiple of 4, got {head_dim}");
        }
        if !(base > 0.0 && base.is_finite()) {
            bail!("RoPE needs a positive base, got {base}");
        }
        let pairs = head_dim / 4;
        let frequency = |i| 1.0 / base.powf(i as f32 / pairs as f32);
        Ok(Self {
            frequencies: (0..pairs).map(frequency).collect(),
        })
    }

    /// The rotation for tokens at `positions` (row, column), counted in patches from 0.
    ///
    /// # Errors
    ///
    /// If `device` cannot take the tables.
    pub fn rotation(&self, positions: &[[u32; 2]], device: &Device) -> Result<Rotation> {
        let tables = |axis: usize| -> Result<[Tensor; 2]> {
            let angles: Vec<f32> = positions
                .iter()
                .flat_map(|p| self.frequencies.iter().map(move |f| p[axis] as f32 * f))
                .collect();
            let angles =
                Tensor::from_vec(angles, (positions.len(), self.frequencies.len()), device)?;
            Ok([angles.cos()?, angles.sin()?])
        };
        Ok(Rotation {
            rows: tables(0)?,
            columns: tables(1)?,
        })
    }
}

/// [`Rope2d`] for certain positions, shared by all items of a batch and all heads.
#[derive(Clone, Debug)]
pub struct Rotation {
    /// Cosines and sines of the row angles, each (tokens, head_dim / 4).
    rows: [Tensor; 2],
    /// The same of the column angles.
    columns: [Tensor; 2],
}

impl Rotation {
    /// Rotates queries or keys `x` (batch, tokens, heads * head_dim), head after head.
    ///
    /// # Errors
    ///
    /// If the number of tokens or `head_dim` is not that of this rotation.
    pub fn apply(&self, x: &Tensor, heads: usize) -> Result<Tensor> {
        let (_, tokens, channels) = x.dims3()?;
        let (positions, pairs) = self.rows[0].dims2()?;
        if (tokens, channels) != (positions, heads * 4 * pairs) {
            bail!(
                "a rotation of {positions} tokens with {} channels cannot turn {tokens} with {channels}",
                heads * 4 * pairs
            );
        }
        if HostTensor::fits(x) && HostTensor::fits(&self.rows[0]) {
            cpu::rotate(Isa::current()?, x, [&self.rows, &self.columns], heads)
        } else {
            self.plain(x, heads)
        }
    }

    /// The rotation by candle's own operations.
    fn plain(&self, x: &Tensor, heads: usize) -> Result<Tensor> {
        let (batch, tokens, channels) = x.dims3()?;
        let (_, pairs) = self.rows[0].dims2()?;
        let x = x.contiguous()?.reshape((batch, tokens, heads, 4, pairs))?;
        let quarter = |i: usize| x.narrow(3, i, 1)?.squeeze(3);
        let half = |first: usize, [cos, sin]: &[Tensor; 2]| -> Result<[Tensor; 2]> {
            let (u, v) = (quarter(first)?, quarter(first + 1)?);
            let (cos, sin) = (cos.unsqueeze(1)?, sin.unsqueeze(1)?);
            let turned = |a: &Tensor, b: &Tensor| -> Result<(Tensor, Tensor)> {
                Ok((a.broadcast_mul(&cos)?, b.broadcast_mul(&sin)?))
            };
            let (uc, vs) = turned(&u, &v)?;
            let (vc, us) = turned(&v, &u)?;
            Ok([(uc - vs)?, (vc + us)?])
        };
        let [u, v] = half(0, &self.rows)?;
        let [s, t] = half(2, &self.columns)?;
        Tensor::stack(&[u, v, s, t], 3)?.reshape((batch, tokens, channels))
    }
}

#[cfg(test)]
mod tests {
    use candle_core::IndexOp;
    use proptest::prelude::*;

    use super::*;

    /// A (1, tokens, channels) tensor.
    fn tokens(rows: &[[f32; 8]]) -> Tensor {
        Tensor::from_slice(rows.as_flattened(), (1, rows.len(), 8), &Device::Cpu).unwrap()
    }

    fn rotate(base: f32, positions: &[[u32; 2]], rows: &[[f32; 8]]) -> Vec<Vec<f32>> {
        let rotation = Rope2d::new(8, base)
            .unwrap()
            .rotation(positions, &Device::Cpu)
            .unwrap();
        let turned = rotation.apply(&tokens(rows), 1).unwrap();
        turned.i(0).unwrap().to_vec2().unwrap()
    }

    #[test]
    fn rows_turn_the_first_half_and_columns_the_second() {
        // Base 100 and q = 2: frequencies 1 and 0.1. Pairs (0, 2), (1, 3); (4, 6), (5, 7).
        let x = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0];
        let got = rotate(100.0, &[[2, 3]], &[x]);
        let (row, column) = (2.0_f32, 3.0_f32);
        let want = [
            row.cos(),
            (0.1 * row).cos(),
            row.sin(),
            (0.1 * row).sin(),
            -column.sin(),
            -(0.1 * column).sin(),
            column.cos(),
            (0.1 * column).cos(),
        ];
        for (got, want) in got[0].iter().zip(want) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert!(Rope2d::new(6, 100.0).is_err());
        assert!(Rope2d::new(0, 100.0).is_err());
        assert!(Rope2d::new(8, f32::NAN).is_err());
        let rope = Rope2d::new(8, 100.0).unwrap();
        let rotation = rope.rotation(&[[0, 0], [0, 1]], &Device::Cpu).unwrap();
        assert!(rotation.apply(&tokens(&[[0.0; 8]]), 1).is_err());
        assert!(rotation.apply(&tokens(&[[0.0; 8]; 3]), 1).is_err());
    }

    proptest! {
        /// What RoPE is for: a query's product with a key depends on their offset alone.
        #[test]
        fn products_depend_on_offsets_alone(
            query in prop::array::uniform8(-1.0_f32..1.0),
            key in prop::array::uniform8(-1.0_f32..1.0),
            at in prop::array::uniform2(0_u32..16),
            offset in prop::array::uniform2(0_u32..16),
            shift in prop::array::uniform2(0_u32..16),
        ) {
            let add = |a: [u32; 2], b: [u32; 2]| [a[0] + b[0], a[1] + b[1]];
            let product = |at| {
                let turned = rotate(100.0, &[at, add(at, offset)], &[query, key]);
                turned[0].iter().zip(&turned[1]).map(|(q, k)| q * k).sum::<f32>()
            };
            prop_assert!((product(at) - product(add(at, shift))).abs() < 1e-4);
        }

        #[test]
        fn as_by_candle(
            batch in 1_usize..3,
            heads in 1_usize..4,
            pairs in 1_usize..20,
            positions in prop::collection::vec(prop::array::uniform2(0_u32..40), 1..20),
        ) {
            let rope = Rope2d::new(4 * pairs, 100.0).unwrap();
            let rotation = rope.rotation(&positions, &Device::Cpu).unwrap();
            let (tokens, channels) = (positions.len(), heads * 4 * pairs);
            let wide = (batch, tokens, 2 * channels);
            let x = Tensor::randn(0.0_f32, 1.0, wide, &Device::Cpu).unwrap();
            let x = x.narrow(2, channels, channels).unwrap();
            let flat = |x: Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            let want = flat(rotation.plain(&x, heads).unwrap());
            for isa in Isa::available() {
                let tables = [&rotation.rows, &rotation.columns];
                let got = flat(cpu::rotate(isa, &x, tables, heads).unwrap());
                prop_assert_eq!(got.len(), want.len());
                for (got, want) in got.iter().zip(&want) {
                    prop_assert!((got - want).abs() < 1e-5, "{isa}: {got} {want}");
                }
            }
        }
    }
}
