//! Going through a video, in small grey frames.

use super::{
    Moment,
    choice::Sample,
    sharpness::sharpness,
    tool::{Tool, failed},
};
use crate::{Error, Result, progress::Progress};
use serde_json::Value;
use std::{
    io::{self, Read},
    path::Path,
    sync::{Arc, Mutex},
};

/// Sides of the grey frames that are looked at, whatever the shape of the video: frames are only compared with
/// each other.
const GREY_SIDE: usize = 480;
/// Frames are looked at so often at most, in microseconds.
const CLOSEST: u64 = 100_000;
/// So many are looked at, where the length is known.
const SAMPLES: u64 = 3000;
/// In short videos, at least so many for each that is wanted.
const SAMPLES_EACH: u64 = 8;
/// Videos that go on beyond this are none: a day, where the length is not known.
const SAMPLE_LIMIT: usize = 864_000;

/// The length in microseconds, if the file or its video stream says it.
fn known_length(video: &Path) -> Result<Option<u64>> {
    let before = [
        "-v",
        "error",
        "-select_streams",
        "V:0",
        "-show_entries",
        "stream=duration:format=duration",
    ];
    let mut before = before.to_vec();
    before.extend(["-of", "json"]);
    let ffprobe = Tool::start("ffprobe", video, &before, &[], |_| false)?;
    let text = ffprobe.whole_output(1 << 20, video)?;
    length(&text).map_err(|problem| failed("ffprobe", video, problem))
}

/// Frames at even distances of time, and how sharp they are, fine enough to choose `wanted` of them.
///
/// # Errors
/// When FFmpeg is not there or cannot read the video.
pub(super) fn samples(video: &Path, wanted: usize, progress: &dyn Progress) -> Result<Vec<Sample>> {
    let length = known_length(video)?;
    let step = step(length, wanted);
    // FFmpeg's times are numbers of seconds: the difference of two may fall short.
    let least = step.saturating_sub(1000);
    let expected = length.map_or(0, |length| length.div_ceil(step));
    let filters = format!(
        "select=isnan(prev_selected_t)+gte(t-prev_selected_t\\,{}.{:06}),scale={GREY_SIDE}:{GREY_SIDE}:\
         flags=area,format=gray,settb=1/1000000,showinfo=checksum=0,setpts=N/10/TB",
        least / 1_000_000,
        least % 1_000_000,
    );
    // Rates without meaning, so that no frame is doubled or dropped.
    let after = [
        "-map", "0:V:0", "-vf", &filters, "-r", "10", "-c:v", "rawvideo", "-f", "rawvideo",
        "pipe:1",
    ];
    let before = ["-hide_banner", "-nostdin", "-nostats", "-loglevel", "info"];
    let heard = Arc::new(Mutex::new(Vec::new()));
    let told = heard.clone();
    let mut ffmpeg = Tool::start("ffmpeg", video, &before, &after, move |line| {
        let moment = moment(line);
        if let (Some(moment), Ok(mut moments)) = (moment, told.lock())
            && moments.len() <= SAMPLE_LIMIT
        {
            moments.push(moment);
        }
        line.contains("showinfo")
    })?;
    progress.begin(
        "looking through the video",
        usize::try_from(expected).unwrap_or(usize::MAX),
    );
    let values = sharpnesses(&mut ffmpeg.output, || {
        progress.advance(1);
        !progress.is_cancelled()
    });
    progress.end();
    if progress.is_cancelled() {
        return Err(Error::Cancelled);
    }
    let values = values.map_err(|problem| failed("ffmpeg", video, &problem.to_string()))?;
    ffmpeg.finish(video)?;
    let moments = heard
        .lock()
        .map(|mut moments| std::mem::take(&mut *moments))
        .unwrap_or_default();
    let in_order = moments.is_sorted();
    if moments.len() != values.len() || !in_order {
        let problem = format!(
            "ffmpeg gives {} frames and {} times",
            values.len(),
            moments.len()
        );
        return Err(failed("ffmpeg", video, &problem));
    }
    let samples = moments.into_iter().zip(values);
    Ok(samples
        .map(|(moment, sharpness)| Sample { moment, sharpness })
        .collect())
}

/// How far apart in time frames are looked at, in microseconds.
fn step(length: Option<u64>, wanted: usize) -> u64 {
    let Some(length) = length else {
        return CLOSEST;
    };
    let fine = length / (SAMPLES_EACH * wanted as u64);
    fine.clamp(1, CLOSEST).max(length / SAMPLES)
}

/// The sharpness of each grey frame that comes, for as long as `goes_on` says so after each.
fn sharpnesses(frames: &mut impl Read, goes_on: impl Fn() -> bool) -> io::Result<Vec<f64>> {
    let mut values = Vec::new();
    let mut frame = Vec::with_capacity(GREY_SIDE * GREY_SIDE);
    loop {
        frame.clear();
        frames
            .by_ref()
            .take((GREY_SIDE * GREY_SIDE) as u64)
            .read_to_end(&mut frame)?;
        if frame.is_empty() {
            return Ok(values);
        }
        if frame.len() < GREY_SIDE * GREY_SIDE {
            return Err(io::Error::other("it gives half a frame"));
        }
        if values.len() == SAMPLE_LIMIT {
            return Err(io::Error::other("it does not end"));
        }
        values.push(sharpness(&frame, GREY_SIDE));
        if !goes_on() {
            return Ok(values);
        }
    }
}

/// The moment of a frame, if this is a line of FFmpeg's filter `showinfo` about one. What is before the start is
/// at it.
fn moment(line: &str) -> Option<Moment> {
    let (_, of_frame) = line
        .split_once("showinfo")
        .filter(|(_, rest)| rest.contains("] n:"))?;
    let (_, time) = of_frame.split_once(" pts:")?;
    let time: i64 = time.split_whitespace().next()?.parse().ok()?;
    Some(Moment(u64::try_from(time).unwrap_or(0)))
}

/// The length in microseconds by what `ffprobe` says, if it says it.
fn length(text: &[u8]) -> Result<Option<u64>, &'static str> {
    let said: Value =
        serde_json::from_slice(text).map_err(|_| "it says nothing that makes sense")?;
    let stream = said["streams"]
        .get(0)
        .ok_or("there is no moving picture in it")?;
    let seconds = |of: &Value| {
        of["duration"]
            .as_str()
            .and_then(|text| text.parse::<f64>().ok())
    };
    let believable = |seconds: &f64| *seconds > 0.0 && *seconds < 1e7;
    let known = [stream, &said["format"]]
        .into_iter()
        .filter_map(seconds)
        .find(believable);
    Ok(known.map(|seconds| (seconds * 1e6) as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_length_is_the_streams_or_else_the_files() {
        let said = |text: &str| length(text.as_bytes());
        let both = r#"{"streams": [{"duration": "2.500000"}], "format": {"duration": "9.0"}}"#;
        assert_eq!(said(both), Ok(Some(2_500_000)));
        let format = r#"{"programs": [], "streams": [{}], "format": {"duration": "9.0"}}"#;
        assert_eq!(said(format), Ok(Some(9_000_000)));
        for unknown in ["N/A", "-1", "nan", "inf", "1e300"] {
            let text = format!(r#"{{"streams": [{{"duration": "{unknown}"}}], "format": {{}}}}"#);
            assert_eq!(said(&text), Ok(None), "{unknown}");
        }
        assert!(said(r#"{"streams": [], "format": {"duration": "9.0"}}"#).is_err());
        assert!(said("{}").is_err() && said("").is_err() && said("\u{1}garbage").is_err());
    }

    #[test]
    fn times_are_read_from_lines_about_frames_only() {
        let line = "[Parsed_showinfo_4 @ 0x5581] n:   3 pts: 300033 pts_time:0.300033 duration: 0 fmt:gray";
        assert_eq!(moment(line), Some(Moment(300_033)));
        let early = "[Parsed_showinfo_4 @ 0x5581] n:   0 pts: -33333 pts_time:-0.033 fmt:gray";
        assert_eq!(moment(early), Some(Moment(0)));
        for other in [
            "[Parsed_showinfo_4 @ 0x5581] config in time_base: 1/1000000, frame_rate: 30/1",
            "[Parsed_showinfo_4 @ 0x5581] n:   3 pts: NOPTS pts_time:NOPTS",
            "[Parsed_showinfo_4 @ 0x5581] n:   3 pts:",
            "[h264 @ 0x5581] n: 3 pts: 12",
            "",
        ] {
            assert_eq!(moment(other), None, "{other}");
        }
    }

    #[test]
    fn long_videos_are_looked_at_less_often_and_short_ones_more() {
        let seconds = |seconds: u64| Some(seconds * 1_000_000);
        assert_eq!(step(seconds(60), 16), CLOSEST);
        assert_eq!(step(seconds(7200), 16), 2_400_000);
        // 2 s: 128 frames for 16.
        assert_eq!(step(seconds(2), 16), 15_625);
        assert_eq!(step(None, 16), CLOSEST);
        assert!(step(Some(1), 1000) > 0);
    }

    #[test]
    fn grey_frames_are_whole_or_refused() {
        let bytes = |frames: usize, more: usize| vec![9; frames * GREY_SIDE * GREY_SIDE + more];
        let values = |bytes: Vec<u8>| sharpnesses(&mut &*bytes, || true);
        assert_eq!(values(bytes(3, 0)).unwrap(), [0.0; 3]);
        assert!(values(bytes(0, 0)).unwrap().is_empty());
        assert!(values(bytes(2, 5)).is_err());
    }
}
