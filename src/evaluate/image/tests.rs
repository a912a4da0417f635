use super::*;
use crate::evaluate::pattern::hash;
use approx::{assert_abs_diff_eq, assert_relative_eq};
use image::Rgb;

/// A picture and its truth, made by a formula.
fn pair(width: u32, height: u32) -> (RgbImage, RgbImage) {
    let truth = |x: u32, y: u32, c: u32| (x * 7 + y * 3 + c * 40 + hash(x, 3 * y + c) % 32) % 256;
    let picture =
        |x: u32, y: u32, c: u32| (3 * truth(x, y, c) + hash(x + 1000, 3 * y + c) % 256) / 4;
    let image = |value: &dyn Fn(u32, u32, u32) -> u32| {
        RgbImage::from_fn(width, height, |x, y| {
            Rgb([0, 1, 2].map(|channel| value(x, y, channel) as u8))
        })
    };
    (image(&picture), image(&truth))
}

fn grey(width: u32, height: u32, value: u8) -> RgbImage {
    RgbImage::from_pixel(width, height, Rgb([value; 3]))
}

/// The definition, pixel by pixel with the whole two-dimensional window.
fn plain_ssim(picture: &RgbImage, truth: &RgbImage) -> f64 {
    let (width, height) = (i64::from(truth.width()), i64::from(truth.height()));
    let reflect = |place: i64, length: i64| {
        let place = place.abs();
        (if place < length {
            place
        } else {
            2 * length - 2 - place
        }) as u32
    };
    let mut sum = 0.0;
    for (y, x, channel) in (0..height)
        .flat_map(|y| (0..width).flat_map(move |x| (0..CHANNELS).map(move |c| (y, x, c))))
    {
        let mut window = Vec::new();
        for (dy, dx) in (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dy, dx))) {
            let (u, v) = (reflect(x + dx, width), reflect(y + dy, height));
            let weight = (-((dx * dx + dy * dy) as f64) / (2.0 * 1.5 * 1.5)).exp();
            let value = |image: &RgbImage| f64::from(image.get_pixel(u, v).0[channel]) / 255.0;
            window.push((weight, value(picture), value(truth)));
        }
        let total: f64 = window.iter().map(|(weight, ..)| weight).sum();
        let mean = |value: &dyn Fn(f64, f64) -> f64| {
            let weighted = window.iter().map(|&(weight, a, b)| weight * value(a, b));
            weighted.sum::<f64>() / total
        };
        let (mean_a, mean_b) = (mean(&|a, _| a), mean(&|_, b| b));
        let variance_a = mean(&|a, _| (a - mean_a).powi(2));
        let variance_b = mean(&|_, b| (b - mean_b).powi(2));
        let covariance = mean(&|a, b| (a - mean_a) * (b - mean_b));
        sum += (2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2)
            / ((mean_a.powi(2) + mean_b.powi(2) + C1) * (variance_a + variance_b + C2));
    }
    sum / (width * height * CHANNELS as i64) as f64
}

#[test]
fn ssim_is_that_of_torchmetrics() {
    // torchmetrics 1.9.0 on torch 2.15.0, in float64, as tests/fixtures/metrics/make.py has it:
    // structural_similarity_index_measure(picture, truth, data_range=1.0).
    for (size, expected) in [
        ((37, 23), 0.602_743_067_041_387),
        ((11, 11), 0.487_845_503_709_974),
        ((64, 48), 0.612_958_615_342_013),
        ((6, 9), 0.498_402_861_469_099),
    ] {
        let (picture, truth) = pair(size.0, size.1);
        let found = ssim(&picture, &truth).unwrap();
        assert_abs_diff_eq!(found, expected, epsilon = 1e-12);
    }
}

#[test]
fn ssim_is_the_plain_definition() {
    for (width, height) in [(11, 17), (29, 12)] {
        let (picture, truth) = pair(width, height);
        assert_abs_diff_eq!(
            ssim(&picture, &truth).unwrap(),
            plain_ssim(&picture, &truth),
            epsilon = 1e-12
        );
    }
}

#[test]
fn ssim_of_equal_pictures_is_one() {
    let (picture, _) = pair(16, 12);
    assert_eq!(ssim(&picture, &picture).unwrap(), 1.0);
    assert_eq!(ssim(&grey(16, 12, 0), &grey(16, 12, 0)).unwrap(), 1.0);
}

#[test]
fn ssim_of_constant_pictures_compares_their_means() {
    // 51 / 255 = 0.2, 153 / 255 = 0.6; without variance the second factor is 1.
    let expected = (2.0 * 0.2 * 0.6 + C1) / (0.2 * 0.2 + 0.6 * 0.6 + C1);
    let found = ssim(&grey(16, 12, 51), &grey(16, 12, 153)).unwrap();
    assert_abs_diff_eq!(found, expected, epsilon = 1e-12);
}

#[test]
fn psnr_is_that_of_torchmetrics() {
    // torchmetrics 1.9.0 on torch 2.15.0, in float64:
    // peak_signal_noise_ratio(picture, truth, data_range=1.0), which takes ln 10 in float32 all the
    // same: hence the tolerance.
    for (size, expected) in [
        ((37, 23), 19.889_172_025_463_7),
        ((11, 11), 21.656_056_856_985_03),
        ((64, 48), 19.746_646_641_424_878),
        ((6, 9), 21.895_757_290_164_9),
    ] {
        let (picture, truth) = pair(size.0, size.1);
        let found = psnr(&picture, &truth, None).unwrap();
        assert_abs_diff_eq!(found, expected, epsilon = 2e-6);
    }
}

#[test]
fn psnr_by_hand() {
    // Everywhere 0.2 off: -10 log10 0.04.
    let found = psnr(&grey(3, 2, 51), &grey(3, 2, 102), None).unwrap();
    assert_relative_eq!(found, 13.979_400_086_720_375, epsilon = 1e-12);
    // All of the range off: 0 dB.
    assert_eq!(psnr(&grey(3, 2, 0), &grey(3, 2, 255), None).unwrap(), 0.0);
}

#[test]
fn psnr_of_equal_pictures_is_infinite_and_so_is_a_mean_with_it() {
    let equal = ImageReport::of(&grey(11, 11, 9), &grey(11, 11, 9), &Perceptual::none()).unwrap();
    let perfect = ImageReport {
        psnr: f64::INFINITY,
        ssim: 1.0,
        lpips: PerceptualDistances::default(),
    };
    assert_eq!(equal, perfect);
    let other = ImageReport {
        psnr: 20.0,
        ssim: 0.5,
        lpips: PerceptualDistances::default(),
    };
    let mean = ImageReport::mean(&[equal, other.clone()]).unwrap();
    assert_eq!((mean.psnr, mean.ssim), (f64::INFINITY, 0.75));
    assert_eq!(ImageReport::mean(std::slice::from_ref(&other)), Some(other));
    assert_eq!(ImageReport::mean(&[]), None);
}

#[test]
fn psnr_counts_masked_pixels_only() {
    let mut picture = grey(2, 1, 51);
    picture.put_pixel(1, 0, Rgb([255; 3]));
    let first = Map::from_fn(2, 1, |x, _| x == 0);
    let found = psnr(&picture, &grey(2, 1, 102), Some(&first)).unwrap();
    assert_relative_eq!(found, 13.979_400_086_720_375, epsilon = 1e-12);

    // By numpy: the same with (x + 2 y) % 3 == 0 of the picture by formula.
    let (picture, truth) = pair(37, 23);
    let third = Map::from_fn(37, 23, |x, y| (x + 2 * y) % 3 == 0);
    let found = psnr(&picture, &truth, Some(&third)).unwrap();
    assert_abs_diff_eq!(found, 20.225_498_992_074_69, epsilon = 1e-10);
}

#[test]
fn pictures_that_cannot_be_compared_are_refused() {
    let picture = grey(12, 12, 0);
    assert!(psnr(&picture, &grey(12, 11, 0), None).is_err());
    assert!(ssim(&picture, &grey(11, 12, 0)).is_err());
    assert!(psnr(&grey(0, 0, 0), &grey(0, 0, 0), None).is_err());
    assert!(psnr(&picture, &picture, Some(&Map::filled(12, 12, false))).is_err());
    assert!(psnr(&picture, &picture, Some(&Map::filled(12, 11, true))).is_err());
    for (width, height) in [(5, 40), (40, 5), (0, 0)] {
        let small = grey(width, height, 0);
        let refusal = ssim(&small, &small).unwrap_err().to_string();
        assert!(refusal.contains("too small for SSIM"), "{refusal}");
    }
}
