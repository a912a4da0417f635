use super::{
    GraphParams,
    colour::{self, Colour},
    grid::Grid,
};

/// Gives pixels without a label that of the neighbour nearest in colour, layer by layer, at most
/// `hole_reach` layers deep, and only where neighbours differ by no more than `pixel_colour`.
pub(super) fn fill_holes(
    labels: &mut [Option<u32>],
    colours: &[Colour],
    grid: &Grid,
    params: &GraphParams,
) {
    let around = |index| {
        [(-1, 0), (1, 0), (0, -1), (0, 1)]
            .into_iter()
            .filter_map(move |step| grid.neighbour(index, step))
    };
    let mut front: Vec<usize> = (0..labels.len())
        .filter(|&i| labels[i].is_none() && around(i).any(|n| labels[n].is_some()))
        .collect();
    for _ in 0..params.hole_reach {
        if front.is_empty() {
            break;
        }
        // A layer sees only the layers before it, so that no direction is preferred.
        let layer: Vec<(usize, u32)> = front
            .iter()
            .filter_map(|&i| {
                around(i)
                    .filter_map(|n| {
                        let label = labels[n]?;
                        Some((colour::difference(&colours[i], &colours[n]), label))
                    })
                    .filter(|&(difference, _)| difference <= params.pixel_colour)
                    .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
                    .map(|(_, label)| (i, label))
            })
            .collect();
        for &(i, label) in &layer {
            labels[i] = Some(label);
        }
        front = layer
            .iter()
            .flat_map(|&(i, _)| around(i))
            .filter(|&n| labels[n].is_none())
            .collect();
        front.sort_unstable();
        front.dedup();
    }
}

/// Numbers the labels 1, 2, ... by decreasing area (equal ones as they come in the image) and drops
/// those of fewer than `min_area` pixels: 0 is no mask.
pub(super) fn by_area(labels: &[Option<u32>], count: usize, min_area: usize) -> Vec<u32> {
    let mut area = vec![0usize; count];
    let mut first = vec![usize::MAX; count];
    for (index, &label) in labels.iter().enumerate() {
        if let Some(label) = label {
            area[label as usize] += 1;
            first[label as usize] = first[label as usize].min(index);
        }
    }
    let mut order: Vec<usize> = (0..count).filter(|&l| area[l] >= min_area.max(1)).collect();
    order.sort_unstable_by_key(|&l| (std::cmp::Reverse(area[l]), first[l]));
    let mut number = vec![0; count];
    for (place, &label) in order.iter().enumerate() {
        number[label] = place as u32 + 1;
    }
    labels
        .iter()
        .map(|label| label.map_or(0, |l| number[l as usize]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Intrinsics;

    fn row(width: u32) -> Grid {
        Grid::new(&Intrinsics {
            width,
            height: 1,
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
        })
        .unwrap()
    }

    #[test]
    fn holes_are_filled_by_colour_and_only_so_far() {
        let grey = |l: f32| [l, 0.0, 0.0];
        // Lightness counts half: 2 differs from 0 by 1, and from 40 by 19.
        let colours = [0.0, 2.0, 2.0, 40.0, 40.0, 40.0, 40.0, 40.0].map(grey);
        let mut labels = [Some(7), None, None, None, None, None, None, Some(3)];
        let params = GraphParams {
            hole_reach: 3,
            pixel_colour: 10.0,
            ..GraphParams::default()
        };
        fill_holes(&mut labels, &colours, &row(8), &params);
        let (a, b) = (Some(7), Some(3));
        assert_eq!(labels, [a, a, a, None, b, b, b, b]);
    }

    #[test]
    fn numbers_follow_the_area_and_small_ones_are_dropped() {
        let labels = [2, 0, 0, 1, 1, 3, 3, 3].map(Some);
        assert_eq!(by_area(&labels, 4, 2), [0, 2, 2, 3, 3, 1, 1, 1]);
        assert_eq!(by_area(&[None, None], 0, 0), [0, 0]);
    }
}
