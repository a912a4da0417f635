//! Which frames of a video become photos.

use super::{Moment, VideoChoice};

/// A frame that was looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) moment: Moment,
    pub(super) sharpness: f64,
}

/// One sample for each of `count` equal parts of the time that `samples` cover, fewer where parts are empty. Of
/// those alike, the earliest. `samples` are in order of time.
pub(super) fn chosen(samples: &[Sample], count: usize, choice: VideoChoice) -> Vec<Moment> {
    let [first, .., last] = samples else {
        return samples.iter().map(|sample| sample.moment).collect();
    };
    let (start, span) = (first.moment.0, last.moment.0 - first.moment.0);
    // The last sample stands for as much time as the others do.
    let length = (span + span / (samples.len() as u64 - 1)).max(1);
    let part = |moment: Moment| {
        let place = u128::from(moment.0 - start) * count as u128;
        ((place / u128::from(length)) as usize).min(count - 1)
    };
    // Times twice the number of parts, which keeps it whole.
    let from_middle = |moment: Moment| {
        let place = 2 * u128::from(moment.0 - start) * count as u128;
        place.abs_diff((2 * part(moment) as u128 + 1) * u128::from(length))
    };
    let better = |a: &Sample, b: &Sample| match choice {
        VideoChoice::Sharp => a.sharpness > b.sharpness,
        VideoChoice::Uniform => from_middle(a.moment) < from_middle(b.moment),
    };
    let parts = samples.chunk_by(|a, b| part(a.moment) == part(b.moment));
    let best = parts.filter_map(|part| {
        part.iter()
            .reduce(|best, sample| if better(sample, best) { sample } else { best })
    });
    best.map(|sample| sample.moment).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames every 100 ms from 5 s on, of this sharpness.
    fn samples(sharpness: &[f64]) -> Vec<Sample> {
        let sample = |(k, &sharpness)| Sample {
            moment: Moment(5_000_000 + 100_000 * k as u64),
            sharpness,
        };
        sharpness.iter().enumerate().map(sample).collect()
    }

    fn numbers(sharpness: &[f64], count: usize, choice: VideoChoice) -> Vec<u64> {
        let chosen = chosen(&samples(sharpness), count, choice);
        chosen
            .iter()
            .map(|moment| (moment.0 - 5_000_000) / 100_000)
            .collect()
    }

    #[test]
    fn the_sharpest_frame_of_each_part_is_chosen_and_the_first_of_those_alike() {
        let sharpness = [1.0, 5.0, 2.0, 7.0, 7.0, 1.0, 0.0, 0.0, 9.0];
        assert_eq!(numbers(&sharpness, 3, VideoChoice::Sharp), [1, 3, 8]);
        assert_eq!(numbers(&sharpness, 1, VideoChoice::Sharp), [8]);
    }

    #[test]
    fn uniform_frames_are_the_middles_of_the_parts() {
        assert_eq!(numbers(&[0.0; 9], 3, VideoChoice::Uniform), [1, 4, 7]);
        assert_eq!(numbers(&[0.0; 90], 3, VideoChoice::Uniform), [15, 45, 75]);
        assert_eq!(
            numbers(&[0.0; 10], 10, VideoChoice::Uniform),
            [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
        );
    }

    #[test]
    fn no_frame_comes_twice_and_none_is_made_up() {
        for choice in [VideoChoice::Sharp, VideoChoice::Uniform] {
            assert_eq!(numbers(&[1.0, 2.0, 3.0], 16, choice), [0, 1, 2]);
            assert_eq!(numbers(&[1.0], 16, choice), [0]);
            assert!(numbers(&[], 16, choice).is_empty());
        }
    }

    #[test]
    fn parts_are_equal_in_time_not_in_frames() {
        // Nine frames in the first second, one at ten seconds: of five parts, three have none.
        let mut uneven = samples(&[1.0; 9]);
        uneven.push(Sample {
            moment: Moment(15_000_000),
            sharpness: 0.0,
        });
        let chosen = chosen(&uneven, 5, VideoChoice::Sharp);
        assert_eq!(chosen, [Moment(5_000_000), Moment(15_000_000)]);
    }
}
