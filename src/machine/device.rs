//! What networks compute on: one device for the whole process, the CPU unless another is chosen.

use super::available_memory;
use crate::{Error, Result, error::network_problem};
use candle_core::Device;
use std::sync::OnceLock;
use tid3r_models::{
    ComputeType,
    device::{Place, free_memory},
};

static DEVICE: OnceLock<Device> = OnceLock::new();

/// Lets all networks that are opened from now on compute there.
///
/// # Errors
/// When this build or this machine cannot, or a network computes elsewhere already.
pub fn compute_on(place: Place) -> Result<()> {
    let device = place.open().map_err(|error| {
        Error::request(
            format!(
                "networks cannot compute on {place}: {}",
                network_problem(&error)
            ),
            "leave out --device, or see what `tid3r doctor` says of the GPU",
        )
    })?;
    DEVICE.set(device).map_err(|_| {
        Error::request(
            format!("networks cannot move to {place} now"),
            "choose a device before the first network is opened",
        )
    })
}

/// Where networks compute.
pub(crate) fn device() -> &'static Device {
    DEVICE.get_or_init(|| Device::Cpu)
}

/// # Errors
/// When networks do not compute with this type here.
pub(crate) fn check_type(dtype: ComputeType) -> Result<()> {
    if dtype.fits(device()) {
        return Ok(());
    }
    Err(Error::request(
        format!("networks compute in {dtype} on GPUs only"),
        "on the processor, give --dtype bf16; in a build for GPUs, --device cuda",
    ))
}

/// Memory that networks can still take where they compute, in bytes; `None` where the system does not say.
pub(crate) fn network_memory() -> Option<u64> {
    match device() {
        Device::Cpu => available_memory(),
        device => free_memory(device),
    }
}
