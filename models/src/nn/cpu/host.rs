//! Candle's tensors as arrays.

use super::isa::kernels_fit;
use candle_core::{DType, Layout, Result, Storage, StorageRef, Tensor, bail};

/// The numbers of an f32 tensor in the CPU's memory.
pub(in crate::nn) struct HostTensor<'a> {
    storage: StorageRef<'a>,
    layout: &'a Layout,
}

impl<'a> HostTensor<'a> {
    /// Whether `tensor` is one.
    pub(in crate::nn) fn fits(tensor: &Tensor) -> bool {
        kernels_fit(tensor.device()) && tensor.dtype() == DType::F32
    }

    /// # Errors
    ///
    /// If `tensor` does not [fit](Self::fits).
    pub(in crate::nn) fn new(tensor: &'a Tensor) -> Result<Self> {
        if !Self::fits(tensor) {
            bail!(
                "f32 on the CPU is wanted, got {:?} on {:?}",
                tensor.dtype(),
                tensor.device().location()
            );
        }
        let (storage, layout) = tensor.storage_and_layout();
        Ok(Self { storage, layout })
    }

    /// The numbers from the tensor's first one on, however they are strided.
    ///
    /// # Errors
    ///
    /// None, after [`Self::new`].
    pub(in crate::nn) fn data(&self) -> Result<&[f32]> {
        let Storage::Cpu(storage) = &*self.storage else {
            bail!("the CPU's memory is wanted");
        };
        let data = storage.as_slice::<f32>()?;
        Ok(&data[self.layout.start_offset().min(data.len())..])
    }

    /// Sizes, outermost first.
    pub(in crate::nn) fn dims(&self) -> &[usize] {
        self.layout.dims()
    }

    /// Distances of elements along each dimension.
    pub(in crate::nn) fn strides(&self) -> &[usize] {
        self.layout.stride()
    }
}
