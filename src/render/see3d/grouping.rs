//! Which views go through a network together.

use std::ops::Range;

/// Views that go through a network together, after the references.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Pictures of earlier groups that it begins with, so that the new ones go on from them. They are
    /// targets like the new ones; what becomes of them is dropped.
    pub carried: Vec<usize>,
    /// The new views.
    pub targets: Range<usize>,
}

/// Groups of at most `most` views, as even as can be. Each but the first begins with the last picture of
/// the one before: so would the original do, if its groups did not hold everything.
pub fn main_groups(views: usize, most: usize) -> Vec<Group> {
    let count = views.div_ceil(most.max(1));
    let start = |group: usize| group * (views / count) + group.min(views % count);
    let group = |k: usize| Group {
        carried: start(k).checked_sub(1).into_iter().collect(),
        targets: start(k)..start(k + 1),
    };
    (0..count).map(group).collect()
}

/// The original's groups for super-resolution: about half of all frames at a time, and each group but the
/// first begins with the picture half way through what there is, and the last.
pub fn super_resolution_groups(references: usize, views: usize) -> Vec<Group> {
    let size = (references + views + 3) / 2;
    let group = |start: usize| Group {
        carried: match start {
            0 => Vec::new(),
            _ => vec![start / 2, start - 1],
        },
        targets: start..(start + size).min(views),
    };
    (0..views).step_by(size).map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn group(carried: &[usize], targets: Range<usize>) -> Group {
        Group {
            carried: carried.to_vec(),
            targets,
        }
    }

    #[test]
    fn groups_are_even_and_carry_the_last_picture_on() {
        assert_eq!(main_groups(7, 9), [group(&[], 0..7)]);
        let three = [group(&[], 0..4), group(&[3], 4..7), group(&[6], 7..10)];
        assert_eq!(main_groups(10, 4), three);
        assert_eq!(main_groups(2, 1), [group(&[], 0..1), group(&[0], 1..2)]);
        assert_eq!(main_groups(0, 4), []);
    }

    #[test]
    fn super_resolution_takes_about_half_at_a_time() {
        // Case frame_grouping: 2 references and 7 views.
        assert_eq!(
            super_resolution_groups(2, 7),
            [group(&[], 0..6), group(&[3, 5], 6..7)]
        );
        assert_eq!(super_resolution_groups(1, 1), [group(&[], 0..1)]);
    }

    proptest! {
        #[test]
        fn each_view_is_in_one_group(views in 0..60_usize, most in 1..12_usize, references in 1..9_usize) {
            for groups in [main_groups(views, most), super_resolution_groups(references, views)] {
                let all: Vec<usize> = groups.iter().flat_map(|group| group.targets.clone()).collect();
                prop_assert_eq!(all, (0..views).collect::<Vec<_>>());
                for group in &groups {
                    prop_assert!(group.carried.iter().all(|&view| view < group.targets.start));
                }
            }
            prop_assert!(main_groups(views, most).iter().all(|group| group.targets.len() <= most));
        }
    }
}
