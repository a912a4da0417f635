use super::{FrameList, ImportOptions, listing::Entry, poses::Rows};
use crate::{Error, Result};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

/// The photos of a recording that are used.
pub(super) struct Selection<'a> {
    /// In the order asked for; these have depth.
    pub(super) inputs: Vec<Chosen<'a>>,
    /// In the order asked for; these may lack depth.
    pub(super) held_out: Vec<Chosen<'a>>,
    /// What the user should know.
    pub(super) warnings: Vec<String>,
}

/// A photo of the recording with its pose.
pub(super) struct Chosen<'a> {
    pub(super) entry: &'a Entry,
    pub(super) rows: Rows,
}

impl<'a> Selection<'a> {
    /// The photos that `options` ask for, of all `entries` of the recording in `folder`.
    pub(super) fn choose(
        entries: &'a [Entry],
        folder: &Path,
        options: &ImportOptions,
    ) -> Result<Self> {
        let find = |list: &Option<FrameList>, option| match list {
            Some(list) => find(entries, folder, list, option),
            None => Ok(Vec::new()),
        };
        let asked_for = find(&options.frames, "--frames")?;
        let test = find(&options.test_frames, "--test-frames")?;
        let test_numbers: BTreeSet<u64> = test.iter().map(|entry| entry.number).collect();
        let in_both = asked_for.iter().map(|entry| entry.number);
        let in_both: Vec<u64> = in_both.filter(|n| test_numbers.contains(n)).collect();
        if !in_both.is_empty() {
            return Err(Error::request(
                format!(
                    "--frames and --test-frames both name {}",
                    abbreviated(&in_both)
                ),
                "a photo is either used or held out: remove it from one of them",
            ));
        }
        let mut warnings = Vec::new();
        let inputs = if options.frames.is_some() {
            asked_for
                .into_iter()
                .map(|entry| required(entry, true))
                .collect::<Result<_>>()?
        } else {
            let rest = entries
                .iter()
                .filter(|entry| !test_numbers.contains(&entry.number));
            let usable = usable(rest, folder, &mut warnings)?;
            evenly_spaced(usable, options.max_frames as usize, &mut warnings)
        };
        let held_out = test.into_iter().map(|entry| required(entry, false));
        Ok(Self {
            inputs,
            held_out: held_out.collect::<Result<_>>()?,
            warnings,
        })
    }
}

/// The entries that `list` names, each once.
fn find<'a>(
    entries: &'a [Entry],
    folder: &Path,
    list: &FrameList,
    option: &str,
) -> Result<Vec<&'a Entry>> {
    let by_number: BTreeMap<u64, &Entry> = entries.iter().map(|e| (e.number, e)).collect();
    let mut seen = BTreeSet::new();
    let mut found = Vec::new();
    // Stops at the first number that does not exist, so endless ranges end here.
    for number in list.numbers() {
        let Some(entry) = by_number.get(&number) else {
            let all: Vec<u64> = by_number.into_keys().collect();
            return Err(Error::file(
                folder,
                format!("there is no frame {number}, which {option} asks for"),
                format!("there are {}", abbreviated(&all)),
            ));
        };
        if seen.insert(number) {
            found.push(*entry);
        }
    }
    Ok(found)
}

/// An entry that was asked for by number, which must have what it takes.
fn required(entry: &Entry, needs_depth: bool) -> Result<Chosen<'_>> {
    let Some(rows) = entry.pose.load()? else {
        return Err(Error::file(
            entry.pose.path(),
            format!(
                "gives frame {} no pose (missing, or not finite numbers)",
                entry.number
            ),
            "do not ask for this frame",
        ));
    };
    if needs_depth && entry.depth.is_none() {
        return Err(Error::file(
            entry.photo.path(),
            format!("frame {} has no depth image", entry.number),
            "do not ask for this frame, or hold it out with --test-frames",
        ));
    }
    Ok(Chosen { entry, rows })
}

/// The entries that have what an input takes.
fn usable<'a>(
    entries: impl Iterator<Item = &'a Entry>,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<Chosen<'a>>> {
    let mut usable = Vec::new();
    let mut without_pose = Vec::new();
    let mut without_depth = Vec::new();
    for entry in entries {
        match entry.pose.load()? {
            None => without_pose.push(entry.number),
            Some(_) if entry.depth.is_none() => without_depth.push(entry.number),
            Some(rows) => usable.push(Chosen { entry, rows }),
        }
    }
    for (numbers, lack) in [
        (without_pose, "no pose (missing, or not finite numbers)"),
        (without_depth, "no depth image"),
    ] {
        if !numbers.is_empty() {
            warnings.push(format!(
                "left out the frames with {lack}: {}",
                abbreviated(&numbers)
            ));
        }
    }
    if usable.is_empty() {
        let reasons = if warnings.is_empty() {
            "all are held out".to_string()
        } else {
            warnings.join("; ")
        };
        return Err(Error::file(
            folder,
            format!("no frame can be used: {reasons}"),
            "an input takes a photo, a depth image and a pose, and must not be held out",
        ));
    }
    Ok(usable)
}

/// At most `limit` of `all`, the first and the last among them.
fn evenly_spaced<'a>(
    all: Vec<Chosen<'a>>,
    limit: usize,
    warnings: &mut Vec<String>,
) -> Vec<Chosen<'a>> {
    let count = all.len();
    if count <= limit {
        return all;
    }
    let intervals = limit.saturating_sub(1).max(1);
    let wanted: BTreeSet<usize> = (0..limit)
        .map(|i| (2 * i * (count - 1) + intervals) / (2 * intervals))
        .collect();
    let places = all.into_iter().enumerate();
    let chosen: Vec<Chosen> = places
        .filter(|(place, _)| wanted.contains(place))
        .map(|(_, chosen)| chosen)
        .collect();
    let numbers: Vec<u64> = chosen.iter().map(|chosen| chosen.entry.number).collect();
    warnings.push(format!(
        "using {} of {count} frames, evenly spaced: {}; choose with --frames or --max-frames",
        chosen.len(),
        abbreviated(&numbers)
    ));
    chosen
}

fn abbreviated(numbers: &[u64]) -> String {
    let join = |numbers: &[u64]| {
        let texts: Vec<String> = numbers.iter().map(u64::to_string).collect();
        texts.join(", ")
    };
    match numbers {
        [first @ .., last] if first.len() > 12 => {
            format!(
                "{}, ... {last} ({} in all)",
                join(&first[..8]),
                numbers.len()
            )
        }
        _ => join(numbers),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::recording::{
        Lens,
        listing::{DepthSource, PhotoSource, PoseSource},
    };

    const IDENTITY: Rows = [
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];

    /// Frames 0, 10, .. 990; 30 has no pose, 40 no depth.
    fn entries() -> Vec<Entry> {
        let entry = |number| Entry {
            number,
            name: number.to_string(),
            photo: PhotoSource::File(format!("{number}.png").into()),
            depth: (number != 40).then(|| DepthSource::Picture {
                path: "depth.png".into(),
                units_per_length: 1000.0,
            }),
            pose: PoseSource::Known("poses.txt".into(), (number != 30).then_some(IDENTITY)),
            lens: Lens {
                fx: 585.0,
                fy: 585.0,
                cx: 320.0,
                cy: 240.0,
            }
            .into(),
            depth_lens: None,
            lens_from: "k.txt".into(),
        };
        (0..100).map(|i| entry(10 * i)).collect()
    }

    fn choose(frames: &str, test_frames: &str, max_frames: u32) -> Result<[Vec<u64>; 2], String> {
        let list = |text: &str| (!text.is_empty()).then(|| text.parse().unwrap());
        let options = ImportOptions {
            frames: list(frames),
            test_frames: list(test_frames),
            max_frames,
            ..ImportOptions::default()
        };
        let entries = entries();
        let selection = Selection::choose(&entries, Path::new("room"), &options);
        let selection = selection.map_err(|error| error.to_string())?;
        let numbers = |chosen: &[Chosen]| chosen.iter().map(|c| c.entry.number).collect();
        Ok([numbers(&selection.inputs), numbers(&selection.held_out)])
    }

    #[test]
    fn frames_come_in_the_order_asked_for_and_once() {
        let [inputs, held_out] = choose("50,0-20:10,10", "40,60", 1).unwrap();
        assert_eq!(inputs, [50, 0, 10, 20]);
        assert_eq!(held_out, [40, 60]);
    }

    #[test]
    fn without_a_list_frames_are_spaced_evenly_over_what_can_be_used() {
        let [inputs, _] = choose("", "", 3).unwrap();
        // 98 usable frames: places 0, 49 (48.5 rounded up) and 97; 30 and 40 are left out before.
        assert_eq!(inputs, [0, 510, 990]);
        let [inputs, _] = choose("", "0,990", 3).unwrap();
        assert_eq!((inputs[0], inputs[2]), (10, 980));
        assert_eq!(choose("", "", 1).unwrap()[0], [0]);
        assert_eq!(choose("", "", 200).unwrap()[0].len(), 98);
    }

    #[test]
    fn what_cannot_be_met_is_refused_with_the_numbers() {
        for (frames, test_frames, word) in [
            (
                "5",
                "",
                "there are 0, 10, 20, 30, 40, 50, 60, 70, ... 990 (100 in all)",
            ),
            ("0-18446744073709551615", "", "no frame 1,"),
            ("0", "991", "no frame 991, which --test-frames"),
            ("0-50:10", "20,50", "both name 20, 50"),
            ("30", "", "frame 30 no pose"),
            ("40", "", "frame 40 has no depth"),
            ("0", "30", "frame 30 no pose"),
            ("", "0-990:10", "no frame can be used: all are held out"),
            (
                "",
                "0-20:10,40-990:10",
                "no frame can be used: left out the frames with no pose",
            ),
        ] {
            let message = choose(frames, test_frames, 20).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn what_was_left_out_is_told() {
        let entries = entries();
        let options = ImportOptions::default();
        let selection = Selection::choose(&entries, Path::new("room"), &options).unwrap();
        let told = selection.warnings.join("\n");
        for word in [
            "no pose (missing, or not finite numbers): 30",
            "no depth image: 40",
            "using 20 of 98",
        ] {
            assert!(told.contains(word), "{told}");
        }
    }
}
