//! Per-pixel maps.
//!
//! ```
//! use tid3r::Map;
//!
//! let depth = Map::from_fn(4, 3, |x, y| (10 * y + x) as f32);
//! assert_eq!(depth[(2, 1)], 12.0);
//! // Values are row-major, pixel centres at whole coordinates.
//! assert_eq!(depth.index(2, 1), 6);
//! assert_eq!(depth.nearest(1.6, 0.9), Some(6));
//! assert_eq!(depth.nearest(3.6, 0.0), None, "outside");
//!
//! let far = depth.map(|&z| z > 22.0);
//! assert_eq!(far.values().iter().filter(|&&far| far).count(), 1);
//! assert_eq!(far.dilated(1).values().iter().filter(|&&far| far).count(), 4);
//! ```

/// A value for every pixel of an image, row-major: depth, confidence, labels, validity.
#[derive(Clone, Debug, PartialEq)]
pub struct Map<T> {
    width: u32,
    height: u32,
    values: Vec<T>,
}

impl<T> Map<T> {
    /// A map of `values`, row-major; `None` unless there are exactly `width * height` of them.
    pub fn new(width: u32, height: u32, values: Vec<T>) -> Option<Self> {
        (values.len() == width as usize * height as usize).then_some(Self {
            width,
            height,
            values,
        })
    }

    /// The map whose pixel (x, y) is `value(x, y)`.
    pub fn from_fn(width: u32, height: u32, mut value: impl FnMut(u32, u32) -> T) -> Self {
        let mut values = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                values.push(value(x, y));
            }
        }
        Self {
            width,
            height,
            values,
        }
    }

    /// Pixels in a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Pixels in all.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Whether `other` has the same width and height.
    pub fn same_size<U>(&self, other: &Map<U>) -> bool {
        (self.width, self.height) == (other.width, other.height)
    }

    /// The place of pixel (x, y) in [`Map::values`].
    pub fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// The pixel (x, y) of a place in [`Map::values`].
    pub fn pixel(&self, index: usize) -> (u32, u32) {
        let width = self.width as usize;
        ((index % width) as u32, (index / width) as u32)
    }

    /// The place of the pixel nearest to (u, v), pixel centres being at whole coordinates; `None`
    /// outside the map and for coordinates that are not numbers.
    pub fn nearest(&self, u: f64, v: f64) -> Option<usize> {
        let (x, y) = (u.round(), v.round());
        (x >= 0.0 && y >= 0.0 && x < f64::from(self.width) && y < f64::from(self.height))
            .then(|| self.index(x as u32, y as u32))
    }

    /// All values, row-major.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, row-major, to be changed.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// All values, row-major.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// A map of the same size with `f` of every value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Map<U> {
        Map {
            width: self.width,
            height: self.height,
            values: self.values.iter().map(f).collect(),
        }
    }
}

impl<T: Clone> Map<T> {
    /// A map with the same value everywhere.
    pub fn filled(width: u32, height: u32, value: T) -> Self {
        Self {
            width,
            height,
            values: vec![value; width as usize * height as usize],
        }
    }
}

impl Map<bool> {
    /// True within `reach` pixels of a true pixel, along rows and columns: a square.
    #[must_use]
    pub fn dilated(&self, reach: u32) -> Self {
        let wide = Self::from_fn(self.width, self.height, |x, y| {
            let mut near =
                x.saturating_sub(reach)..x.saturating_add(reach).saturating_add(1).min(self.width);
            near.any(|x| self[(x, y)])
        });
        Self::from_fn(self.width, self.height, |x, y| {
            let mut near =
                y.saturating_sub(reach)..y.saturating_add(reach).saturating_add(1).min(self.height);
            near.any(|y| wide[(x, y)])
        })
    }
}

impl<T> std::ops::Index<(u32, u32)> for Map<T> {
    type Output = T;

    fn index(&self, (x, y): (u32, u32)) -> &T {
        &self.values[Map::index(self, x, y)]
    }
}

impl<T> std::ops::IndexMut<(u32, u32)> for Map<T> {
    fn index_mut(&mut self, (x, y): (u32, u32)) -> &mut T {
        let index = Map::index(self, x, y);
        &mut self.values[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_refuses_a_wrong_count() {
        assert!(Map::new(2, 2, vec![1, 2, 3]).is_none());
        assert!(Map::new(2, 2, vec![1, 2, 3, 4]).is_some());
    }

    #[test]
    fn dilation_is_a_square_of_the_given_reach() {
        let mut map = Map::filled(9, 9, false);
        map[(4, 4)] = true;
        let wide = map.dilated(2);
        for y in 0..9_u32 {
            for x in 0..9_u32 {
                assert_eq!(wide[(x, y)], x.abs_diff(4) <= 2 && y.abs_diff(4) <= 2);
            }
        }
        assert_eq!(map.dilated(0), map);
    }

    #[test]
    fn nearest_rounds_to_pixel_centres_and_refuses_the_outside() {
        let map = Map::filled(3, 2, 0);
        assert_eq!(map.nearest(1.4, 0.6), Some(4));
        assert_eq!(map.nearest(-0.4, -0.4), Some(0));
        assert_eq!(map.nearest(-0.6, 0.0), None);
        assert_eq!(map.nearest(2.6, 0.0), None);
        assert_eq!(map.nearest(f64::NAN, 0.0), None);
        assert_eq!(map.pixel(4), (1, 1));
    }
}
