use palette::{FromColor, Hsv, IntoColor, Oklab, Srgb};
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// How an instance's colour changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColourChange {
    /// Hue, saturation and value, each by itself.
    Adjust {
        /// Added to the hue, degrees.
        hue_degrees: f64,
        /// Multiplies the saturation.
        saturation: f64,
        /// Multiplies the value.
        value: f64,
    },
    /// Takes the hue and chroma of a colour everywhere, and its lightness on the average: light and
    /// shadow stay, coloured patterns do not.
    To {
        /// The colour.
        colour: Hex,
    },
}

/// An sRGB colour that reads and writes as `#rrggbb`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Hex(pub [u8; 3]);

impl FromStr for Hex {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.strip_prefix('#').unwrap_or(text);
        let valid = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        let number = u32::from_str_radix(digits, 16).ok().filter(|_| valid);
        let number = number.ok_or_else(|| format!("'{text}' is no colour; write it as #rrggbb"))?;
        let [_, r, g, b] = number.to_be_bytes();
        Ok(Self([r, g, b]))
    }
}

impl TryFrom<String> for Hex {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Hex> for String {
    fn from(Hex([r, g, b]): Hex) -> Self {
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

fn oklab(colour: [u8; 3]) -> Oklab<f64> {
    Oklab::from_color(Srgb::from(colour).into_format::<f64>().into_linear())
}

impl ColourChange {
    /// The change as a function of a colour, for an instance with these colours.
    pub fn of_instance(&self, colours: &[[u8; 3]]) -> impl Fn([u8; 3]) -> [u8; 3] + use<> {
        let lightness: f64 = colours.iter().map(|&colour| oklab(colour).l).sum();
        let mean_lightness = lightness / (colours.len() as f64).max(1.0);
        let change = self.clone();
        move |colour| match change {
            Self::Adjust {
                hue_degrees,
                saturation,
                value,
            } => {
                let mut hsv: Hsv<_, f64> = Hsv::from_color(Srgb::from(colour).into_format::<f64>());
                hsv.hue += hue_degrees;
                hsv.saturation = (hsv.saturation * saturation).clamp(0.0, 1.0);
                hsv.value = (hsv.value * value).clamp(0.0, 1.0);
                let rgb: Srgb<f64> = hsv.into_color();
                rgb.into_format().into()
            }
            Self::To {
                colour: Hex(target),
            } => {
                let target = oklab(target);
                let l = (oklab(colour).l + target.l - mean_lightness).clamp(0.0, 1.0);
                let rgb: Srgb<f64> = Srgb::from_linear(Oklab { l, ..target }.into_color());
                rgb.into_format().into()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adjust(hue_degrees: f64, saturation: f64, value: f64) -> ColourChange {
        ColourChange::Adjust {
            hue_degrees,
            saturation,
            value,
        }
    }

    #[test]
    fn hue_saturation_and_value_change_one_by_one() {
        let apply = |change: ColourChange, colour| change.of_instance(&[])(colour);
        assert_eq!(apply(adjust(0.0, 1.0, 1.0), [200, 100, 50]), [200, 100, 50]);
        assert_eq!(apply(adjust(120.0, 1.0, 1.0), [200, 0, 0]), [0, 200, 0]);
        assert_eq!(
            apply(adjust(0.0, 0.0, 1.0), [200, 100, 50]),
            [200, 200, 200]
        );
        assert_eq!(apply(adjust(0.0, 1.0, 0.5), [200, 100, 50]), [100, 50, 25]);
        assert_eq!(apply(adjust(0.0, 9.0, 9.0), [200, 100, 100]), [255, 0, 0]);
    }

    #[test]
    fn a_target_colour_is_the_mean_and_shading_stays() {
        let shades = [[60; 3], [100; 3], [140; 3]];
        let target = Hex([40, 90, 160]);
        let change = ColourChange::To { colour: target };
        let paint = change.of_instance(&shades);
        let [dark, middle, light] = shades.map(&paint);
        assert!(
            dark.iter()
                .zip(middle)
                .zip(light)
                .all(|((&d, m), l)| d < m && m < l)
        );
        let one = change.of_instance(&[[77; 3]])([77; 3]);
        assert!(
            one.iter()
                .zip(target.0)
                .all(|(&got, want)| got.abs_diff(want) <= 1),
            "{one:?}"
        );
    }

    #[test]
    fn colours_read_as_they_are_written() {
        assert_eq!("#1E90ff".parse(), Ok(Hex([0x1e, 0x90, 0xff])));
        assert_eq!(String::from(Hex([1, 2, 255])), "#0102ff");
        for wrong in ["", "#12345", "blue", "+12345", "#1234567", "#12345é"] {
            assert!(wrong.parse::<Hex>().is_err(), "{wrong}");
        }
    }
}
