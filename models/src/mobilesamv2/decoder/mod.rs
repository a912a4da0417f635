//! The prompt-guided decoder: an image's embedding and some boxes to a mask for each box.
//!
//! It is SAM's (Kirillov et al. 2023), prompted with boxes only. A box is two tokens, one for each
//! corner; with four tokens for masks and one for their quality they make seven tokens, which attend
//! to the image and it to them ([`TwoWayTransformer`]). The image is then enlarged four times, and a
//! mask is a weighted sum of its channels, with weights from the mask's token ([`MaskDecoder`]).

mod config;
mod mask;
mod memory;
mod network;
mod prompt;
mod two_way;
mod work;

pub use config::{Config, MaskDecoderConfig, PromptEncoderConfig};
pub use mask::MaskDecoder;
pub use memory::Memory;
pub use network::{Decoder, Masks, Options, Output};
pub use prompt::PromptEncoder;
pub use two_way::{ImageSide, TwoWayTransformer};
pub use work::Work;
