//! Pictures of latents at a glance, without the decoder.

use super::picture::PIXELS_PER_LATENT;
use candle_core::{Result, Tensor, bail};
use image::{RgbImage, imageops};
use nalgebra::{Matrix5, Matrix5x3, SVector};

/// The colour that a latent stands for, about: the linear function of it that comes closest to the pictures whose
/// latents are known. Decoding takes as long as a step of denoising; this takes nothing, and needs no knowledge of the
/// autoencoder.
#[derive(Clone, Debug)]
pub(super) struct Colours {
    /// From a latent and 1 to red, green and blue, 0 to 255.
    weights: Matrix5x3<f64>,
}

/// A latent, and 1.
type Row = SVector<f64, 5>;

impl Colours {
    /// What fits `latents` (pictures, height, width, 4) of `pictures` best, which are eight times as high and wide. All
    /// grey if they are of another kind.
    pub(super) fn fitted(latents: &Tensor, pictures: &[RgbImage]) -> Self {
        let mut squares = Matrix5::zeros();
        let mut products = Matrix5x3::zeros();
        for (index, picture) in pictures.iter().enumerate() {
            let Ok((size, rows)) = rows(latents, index) else {
                continue;
            };
            let small = imageops::thumbnail(picture, size[0], size[1]);
            for (row, pixel) in rows.iter().zip(small.pixels()) {
                squares += row * row.transpose();
                products += row * SVector::from(pixel.0.map(f64::from)).transpose();
            }
        }
        let solved = squares
            .pseudo_inverse(1e-9)
            .map(|inverse| inverse * products);
        let grey = Matrix5x3::from_fn(|row, _| if row == 4 { 127.5 } else { 0.0 });
        let known = solved.ok().filter(|weights| *weights != Matrix5x3::zeros());
        Self {
            weights: known.unwrap_or(grey),
        }
    }

    /// Picture number `index` of latents (pictures, height, width, 4), as wide as it is in pixels, in these proportions
    /// (width, height).
    ///
    /// # Errors
    /// When they have another shape.
    pub(super) fn picture(
        &self,
        latents: &Tensor,
        index: usize,
        proportions: [u32; 2],
    ) -> Result<RgbImage> {
        let ([width, height], rows) = rows(latents, index)?;
        let colours = rows.iter().flat_map(|row| {
            let colour = self.weights.transpose() * row;
            [colour[0], colour[1], colour[2]].map(|value| value.round().clamp(0.0, 255.0) as u8)
        });
        let Some(small) = RgbImage::from_raw(width, height, colours.collect()) else {
            bail!("a picture is too large");
        };
        let wide = width * PIXELS_PER_LATENT;
        let high = f64::from(wide) * f64::from(proportions[1]) / f64::from(proportions[0].max(1));
        let high = (high.round() as u32).clamp(1, 8 * wide);
        Ok(imageops::resize(
            &small,
            wide,
            high,
            imageops::FilterType::Triangle,
        ))
    }
}

/// Width and height of a picture in latents, and its latents, row by row.
fn rows(latents: &Tensor, index: usize) -> Result<([u32; 2], Vec<Row>)> {
    let (_, height, width, 4) = latents.dims4()? else {
        bail!("latents of {:?} have not 4 channels", latents.shape());
    };
    let values = latents
        .narrow(0, index, 1)?
        .flatten_all()?
        .to_vec1::<f32>()?;
    let row =
        |values: &[f32]| Row::from_fn(|k, _| values.get(k).map_or(1.0, |&value| f64::from(value)));
    Ok((
        [width as u32, height as u32],
        values.chunks_exact(4).map(row).collect(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use image::Rgb;

    /// A picture in patches, and latents that are a linear function of their colours.
    fn made_up() -> (RgbImage, Tensor) {
        let colour =
            |x: u32, y: u32| [(40 * x) as u8, (50 * y) as u8, (20 * x + 10 * y) as u8 ^ 64];
        let picture = RgbImage::from_fn(48, 32, |x, y| Rgb(colour(x / 8, y / 8)));
        let latents = (0..4)
            .flat_map(|y| (0..6).map(move |x| (x, y)))
            .flat_map(|(x, y)| {
                let [r, g, b] = colour(x, y).map(|value| f32::from(value) / 255.0);
                [r - g, 2.0 * b - 1.0, 0.3 - r, r + g + b]
            });
        let latents =
            Tensor::from_iter(latents, &Device::Cpu).and_then(|all| all.reshape((1, 4, 6, 4)));
        (picture, latents.unwrap())
    }

    #[test]
    fn linear_latents_give_their_colours_back() {
        let (picture, latents) = made_up();
        let colours = Colours::fitted(&latents, std::slice::from_ref(&picture));
        let seen = colours.picture(&latents, 0, [6, 4]).unwrap();
        assert_eq!(seen.dimensions(), picture.dimensions());
        let high = colours.picture(&latents, 0, [60, 80]).unwrap();
        assert_eq!(high.dimensions(), (48, 64));
        for (x, y) in [(4, 4), (44, 28), (20, 12)] {
            let (seen, wanted) = (seen.get_pixel(x, y).0, picture.get_pixel(x, y).0);
            // Between middles of patches, colours are mixed.
            assert!(
                seen.iter().zip(wanted).all(|(&a, b)| a.abs_diff(b) <= 8),
                "{seen:?} {wanted:?}"
            );
        }
        assert!(colours.picture(&latents, 1, [6, 4]).is_err());
    }

    #[test]
    fn without_pictures_all_is_grey() {
        let (_, latents) = made_up();
        let seen = Colours::fitted(&latents, &[])
            .picture(&latents, 0, [1, 1])
            .unwrap();
        assert!(seen.pixels().all(|pixel| pixel.0 == [128; 3]));
    }
}
