use super::{Letterbox, MobileSamParams, Networks, SamFrame};
use crate::{
    Error, Result,
    error::network_problem,
    machine::{
        Expense, PROGRAM_BYTES, Pace, Reached, network_memory, readable_bytes, readable_seconds,
    },
};
use tid3r_models::{
    Footprint,
    mobilesamv2::{ImageEncoder, decoder, detector, efficient_vit, tiny_vit, vit},
};

const DETECTOR: Reached = reached(0.56, 0.72);
const EFFICIENT_VIT: Reached = reached(0.88, 1.15);
const TINY_VIT: Reached = reached(0.58, 0.8);
const VIT_H: Reached = reached(0.8, 1.5);
const DECODER: Reached = reached(0.56, 0.56);

const fn reached(f32: f64, bf16: f64) -> Reached {
    Reached { f32, bf16 }
}

/// Objects that a photo of a room has, by experience.
const OBJECTS: usize = 60;

/// What a picture takes on this machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PictureEstimate {
    /// Seconds, about.
    seconds: f64,
    /// Bytes, about, at the most at a time.
    bytes: u64,
}

impl PictureEstimate {
    /// For a square picture with as many objects as rooms have: how many there are is known late. The
    /// footprints are those of the weights of encoder and decoder.
    ///
    /// # Errors
    /// When the machine cannot be measured.
    pub(super) fn new(
        networks: &Networks,
        params: &MobileSamParams,
        footprints: [Footprint; 2],
    ) -> Result<Self> {
        let estimate = || {
            let pace = Pace::measured(params.dtype)?;
            let parts = parts_of_work(networks, params)?;
            let seconds = (parts.iter()).map(|&(work, reached)| pace.seconds(work, reached));
            Ok(Self {
                seconds: seconds.sum(),
                bytes: bytes(networks, params, footprints)? as u64,
            })
        };
        estimate().map_err(|error: candle_core::Error| {
            let problem = network_problem(&error);
            Error::request(
                format!("what the run will take cannot be told: {problem}"),
                "report this as a defect",
            )
        })
    }

    /// What so many pictures take, in words.
    pub(super) fn of(&self, pictures: usize) -> String {
        let what = if pictures == 1 { "photo" } else { "photos" };
        format!(
            "{pictures} {what} to cut: about {} and {}",
            readable_seconds(pictures as f64 * self.seconds),
            readable_bytes(self.bytes)
        )
    }

    /// Warns if this is more memory than there may be.
    pub(super) fn compare_with_machine(&self) {
        if let Some(available) = network_memory().filter(|&available| available < self.bytes) {
            tracing::warn!(
                "cutting photos takes about {} of memory, and there may be {}; a smaller --detector-size \
                 or another --encoder takes less",
                readable_bytes(self.bytes),
                readable_bytes(available)
            );
        }
    }
}

impl From<PictureEstimate> for Expense {
    fn from(PictureEstimate { seconds, bytes }: PictureEstimate) -> Self {
        Self { seconds, bytes }
    }
}

/// Height and width of the detector's picture, at the most.
fn detector_size(params: &MobileSamParams) -> (usize, usize) {
    let side = params.detector_size.next_multiple_of(Letterbox::STRIDE) as usize;
    (side, side)
}

fn objects(params: &MobileSamParams) -> usize {
    OBJECTS.min(params.max_masks as usize)
}

/// Multiply-adds of a picture, about, as the networks tell their observers.
pub(super) fn work(networks: &Networks, params: &MobileSamParams) -> candle_core::Result<f64> {
    let parts = parts_of_work(networks, params)?;
    Ok(parts.iter().map(|(work, _)| work).sum())
}

/// Those of detector, encoder and decoder, and how fast they are.
fn parts_of_work(
    networks: &Networks,
    params: &MobileSamParams,
) -> candle_core::Result<[(f64, Reached); 3]> {
    let detector = detector::Work::new(networks.detector.config(), detector_size(params))?;
    let encoder = match &networks.encoder {
        ImageEncoder::EfficientVit(encoder) => {
            let work = efficient_vit::Work::new(encoder.config());
            (work.total(), EFFICIENT_VIT)
        }
        ImageEncoder::TinyVit(encoder) => {
            let work = tiny_vit::Work::new(encoder.config())?;
            (work.total(), TINY_VIT)
        }
        ImageEncoder::Vit(encoder) => (vit::Work::new(encoder.config()).total(), VIT_H),
    };
    let decoder = decoder::Work::new(networks.decoder.config()).total(objects(params));
    let detector = (detector.computed(), DETECTOR);
    Ok([detector, encoder, (decoder, DECODER)])
}

/// Bytes at the most at a time: the networks run one after another, and their weights stay.
fn bytes(
    networks: &Networks,
    params: &MobileSamParams,
    [encoder, decoder]: [Footprint; 2],
) -> candle_core::Result<usize> {
    let side = SamFrame::SIDE as usize;
    let (weights, working) = match &networks.encoder {
        ImageEncoder::EfficientVit(network) => {
            let memory = efficient_vit::Memory::new(network.config(), (side, side), params.dtype)?;
            (memory.weights, memory.working)
        }
        ImageEncoder::TinyVit(network) => {
            let memory = tiny_vit::Memory::new(network.config(), encoder)?;
            (memory.weights, memory.working)
        }
        ImageEncoder::Vit(network) => {
            let memory = vit::Memory::new(network.config(), encoder)?;
            (memory.weights, memory.working)
        }
    };
    let (config, size) = (networks.detector.config(), detector_size(params));
    let detector = detector::Memory::new(config, size, params.dtype)?;
    let options = decoder::Options::default();
    let config = networks.decoder.config();
    let decoder = decoder::Memory::new(config, objects(params), &options, decoder)?;
    let most = working.max(detector.working).max(decoder.working);
    Ok(PROGRAM_BYTES as usize + weights + detector.weights + decoder.weights + most)
}
