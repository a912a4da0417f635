//! CLIP (Radford et al. 2021): a picture or a text to numbers that can be compared.
//!
//! Upstream: `models/clip/modeling_clip.py` of transformers 4.41.1 (`CLIPVisionModelWithProjection`,
//! `CLIPTextModel`). See3D has the image encoder of OpenCLIP's ViT-H/14 and the text encoder of Stable
//! Diffusion 2.1.

mod config;
mod layer;
mod memory;
mod text;
mod tokenizer;
mod vision;
mod work;

pub use config::{HiddenAct, TextConfig, VisionConfig};
pub use memory::Memory;
pub use text::TextEncoder;
pub use tokenizer::Tokenizer;
pub use vision::VisionEncoder;
pub use work::Work;
