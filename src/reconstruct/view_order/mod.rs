//! Which photo a network sees as which view. The first is the reference view, whose frame becomes the
//! scene's; MV-DUSt3R+ has several, the first ones. A network does best if these see much of what
//! the others see.

mod features;
mod overlap;

use clap::ValueEnum;
use image::RgbImage;
use overlap::Overlaps;
use serde::{Deserialize, Serialize};

/// How the order of the views is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OrderChoice {
    /// The photo that shares most with the others first, then those that share most with the rest.
    #[default]
    Auto,
    /// As MV-DUSt3R's demo does: the first photo, then ones from all over the list, for photos taken
    /// one after another.
    Spread,
    /// The order in which the photos are given.
    File,
}

/// The order of the views: of photo `order[k]`, frame `pictures[order[k]]`, view k is made. The first
/// `references` views are reference views.
///
/// The same pictures in another order give the same views, but for ties, where the first one wins, if
/// the choice is [`OrderChoice::Auto`].
pub fn view_order(choice: OrderChoice, pictures: &[RgbImage], references: usize) -> Vec<usize> {
    match choice {
        OrderChoice::Auto => order_by_overlap(&Overlaps::measure(pictures), references),
        OrderChoice::Spread => spread_order(pictures.len()),
        OrderChoice::File => (0..pictures.len()).collect(),
    }
}

/// The order in which MV-DUSt3R's demo takes `count` pictures of a film, so that reference views are
/// no neighbours.
pub fn spread_order(count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    if count >= 12 {
        for reference in 1..=3 {
            order.swap(reference, count * reference / 4 + 1);
        }
        return order;
    }
    if count > 3 {
        order.swap(1, 3);
    }
    if count > 6 {
        order.swap(2, 6);
    }
    order
}

/// First the picture that shares most with all others; further references so that every picture shares
/// much with one of them (greedy facility location); then, one by one, what shares most with those
/// before it.
fn order_by_overlap(overlaps: &Overlaps, references: usize) -> Vec<usize> {
    let count = overlaps.count();
    let total = |a: usize| (0..count).map(|b| overlaps.between(a, b)).sum::<f64>();
    let mut order: Vec<usize> = Vec::with_capacity(count);
    while order.len() < count {
        let nearest = |b: usize, chosen: &[usize]| {
            let shared = chosen.iter().map(|&a| overlaps.between(a, b));
            shared.fold(0.0, f64::max)
        };
        let worth = |candidate: usize| -> f64 {
            if order.is_empty() {
                return total(candidate);
            }
            if order.len() < references {
                let with = |b| overlaps.between(candidate, b).max(nearest(b, &order));
                return (0..count).map(with).sum();
            }
            order.iter().map(|&a| overlaps.between(a, candidate)).sum()
        };
        let rest = (0..count).filter(|candidate| !order.contains(candidate));
        let best = rest.fold(None, |best: Option<(usize, [f64; 2])>, candidate| {
            // Two pictures that are new to all but each other are worth the same as references.
            let worth = [worth(candidate), total(candidate)];
            match best {
                Some((_, most)) if most >= worth => best,
                _ => Some((candidate, worth)),
            }
        });
        order.extend(best.map(|(candidate, _)| candidate));
    }
    order
}

#[cfg(test)]
mod tests;
