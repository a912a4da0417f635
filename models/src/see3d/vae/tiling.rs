//! Large pictures in tiles.

use candle_core::{Result, Tensor, bail};

use super::Config;

/// Whether large pictures are cut into tiles that overlap by a quarter and are blended there.
///
/// It saves memory, and changes the result a little: norms and attention see one tile instead of the
/// whole picture. One tile goes over into the next within a quarter of a tile, or within the last tile
/// where that is shorter: no seam shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tiling {
    /// Never.
    Whole,
    /// Where a side of the picture exceeds the configuration's `sample_size`, into tiles of that size:
    /// what the original does. Where that is no multiple of [`Tiling::step`], tiles do not fit together,
    /// and results come out larger than they should, also in the original.
    #[default]
    Released,
    /// Where a side of the picture exceeds so many pixels, into tiles of that size; a multiple of
    /// [`Tiling::step`].
    Tiles(usize),
}

impl Tiling {
    /// What the side of a tile must be a multiple of, in pixels: its quarters are whole latents.
    pub fn step(config: &Config) -> usize {
        4 * config.scale()
    }

    /// Tiles of a picture.
    pub(super) fn of_encoding(self, config: &Config) -> Result<Tiles> {
        let Some((pixels, latents)) = self.sides(config)? else {
            return Ok(Tiles::WHOLE);
        };
        Ok(Tiles {
            side: pixels,
            stride: pixels * 3 / 4,
            blend: latents / 4,
            kept: latents - latents / 4,
        })
    }

    /// Tiles of latents.
    pub(super) fn of_decoding(self, config: &Config) -> Result<Tiles> {
        let Some((pixels, latents)) = self.sides(config)? else {
            return Ok(Tiles::WHOLE);
        };
        Ok(Tiles {
            side: latents,
            stride: latents * 3 / 4,
            blend: pixels / 4,
            kept: pixels - pixels / 4,
        })
    }

    /// The side of a tile in pixels and in latents.
    fn sides(self, config: &Config) -> Result<Option<(usize, usize)>> {
        let step = Self::step(config);
        let pixels = match self {
            Self::Whole => return Ok(None),
            Self::Released => config.sample_size,
            Self::Tiles(pixels) if pixels > 0 && pixels.is_multiple_of(step) => pixels,
            Self::Tiles(pixels) => {
                bail!("the side of a tile must be a multiple of {step} pixels, got {pixels}")
            }
        };
        let latents = pixels / config.scale();
        if latents < 2 {
            bail!(
                "sample_size = {pixels} is less than two latents of {} pixels: no tile is that small",
                config.scale()
            );
        }
        Ok(Some((pixels, latents)))
    }
}

/// Square tiles: where they begin on the input, and what is taken of their results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tiles {
    /// Rows and columns of a tile of the input. Those at the end may be smaller.
    side: usize,
    /// From the beginning of a tile of the input to the next.
    stride: usize,
    /// So many rows and columns of a result are blended with the neighbour's.
    blend: usize,
    /// So many rows and columns of a result are kept.
    kept: usize,
}

impl Tiles {
    /// One for all.
    const WHOLE: Self = Self {
        side: usize::MAX,
        stride: usize::MAX,
        blend: 0,
        kept: usize::MAX,
    };

    /// Whether an input of this height and width is cut.
    fn cut(&self, (height, width): (usize, usize)) -> bool {
        height.max(width) > self.side
    }

    /// Where tiles begin and how long they are, along a side of the input.
    fn along(&self, side: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
        let tile = self.side;
        (0..side)
            .step_by(self.stride)
            .map(move |start| (start, tile.min(side - start)))
    }

    /// Heights and widths of all tiles, in order.
    pub(super) fn sizes(&self, (height, width): (usize, usize)) -> Vec<(usize, usize)> {
        if !self.cut((height, width)) {
            return vec![(height, width)];
        }
        let columns = self.along(width);
        self.along(height)
            .flat_map(|(_, rows)| columns.clone().map(move |(_, columns)| (rows, columns)))
            .collect()
    }

    /// `of` the tiles of `x` (1, height, width, channels), put together.
    ///
    /// Tiles go row by row. Each is blended with the one above, then with the one to its left, which
    /// are blended themselves, and not cut yet.
    pub(super) fn run(
        &self,
        x: &Tensor,
        of: &mut dyn FnMut(&Tensor) -> Result<Tensor>,
    ) -> Result<Tensor> {
        let (_, height, width, _) = x.dims4()?;
        if !self.cut((height, width)) {
            return of(x);
        }
        let mut above: Vec<Tensor> = Vec::new();
        let mut rows = Vec::new();
        for (top, height) in self.along(height) {
            let strip = x.narrow(1, top, height)?;
            let mut row: Vec<Tensor> = Vec::new();
            for (i, (left, width)) in self.along(width).enumerate() {
                let mut tile = of(&strip.narrow(2, left, width)?.contiguous()?)?;
                if let Some(above) = above.get(i) {
                    tile = blend(above, &tile, self.blend, 1)?;
                }
                if let Some(left) = row.last() {
                    tile = blend(left, &tile, self.blend, 2)?;
                }
                row.push(tile);
            }
            let kept = row.iter().map(|tile| self.kept(tile));
            rows.push(Tensor::cat(&kept.collect::<Result<Vec<_>>>()?, 2)?);
            above = row;
        }
        Tensor::cat(&rows, 1)
    }

    /// What is taken of a tile's result.
    fn kept(&self, tile: &Tensor) -> Result<Tensor> {
        let (_, height, width, _) = tile.dims4()?;
        tile.narrow(1, 0, height.min(self.kept))?
            .narrow(2, 0, width.min(self.kept))
    }
}

/// `after` (1, height, width, channels), whose first `extent` rows (axis 1) or columns (axis 2) go over
/// from the last ones of `before`.
fn blend(before: &Tensor, after: &Tensor, extent: usize, axis: usize) -> Result<Tensor> {
    let (length, beyond) = (after.dim(axis)?, before.dim(axis)?);
    let extent = extent.min(length).min(beyond);
    if extent == 0 {
        return Ok(after.clone());
    }
    let share = |i: usize| i as f64 / extent as f64;
    let ramp = |of: &dyn Fn(usize) -> f32| {
        let ramp: Vec<f32> = (0..extent).map(of).collect();
        let mut shape = [1; 4];
        shape[axis] = extent;
        Tensor::from_vec(ramp, &shape[..], after.device())
    };
    let going = before
        .narrow(axis, beyond - extent, extent)?
        .broadcast_mul(&ramp(&|i| (1.0 - share(i)) as f32)?)?;
    let coming = after
        .narrow(axis, 0, extent)?
        .broadcast_mul(&ramp(&|i| share(i) as f32)?)?;
    let mixed = (going + coming)?;
    if extent == length {
        return Ok(mixed);
    }
    Tensor::cat(
        &[&mixed, &after.narrow(axis, extent, length - extent)?],
        axis,
    )
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};
    use proptest::prelude::*;

    use super::*;

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn the_original_s_tiles() {
        let released = Config::released();
        let encoding = Tiling::Released.of_encoding(&released).unwrap();
        let (side, stride, blend, kept) = (768, 576, 24, 72);
        assert_eq!(
            encoding,
            Tiles {
                side,
                stride,
                blend,
                kept
            }
        );
        // 1024 pixels: 768 and what is left from 576 on.
        assert_eq!(encoding.sizes((1024, 512)), [(768, 512), (448, 512)]);
        let (side, stride, blend, kept) = (96, 72, 192, 576);
        assert_eq!(
            Tiling::Released.of_decoding(&released).unwrap(),
            Tiles {
                side,
                stride,
                blend,
                kept
            }
        );
        assert_eq!(
            Tiling::Whole.of_decoding(&released).unwrap().sizes((9, 5)),
            [(9, 5)]
        );
    }

    #[test]
    fn tiles_of_odd_sizes_are_refused() {
        let message =
            |config: &Config, tiling: Tiling| tiling.of_encoding(config).unwrap_err().to_string();
        let released = Config::released();
        for side in [0, 48, 100] {
            let message = message(&released, Tiling::Tiles(side));
            assert!(message.contains("multiple of 32"), "{message}");
        }
        let config = Config {
            sample_size: 15,
            ..released
        };
        assert!(message(&config, Tiling::Released).contains("sample_size = 15"));
    }

    #[test]
    fn a_blend_by_hand() {
        let row = |values: &[f32]| {
            Tensor::from_slice(values, (1, 1, values.len(), 1), &Device::Cpu).unwrap()
        };
        let (before, after) = (row(&[9.0, 0.0, 4.0]), row(&[8.0, 2.0, 5.0]));
        // Two columns go over: 0 to 8 with 0/2, 4 to 2 with 1/2.
        assert_eq!(
            flat(&blend(&before, &after, 2, 2).unwrap()),
            [0.0, 3.0, 5.0]
        );
        assert_eq!(
            flat(&blend(&before, &after, 0, 2).unwrap()),
            [8.0, 2.0, 5.0]
        );
        // There is but one row.
        assert_eq!(
            flat(&blend(&before, &after, 5, 1).unwrap()),
            [9.0, 0.0, 4.0]
        );
    }

    #[test]
    fn tiles_that_differ_leave_no_seam() {
        let config = Config {
            sample_size: 32,
            ..Config::default()
        };
        let tiles = Tiling::Released.of_encoding(&config).unwrap();
        // The last tile, where one of every 24 columns begins, is as long as a blend at least.
        for width in (33..120).filter(|width| (width - 1) % 24 + 1 >= 8) {
            let x = Tensor::zeros((1, 5, width, 1), DType::F32, &Device::Cpu).unwrap();
            let mut number = -1.0;
            let got = tiles.run(&x, &mut |tile| {
                number += 1.0;
                tile + number
            });
            // Each tile is one more than the one before, and goes over into it within 8 columns.
            let got = flat(&got.unwrap().narrow(1, 0, 1).unwrap());
            for pair in got.windows(2) {
                let step = pair[1] - pair[0];
                assert!((-1e-6..=0.125 + 1e-6).contains(&step), "{width}: {step}");
            }
        }
    }

    proptest! {
        /// Where every pixel's result depends on that pixel alone, tiles leave no trace.
        #[test]
        fn tiles_of_an_image_are_the_image(height in 1_usize..90, width in 1_usize..90) {
            let config = Config { sample_size: 16, ..Config::default() };
            let tiles = Tiling::Released.of_encoding(&config).unwrap();
            let x = Tensor::randn(0.0_f32, 1.0, (1, height, width, 2), &Device::Cpu).unwrap();
            let got = tiles.run(&x, &mut |tile| Ok(tile.clone())).unwrap();
            prop_assert_eq!(got.dims(), x.dims());
            for (got, want) in flat(&got).iter().zip(flat(&x)) {
                prop_assert!((got - want).abs() < 1e-6, "{} {}", got, want);
            }
        }
    }
}
