//! Safetensors files: as a checkpoint, as weights of a network, as maps of a scene.
#![no_main]

use candle_core::Device;
use libfuzzer_sys::fuzz_target;
use tid3r::scene::files::MapFile;
use tid3r_fuzz::{heard, put, read_all};
use tid3r_models::{ComputeType, Weights};
use tid3r_weights_convert::Checkpoint;

fuzz_target!(|data: &[u8]| {
    let path = put("model.safetensors", data);
    if let Some(checkpoint) = heard(Checkpoint::open(&path)) {
        read_all(&checkpoint);
        for compute_type in ComputeType::ALL {
            let weights = Weights::open(&path, &Device::Cpu);
            let weights = weights.map(|weights| weights.in_type(compute_type));
            if let Ok(weights) = weights {
                weights.footprint();
                for (name, shape) in checkpoint.shapes() {
                    let _ = weights.get(shape, name);
                }
            }
        }
    }
    if let Ok(file) = MapFile::open(&path, "") {
        file.recipe();
        for name in ["map", "depth", "confidence"] {
            let _ = file.map::<f32>(name);
            let _ = file.map::<u32>(name);
            let _ = file.map::<bool>(name);
        }
    }
});
