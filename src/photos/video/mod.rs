//! Photos out of videos, by FFmpeg.
//!
//! A video is gone through once, in small grey frames; of those, some are chosen by time, and only these are read
//! again as they are.

mod choice;
mod sharpness;
mod tool;

use super::{PHOTO_COUNT_LIMIT, decode, names::safe_name};
use crate::{Error, Result, progress::Progress, scene::files};
use choice::{Sample, chosen};
use image::{ExtendedColorType, ImageEncoder, codecs::jpeg::JpegEncoder};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sharpness::sharpness;
use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};
use tool::{Tool, failed};

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
/// As large as a frame may be.
const FRAME_BYTES: u64 = 1 << 30;
const JPEG_QUALITY: u8 = 95;

/// Which frames of a video become photos.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, clap::Args)]
// Several structs that take it are in one command.
#[group(skip)]
pub struct VideoParams {
    /// How many frames of each video become photos, one of each of so many equal parts
    #[arg(id = "video_frames", long = "video-frames", value_name = "COUNT", default_value = "16", value_parser = parse_count)]
    pub frames: usize,
    /// Which frame of a part of a video becomes a photo
    #[arg(
        id = "video_choice",
        long = "video-choice",
        value_name = "CHOICE",
        value_enum,
        default_value = "sharp"
    )]
    pub choice: VideoChoice,
}

impl Default for VideoParams {
    fn default() -> Self {
        Self {
            frames: 16,
            choice: VideoChoice::Sharp,
        }
    }
}

/// Which frame stands for a part of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum VideoChoice {
    /// The sharpest (highest variance of the Laplacian)
    Sharp,
    /// The one in the middle
    Uniform,
}

fn parse_count(text: &str) -> Result<usize, String> {
    let count = text.parse().ok();
    let count = count.filter(|count| (1..=PHOTO_COUNT_LIMIT).contains(count));
    count.ok_or_else(|| format!("a number from 1 to {PHOTO_COUNT_LIMIT} is wanted"))
}

/// A time in a video, microseconds from its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Moment(u64);

impl Moment {
    /// What the photo of this moment is called.
    pub(super) fn called(self, video: &str) -> PathBuf {
        let milliseconds = self.0 / 1000;
        let (minutes, seconds) = (milliseconds / 60_000, milliseconds / 1000 % 60);
        format!(
            "{video}_{minutes:02}m{seconds:02}s{:03}.jpg",
            milliseconds % 1000
        )
        .into()
    }
}

/// A video file.
#[derive(Clone, Debug)]
pub(super) struct Video {
    path: PathBuf,
}

/// What was chosen, in a file beside the frames, so that a run that was stopped need not go through the video
/// again.
#[derive(PartialEq, Serialize, Deserialize)]
struct Record {
    of: Value,
    moments: Vec<Moment>,
}

impl Video {
    pub(super) fn new(path: &Path) -> Self {
        Self { path: path.into() }
    }

    /// What it is called.
    pub(super) fn called(&self) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        match self.path.parent() {
            Some(folder) => folder.join(safe_name(&name)),
            None => safe_name(&name).into(),
        }
    }

    /// What its photos depend on. Reading all of a video only to see that nothing has changed would take too
    /// long: its size stands for what it shows.
    pub(super) fn description(&self, params: &VideoParams) -> Value {
        let bytes = fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        json!({ "video": self.path, "bytes": bytes, "frames": params.frames, "choice": params.choice })
    }

    /// The moments of which there are to be photos, in order of time. `name` is the video's, `folder` where its
    /// photos go.
    ///
    /// # Errors
    /// When FFmpeg is not there, cannot read the video, or a file cannot be written.
    pub(super) fn choose(
        &self,
        name: &str,
        folder: &Path,
        params: &VideoParams,
        progress: &dyn Progress,
    ) -> Result<Vec<Moment>> {
        let of = self.description(params);
        let path = folder.join(format!("{name}.frames.json"));
        if let Ok(Record { of: known, moments }) = files::read_json(&path, "")
            && known == of
        {
            return Ok(moments);
        }
        let samples = self.samples(params, progress)?;
        let moments = chosen(&samples, params.frames, params.choice);
        if moments.is_empty() {
            return Err(failed("ffmpeg", &self.path, "it has no frames"));
        }
        // Frames of another video of this name would be taken for this one's.
        for moment in &moments {
            let stale = folder.join(moment.called(name));
            if stale.exists() {
                fs::remove_file(&stale).map_err(Error::io("remove", &stale))?;
            }
        }
        let record = Record { of, moments };
        files::write_json(&path, &record)?;
        Ok(record.moments)
    }

    /// Writes the frame of a moment to `path` as JPEG, unless it is there, and gives the path back.
    ///
    /// # Errors
    /// When FFmpeg is not there, cannot read the video, or the file cannot be written.
    pub(super) fn extract(&self, moment: Moment, path: PathBuf) -> Result<PathBuf> {
        if path.exists() {
            return Ok(path);
        }
        // The first frame from here on: a little earlier than its time, which is rounded.
        let from = moment.0.saturating_sub(1000);
        let seek = format!("{}.{:06}", from / 1_000_000, from % 1_000_000);
        let before = [
            "-hide_banner",
            "-nostdin",
            "-loglevel",
            "error",
            "-ss",
            &seek,
        ];
        let square_pixels = "scale=w=max(1\\,trunc(iw*sar+0.5)):h=ih,setsar=1,format=rgb24";
        let after = [
            "-map",
            "0:V:0",
            "-frames:v",
            "1",
            "-vf",
            square_pixels,
            "-c:v",
            "ppm",
            "-f",
            "image2pipe",
            "pipe:1",
        ];
        let ffmpeg = Tool::start("ffmpeg", &self.path, &before, &after, |_| false)?;
        let bytes = ffmpeg.whole_output(FRAME_BYTES, &self.path)?;
        if !bytes.starts_with(b"P6") {
            return Err(failed(
                "ffmpeg",
                &self.path,
                &format!("it gives no frame at {seek} s"),
            ));
        }
        let frame = decode(bytes, &self.path, true)?;
        files::write_atomically(&path, |out| {
            JpegEncoder::new_with_quality(out, JPEG_QUALITY)
                .write_image(
                    &frame,
                    frame.width(),
                    frame.height(),
                    ExtendedColorType::Rgb8,
                )
                .map_err(io::Error::other)
        })?;
        Ok(path)
    }

    /// The length in microseconds, if the file or its video stream says it.
    fn length(&self) -> Result<Option<u64>> {
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
        let ffprobe = Tool::start("ffprobe", &self.path, &before, &[], |_| false)?;
        let text = ffprobe.whole_output(1 << 20, &self.path)?;
        length(&text).map_err(|problem| failed("ffprobe", &self.path, problem))
    }

    /// Frames at even distances of time, and how sharp they are.
    fn samples(&self, params: &VideoParams, progress: &dyn Progress) -> Result<Vec<Sample>> {
        let length = self.length()?;
        let step = step(length, params.frames);
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
        let mut ffmpeg = Tool::start("ffmpeg", &self.path, &before, &after, move |line| {
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
        let values = sharpnesses(&mut ffmpeg.output, || progress.advance(1));
        progress.end();
        let values =
            values.map_err(|problem| failed("ffmpeg", &self.path, &problem.to_string()))?;
        ffmpeg.finish(&self.path)?;
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
            return Err(failed("ffmpeg", &self.path, &problem));
        }
        let samples = moments.into_iter().zip(values);
        Ok(samples
            .map(|(moment, sharpness)| Sample { moment, sharpness })
            .collect())
    }
}

/// How far apart in time frames are looked at, in microseconds.
fn step(length: Option<u64>, wanted: usize) -> u64 {
    let Some(length) = length else {
        return CLOSEST;
    };
    let fine = length / (SAMPLES_EACH * wanted as u64);
    fine.clamp(1, CLOSEST).max(length / SAMPLES)
}

/// The sharpness of each grey frame that comes.
fn sharpnesses(frames: &mut impl Read, looked_at: impl Fn()) -> io::Result<Vec<f64>> {
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
        looked_at();
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
mod tests;
