use serde::{Serialize, Serializer};
use std::{fmt, str::FromStr};

/// Frames asked for by number: `3`, `0,10,20`, `0-100:10` (last included) or a mixture.
///
/// Ranges are kept as ranges: one that nobody could mean (`0-999999999999`) costs nothing to hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameList(Vec<Range>);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Range {
    first: u64,
    last: u64,
    step: u64,
}

impl FrameList {
    /// These frames, one by one.
    pub fn of(numbers: &[u64]) -> Self {
        let single = |&number: &u64| Range {
            first: number,
            last: number,
            step: 1,
        };
        Self(numbers.iter().map(single).collect())
    }

    /// The numbers in the order given; a number given twice comes twice.
    pub fn numbers(&self) -> impl Iterator<Item = u64> {
        self.0.iter().flat_map(|range| {
            let next = |number: &u64| number.checked_add(range.step).filter(|n| *n <= range.last);
            std::iter::successors(Some(range.first), next)
        })
    }
}

impl FromStr for FrameList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split(',')
            .map(|part| {
                Range::from_str(part.trim()).map_err(|problem| {
                    format!("`{part}` {problem}; write numbers and ranges as in 3,10,20-100:10")
                })
            })
            .collect::<Result<_, _>>()
            .map(Self)
    }
}

impl FromStr for Range {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
            let parsed = text.parse().ok().filter(|_| digits);
            parsed.ok_or_else(|| "is no frame number".to_string())
        };
        let Some((first, rest)) = text.split_once('-') else {
            let first = number(text)?;
            return Ok(Self {
                first,
                last: first,
                step: 1,
            });
        };
        let (last, step) = match rest.split_once(':') {
            Some((last, step)) => (number(last)?, number(step)?),
            None => (number(rest)?, 1),
        };
        let first = number(first)?;
        if last < first {
            return Err("runs backwards".into());
        }
        if step == 0 {
            return Err("has a step of 0".into());
        }
        Ok(Self { first, last, step })
    }
}

impl fmt::Display for FrameList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, range) in self.0.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            write!(f, "{comma}{}", range.first)?;
            if range.last > range.first {
                write!(f, "-{}", range.last)?;
                if range.step > 1 {
                    write!(f, ":{}", range.step)?;
                }
            }
        }
        Ok(())
    }
}

impl Serialize for FrameList {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbers(text: &str) -> Vec<u64> {
        text.parse::<FrameList>().unwrap().numbers().collect()
    }

    #[test]
    fn numbers_and_ranges_mix_in_the_order_given() {
        assert_eq!(numbers("3"), [3]);
        assert_eq!(numbers("0, 10,007"), [0, 10, 7]);
        assert_eq!(numbers("20-23,5"), [20, 21, 22, 23, 5]);
        assert_eq!(numbers("0-100:25"), [0, 25, 50, 75, 100]);
        assert_eq!(numbers("0-99:25"), [0, 25, 50, 75]);
        assert_eq!(numbers("4-4:9"), [4]);
    }

    #[test]
    fn the_largest_numbers_end() {
        let max = u64::MAX;
        assert_eq!(numbers(&format!("{}-{max}:2", max - 1)), [max - 1]);
    }

    #[test]
    fn what_is_no_list_is_refused() {
        let wrong = [
            "",
            ",",
            "1,",
            "a",
            "-3",
            "+3",
            "1-",
            "9-3",
            "1-5:0",
            "1-5:",
            "1:2",
            "1.5",
            "1-2-3",
            "99999999999999999999",
        ];
        for text in wrong {
            assert!(text.parse::<FrameList>().is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn a_list_survives_being_written(
            ranges in prop::collection::vec((0..1000u64, 0..100u64, 1..20u64), 1..6),
        ) {
            let text = ranges.iter().map(|(first, more, step)| format!("{first}-{}:{step}", first + more));
            let list: FrameList = text.collect::<Vec<_>>().join(",").parse().unwrap();
            let back: FrameList = list.to_string().parse().unwrap();
            prop_assert!(list.numbers().eq(back.numbers()));
        }
    }
}
