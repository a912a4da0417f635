//! Least absolute deviations: few pixels that are far off have little say.

use super::Pair;
use rayon::slice::ParallelSliceMut;

/// The s that minimises sum |s d - g| = sum d |s - g/d|: the median of the ratios g/d weighted by d,
/// the lowest one where an interval of s does equally well. There is at least one pair.
pub(super) fn l1_scale(pairs: &[Pair]) -> f64 {
    let mut pairs = pairs.to_vec();
    // By ratio, then by depth: a total order, so that the sums below do not depend on the sort, nor
    // on the order of the frames. A product of two f32 is exact in f64.
    pairs.par_sort_unstable_by(|a, b| {
        let left = f64::from(a.truth) * f64::from(b.predicted);
        let right = f64::from(b.truth) * f64::from(a.predicted);
        left.total_cmp(&right)
            .then(a.predicted.total_cmp(&b.predicted))
    });
    let total: f64 = pairs.iter().map(|pair| f64::from(pair.predicted)).sum();
    let mut below = 0.0;
    let median = pairs.iter().find(|pair| {
        below += f64::from(pair.predicted);
        2.0 * below >= total
    });
    let median = median.expect("the sum up to the last pair is the total");
    f64::from(median.truth) / f64::from(median.predicted)
}

/// The s and t that minimise sum |s d + t - g|; there is at least one pair.
///
/// With the best t for each s, the median of g - s d, the sum is a convex function of s: its slope is
/// followed from a first guess until it changes sign, and halved from there. Where an interval does
/// equally well (all d alike), the guess stays.
pub(super) fn l1_line(pairs: &[Pair]) -> (f64, f64) {
    /// So many pairs are enough for a guess.
    const FEW: usize = 1 << 16;
    /// How exact s is, as a share of the ratio of mean depths.
    const TOLERANCE: f64 = 1e-10;
    let sum = |of: fn(&Pair) -> f32| pairs.iter().map(|pair| f64::from(of(pair))).sum::<f64>();
    let unit = sum(|pair| pair.truth) / sum(|pair| pair.predicted);
    let (guess, first_step) = match pairs.len() {
        0..=FEW => (l1_scale(pairs), 1e-1),
        many => {
            let some: Vec<Pair> = pairs.iter().copied().step_by(many / FEW + 1).collect();
            (l1_line(&some).0, 1e-3)
        }
    };
    let mut residuals = Vec::with_capacity(pairs.len());
    let mut slope_at = |s: f64| slope(pairs, s, &mut residuals);
    let (slope_of_guess, t) = slope_at(guess);
    if slope_of_guess == 0.0 {
        return (guess, t);
    }
    let downhill = -slope_of_guess.signum();
    let mut step = first_step * unit * downhill;
    let (mut near, mut far) = (guess, guess + step);
    while slope_at(far).0 * downhill < 0.0 && (far + 2.0 * step).is_finite() {
        step *= 2.0;
        (near, far) = (far, far + step);
    }
    while (far - near).abs() > TOLERANCE * unit {
        let middle = near + 0.5 * (far - near);
        if middle == near || middle == far {
            break;
        }
        match slope_at(middle).0 * downhill < 0.0 {
            true => near = middle,
            false => far = middle,
        }
    }
    let best = near + 0.5 * (far - near);
    (best, slope_at(best).1)
}

/// The slope of the sum at s, with the best t (the lower median where several are), and that t.
fn slope(pairs: &[Pair], s: f64, residuals: &mut Vec<f64>) -> (f64, f64) {
    let residual = |pair: &Pair| f64::from(pair.truth) - s * f64::from(pair.predicted);
    residuals.clear();
    residuals.extend(pairs.iter().map(residual));
    let middle = (pairs.len() - 1) / 2;
    let t = *residuals.select_nth_unstable_by(middle, f64::total_cmp).1;
    // Pairs on the line are shared out so that as many lie above as below: the slope is that of one of
    // the tangents there.
    let (mut above, mut on, mut below) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    for pair in pairs {
        let side = match residual(pair).total_cmp(&t) {
            std::cmp::Ordering::Greater => &mut above,
            std::cmp::Ordering::Equal => &mut on,
            std::cmp::Ordering::Less => &mut below,
        };
        side[0] += 1.0;
        side[1] += f64::from(pair.predicted);
    }
    let share = (below[0] - above[0]) / on[0];
    (below[1] - above[1] - share * on[1], t)
}
