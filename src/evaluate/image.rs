//! Rendered views against photos: PSNR, SSIM and, where there are weights, LPIPS.
//!
//! For PSNR and SSIM pixel values are taken to [0, 1], so their data range is 1.

use super::{
    lpips::{Perceptual, PerceptualDistances},
    size_mismatch,
};
use crate::{Error, Map, Result};
use image::RgbImage;
use rayon::prelude::*;
use serde::Serialize;

/// Pixels on each side of the centre of the SSIM window, which is 11x11.
const RADIUS: usize = 5;
const WINDOW: usize = 2 * RADIUS + 1;
/// Standard deviation of the window's Gaussian, in pixels.
const SIGMA: f64 = 1.5;
/// (K1 L)^2 and (K2 L)^2 of SSIM, with the data range L = 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
const CHANNELS: usize = 3;

/// How near a picture is to its truth, or the mean of that over pictures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImageReport {
    /// Peak signal-to-noise ratio in dB; infinite for a picture equal to its truth (JSON, which has
    /// no infinity, then says null).
    pub psnr: f64,
    /// Structural similarity, 1 for a picture equal to its truth.
    pub ssim: f64,
    /// LPIPS.
    #[serde(flatten)]
    pub lpips: PerceptualDistances,
}

impl ImageReport {
    /// [`psnr`], [`ssim`] and LPIPS of a picture.
    ///
    /// # Errors
    /// As [`ssim`] and [`Perceptual::distances`].
    pub fn of(picture: &RgbImage, truth: &RgbImage, perceptual: &Perceptual) -> Result<Self> {
        Ok(Self {
            psnr: psnr(picture, truth, None)?,
            ssim: ssim(picture, truth)?,
            lpips: perceptual.distances(picture, truth)?,
        })
    }

    /// The mean over pictures of each metric, `None` for no picture. It is the PSNRs that are
    /// averaged, not the errors beneath, as is usual; so one picture equal to its truth makes the
    /// mean PSNR infinite.
    pub fn mean(reports: &[Self]) -> Option<Self> {
        let count = reports.len() as f64;
        (!reports.is_empty()).then(|| Self {
            psnr: reports.iter().map(|report| report.psnr).sum::<f64>() / count,
            ssim: reports.iter().map(|report| report.ssim).sum::<f64>() / count,
            lpips: PerceptualDistances::mean(
                &reports
                    .iter()
                    .map(|report| report.lpips)
                    .collect::<Vec<_>>(),
            ),
        })
    }
}

/// Peak signal-to-noise ratio in dB: 10 log10(1 / mean squared error) over the pixels where `counted`
/// is true (all without it) and their channels. Infinite where nothing differs.
///
/// # Errors
/// When sizes differ, or no pixel counts.
pub fn psnr(picture: &RgbImage, truth: &RgbImage, counted: Option<&Map<bool>>) -> Result<f64> {
    check_same_size(picture, truth)?;
    if let Some(counted) = counted {
        let size = (counted.width(), counted.height());
        if size != truth.dimensions() {
            return Err(size_mismatch(
                "the mask of counted pixels",
                size,
                truth.dimensions(),
            ));
        }
    }
    // Whole numbers, so that the sum is exact.
    let (mut squares, mut pixels) = (0_u64, 0_u64);
    for (index, (pixel, truth)) in picture.pixels().zip(truth.pixels()).enumerate() {
        if counted.is_none_or(|counted| counted.values()[index]) {
            pixels += 1;
            for (value, truth) in pixel.0.iter().zip(truth.0) {
                squares += u64::from(value.abs_diff(truth)).pow(2);
            }
        }
    }
    if pixels == 0 {
        return Err(Error::request(
            "a picture without a single pixel to compare has no PSNR",
            "give a picture, and a mask that is not empty",
        ));
    }
    let mean = squares as f64 / (pixels as f64 * CHANNELS as f64 * 255.0 * 255.0);
    Ok(10.0 * mean.recip().log10())
}

/// Structural similarity (Wang et al., "Image Quality Assessment: From Error Visibility to Structural
/// Similarity", 2004), with the conventions of torchmetrics 1.4.2 and later for
/// `StructuralSimilarityIndexMeasure(data_range=1)`: an 11x11 Gaussian window of sigma 1.5, K1 = 0.01
/// and K2 = 0.03, population variances, borders mirrored without repeating the edge pixel, each
/// channel by itself, and the mean over all pixels and channels. (Earlier versions, like
/// scikit-image, left a border of 5 pixels out of that mean.)
///
/// # Errors
/// When sizes differ, or a side has no more pixels than the window's radius.
pub fn ssim(picture: &RgbImage, truth: &RgbImage) -> Result<f64> {
    check_same_size(picture, truth)?;
    let (width, height) = truth.dimensions();
    if width.min(height) <= RADIUS as u32 {
        return Err(Error::request(
            format!("a picture of {width}x{height} pixels is too small for SSIM"),
            "give pictures of at least 6x6 pixels",
        ));
    }
    let (width, height) = (width as usize, height as usize);
    let window = gaussian();
    let (picture, truth) = (unit_range(picture), unit_range(truth));
    let columns: Vec<usize> = (0..width + 2 * RADIUS)
        .map(|padded| mirrored(padded, width))
        .collect();

    let rows: Vec<f64> = (0..height)
        .into_par_iter()
        .map(|y| {
            let mut moments = vec![Moments::default(); width * CHANNELS];
            for (offset, weight) in window.iter().enumerate() {
                let start = mirrored(y + offset, height) * width * CHANNELS;
                let pixels = picture[start..].iter().zip(&truth[start..]);
                for (moments, (&a, &b)) in moments.iter_mut().zip(pixels) {
                    moments.add(*weight, &Moments::of(a, b));
                }
            }
            let mut sum = 0.0;
            for around in columns.windows(WINDOW) {
                for channel in 0..CHANNELS {
                    let mut windowed = Moments::default();
                    for (weight, x) in window.iter().zip(around) {
                        windowed.add(*weight, &moments[x * CHANNELS + channel]);
                    }
                    sum += windowed.similarity();
                }
            }
            sum
        })
        .collect();
    Ok(rows.iter().sum::<f64>() / (width * height * CHANNELS) as f64)
}

/// Weighted sums of the values a of one picture and b of the other, their squares and their product.
#[derive(Clone, Copy, Default)]
struct Moments {
    a: f64,
    b: f64,
    aa: f64,
    bb: f64,
    ab: f64,
}

impl Moments {
    fn of(a: f64, b: f64) -> Self {
        Self {
            a,
            b,
            aa: a * a,
            bb: b * b,
            ab: a * b,
        }
    }

    fn add(&mut self, weight: f64, other: &Self) {
        self.a += weight * other.a;
        self.b += weight * other.b;
        self.aa += weight * other.aa;
        self.bb += weight * other.bb;
        self.ab += weight * other.ab;
    }

    /// SSIM at the window's centre (Wang et al., equation 13), the weights having summed to 1.
    fn similarity(&self) -> f64 {
        let (mean_aa, mean_bb, mean_ab) = (self.a * self.a, self.b * self.b, self.a * self.b);
        let (variance_a, variance_b) = (self.aa - mean_aa, self.bb - mean_bb);
        let covariance = self.ab - mean_ab;
        (2.0 * mean_ab + C1) * (2.0 * covariance + C2)
            / ((mean_aa + mean_bb + C1) * (variance_a + variance_b + C2))
    }
}

/// One side of the separable window; sums to 1.
fn gaussian() -> [f64; WINDOW] {
    let weights: [f64; WINDOW] = std::array::from_fn(|index| {
        let distance = index as f64 - RADIUS as f64;
        (-0.5 * (distance / SIGMA).powi(2)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// The pixel, of `length` (more than [`RADIUS`]), that stands at place `padded` once [`RADIUS`]
/// mirrored pixels precede the first and follow the last.
fn mirrored(padded: usize, length: usize) -> usize {
    let distance = padded.abs_diff(RADIUS);
    if distance < length {
        distance
    } else {
        2 * (length - 1) - distance
    }
}

fn unit_range(picture: &RgbImage) -> Vec<f64> {
    let values = picture.as_raw().iter();
    values.map(|&value| f64::from(value) / 255.0).collect()
}

pub(super) fn check_same_size(picture: &RgbImage, truth: &RgbImage) -> Result<()> {
    if picture.dimensions() == truth.dimensions() {
        Ok(())
    } else {
        Err(size_mismatch(
            "the picture",
            picture.dimensions(),
            truth.dimensions(),
        ))
    }
}

#[cfg(test)]
mod tests;
