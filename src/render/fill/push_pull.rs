//! Smooth interpolation of scattered pixels over all scales.

use crate::Map;

/// A pixel to interpolate from, or (importance 0) to be filled.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    /// Red, green, blue, depth: all are done in one go.
    pub value: [f32; 4],
    /// How much the pixel counts beside others; 0 where the value is unknown.
    pub importance: f32,
}

/// Fills unknown cells from the known ones around them: means of 2x2 blocks up a pyramid, then down
/// again into what is unknown (push-pull: Gortler et al. 1996, "The Lumigraph", section 3.4; here
/// with importances, which weigh the means and the interpolation). Known cells stay.
pub(super) fn push_pull(cells: &mut Map<Cell>) {
    if cells.len() <= 1 || cells.values().iter().all(|cell| cell.importance > 0.0) {
        return;
    }
    let mut coarse = halve(cells);
    push_pull(&mut coarse);
    for index in 0..cells.len() {
        if cells.values()[index].importance <= 0.0 {
            let (x, y) = cells.pixel(index);
            cells.values_mut()[index] = interpolate(&coarse, x, y);
        }
    }
}

/// The mean of cells that count with `share * importance` each. Its importance is the mean one.
fn blend(cells: impl Iterator<Item = (f32, Cell)>) -> Cell {
    let (mut value, mut total, mut known) = ([0.0; 4], 0.0, 0.0);
    for (share, cell) in cells.filter(|(_, cell)| cell.importance > 0.0) {
        let weight = share * cell.importance;
        value = std::array::from_fn(|c| value[c] + weight * cell.value[c]);
        total += weight;
        known += share;
    }
    if total <= 0.0 {
        return Cell::default();
    }
    Cell {
        value: value.map(|sum| sum / total),
        importance: total / known,
    }
}

fn halve(cells: &Map<Cell>) -> Map<Cell> {
    let (width, height) = (cells.width().div_ceil(2), cells.height().div_ceil(2));
    Map::from_fn(width, height, |x, y| {
        let block = [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter();
        let block = block.map(|(dx, dy)| (2 * x + dx, 2 * y + dy));
        let inside = block.filter(|&(x, y)| x < cells.width() && y < cells.height());
        blend(inside.map(|at| (1.0, cells[at])))
    })
}

/// The coarse map at the centre of the fine pixel (x, y), bilinear.
fn interpolate(coarse: &Map<Cell>, x: u32, y: u32) -> Cell {
    let axis = |at: u32, size: u32| {
        let at = (at as f32 + 0.5) / 2.0 - 0.5;
        let low = (at.floor().max(0.0) as u32).min(size - 1);
        let share = (at - low as f32).clamp(0.0, 1.0);
        [(low, 1.0 - share), ((low + 1).min(size - 1), share)]
    };
    let columns = axis(x, coarse.width());
    let rows = axis(y, coarse.height());
    blend(
        rows.into_iter().flat_map(|(y, in_row)| {
            columns.map(|(x, in_column)| (in_row * in_column, coarse[(x, y)]))
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(value: f32, importance: f32) -> Cell {
        Cell {
            value: [value; 4],
            importance,
        }
    }

    #[test]
    fn known_cells_stay_and_gaps_take_values_between_them() {
        let cells = Map::from_fn(33, 17, |x, _| match x {
            0..8 => cell(10.0, 1.0),
            8..25 => Cell::default(),
            _ => cell(30.0, 1.0),
        });
        let mut filled = cells.clone();
        push_pull(&mut filled);
        for (got, was) in filled.values().iter().zip(cells.values()) {
            assert!(was.importance == 0.0 || got == was);
            assert!((9.999..=30.001).contains(&got.value[0]));
        }
        assert!(filled[(9, 8)].value[0] < filled[(23, 8)].value[0]);
    }

    #[test]
    fn importance_decides_between_two_sides() {
        let mut cells = Map::from_fn(32, 24, |x, _| match x {
            0..12 => cell(0.0, 0.004),
            12..20 => Cell::default(),
            _ => cell(100.0, 1.0),
        });
        push_pull(&mut cells);
        assert!(cells[(13, 12)].value[0] > 80.0 && cells[(19, 12)].value[0] > 95.0);
    }

    #[test]
    fn one_known_cell_fills_everything_and_none_fills_nothing() {
        let mut cells = Map::filled(20, 11, Cell::default());
        cells[(3, 7)] = cell(5.0, 0.1);
        push_pull(&mut cells);
        assert!(
            cells
                .values()
                .iter()
                .all(|c| (c.value[2] - 5.0).abs() < 1e-4)
        );
        let mut none = Map::filled(5, 5, Cell::default());
        push_pull(&mut none);
        assert!(none.values().iter().all(|c| c.importance == 0.0));
    }
}
