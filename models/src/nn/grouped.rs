//! Linear maps of groups of channels.

use std::sync::{Arc, OnceLock};

use candle_core::{D, Device, Error, Result, Tensor, bail};
use rayon::prelude::*;

use super::cpu::{Epilogue, Factor, HostTensor, Matrix, MatrixMut, PackedFactor, gemm_serial};
use super::profile::{Operation, Timer};
use crate::{Parameter, Weights};

/// A linear map of each group of channels for itself, without a bias: a 1x1 convolution in groups.
///
/// On a CPU, weights are laid out by [`Self::laid_out`] or when [`Self::forward`] is first called, and shared by
/// clones.
#[derive(Clone)]
pub struct GroupedLinear {
    /// (channels, channels of a group, 1, 1).
    weight: Parameter,
    groups: usize,
    prepared: Arc<OnceLock<std::result::Result<Vec<PackedFactor>, String>>>,
}

impl std::fmt::Debug for GroupedLinear {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GroupedLinear")
            .field("weight", &self.weight)
            .field("groups", &self.groups)
            .finish_non_exhaustive()
    }
}

/// Rows that are multiplied together, at most: a multiple of all tiles' rows.
const ROWS: usize = 42;

impl GroupedLinear {
    /// Reads `weight` (channels, channels / groups, 1, 1).
    ///
    /// # Errors
    ///
    /// If there are no channels, `groups` does not divide them, or `weights` lacks the tensor or has it
    /// in another shape.
    pub fn new(channels: usize, groups: usize, weights: &Weights) -> Result<Self> {
        if channels == 0 || groups == 0 || !channels.is_multiple_of(groups) {
            bail!("{channels} channels are no {groups} groups");
        }
        Ok(Self {
            weight: weights.get([channels, channels / groups, 1, 1], "weight")?,
            groups,
            prepared: Arc::default(),
        })
    }

    /// `x` (.., channels) to the same shape.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let channels = self.weight.shape()[0];
        if x.dim(D::Minus1)? != channels {
            bail!("{channels} channels are wanted, got {:?}", x.shape());
        }
        match self.weight.host() {
            Some(weight) if HostTensor::fits(x) => self.by_groups(x, weight),
            _ => self.plain(x),
        }
    }

    /// The same map, its weights laid out now; see [`Conv2d::laid_out`](super::Conv2d::laid_out).
    ///
    /// # Errors
    ///
    /// As there.
    pub fn laid_out(self) -> Result<Self> {
        if let Some(weight) = self.weight.host().filter(|weight| !weight.is_empty()) {
            self.prepared(weight)?;
        }
        Ok(self)
    }

    /// The weights of each group, laid out the first time.
    fn prepared(&self, weight: &[f32]) -> Result<&[PackedFactor]> {
        let group = self.weight.shape()[0] / self.groups;
        let pack = |weight| {
            let weight = Matrix::new(weight, group, group, group)?;
            PackedFactor::pack(Factor::Transposed(weight))
        };
        let prepare = || {
            weight
                .chunks_exact(group * group)
                .map(pack)
                .collect::<Result<_>>()
        };
        let factors = (self.prepared).get_or_init(|| prepare().map_err(|e| e.to_string()));
        factors.as_deref().map_err(|e| Error::Msg(e.clone()))
    }

    fn by_groups(&self, x: &Tensor, weight: &[f32]) -> Result<Tensor> {
        let channels = self.weight.shape()[0];
        let group = channels / self.groups;
        let factors = self.prepared(weight)?;
        let _timer = Timer::start(Operation::Linear, x.elem_count() * group);
        let contiguous = x.contiguous()?;
        let host = HostTensor::new(&contiguous)?;
        let from = &host.data()?[..x.elem_count()];
        let mut out = vec![0.0; from.len()];
        (out.par_chunks_mut(ROWS * channels))
            .zip(from.par_chunks(ROWS * channels))
            .try_for_each(|(out, from)| {
                let rows = out.len() / channels;
                (factors.iter().enumerate()).try_for_each(|(i, factor)| {
                    let first = i * group;
                    let from = Matrix::new(&from[first..], rows, group, channels)?;
                    let to = MatrixMut::new(&mut out[first..], rows, group, channels)?;
                    gemm_serial(from, factor, to, &Epilogue::default())
                })
            })?;
        Tensor::from_vec(out, x.shape(), &Device::Cpu)
    }

    /// The map by candle's own operations.
    fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let channels = self.weight.shape()[0];
        let group = channels / self.groups;
        let weight = self.weight.tensor()?.reshape((self.groups, group, group))?;
        x.contiguous()?
            .reshape(((), self.groups, group))?
            .transpose(0, 1)?
            .contiguous()?
            .matmul(&weight.transpose(1, 2)?.contiguous()?)?
            .transpose(0, 1)?
            .contiguous()?
            .reshape(x.shape())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn layer(channels: usize, groups: usize) -> GroupedLinear {
        let make = |_: &str, shape: &[usize]| {
            let wave = |i: usize| (i as f32 * 0.7).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        GroupedLinear::new(channels, groups, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    #[test]
    fn by_hand() {
        // Two groups of two: [1 2; 3 4] and [5 6; 7 8].
        let make = |_: &str, _: &[usize]| (1..=8).map(|i| i as f32).collect();
        let layer = GroupedLinear::new(4, 2, &Weights::from_fn(make, &Device::Cpu)).unwrap();
        let x = Tensor::new(
            &[[1.0_f32, 10.0, 1.0, 0.0], [0.0, 1.0, 0.0, 2.0]],
            &Device::Cpu,
        )
        .unwrap();
        let y = layer.forward(&x).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(y, [[21.0, 43.0, 5.0, 7.0], [2.0, 4.0, 12.0, 16.0]]);
    }

    proptest! {
        #[test]
        fn as_by_candle(rows in 0_usize..100, groups in 1_usize..7, group in 1_usize..40) {
            let layer = layer(groups * group, groups);
            // Not at the start of its storage, and not contiguous.
            let x = Tensor::randn(0.0_f32, 1.0, (2, rows, groups * group + 3), &Device::Cpu).unwrap();
            let x = x.narrow(2, 2, groups * group).unwrap();
            let got = layer.forward(&x).unwrap();
            prop_assert_eq!(got.dims(), x.dims());
            let flat = |x: Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for (got, want) in flat(got).into_iter().zip(flat(layer.plain(&x).unwrap())) {
                prop_assert!((got - want).abs() < 1e-4, "{got} {want}");
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        for groups in [0, 3] {
            let weights = Weights::names_only();
            assert!(GroupedLinear::new(4, groups, &weights).is_err(), "{groups}");
        }
        let x = Tensor::new(&[1.0_f32; 5], &Device::Cpu).unwrap();
        assert!(layer(4, 2).forward(&x).is_err());
    }
}
