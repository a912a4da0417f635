//! Photos out of videos, by FFmpeg.
//!
//! A video is gone through once, in small grey frames; of those, some are chosen by time, and only these are read
//! again as they are.

mod choice;
mod samples;
mod sharpness;
mod tool;

use super::{PHOTO_COUNT_LIMIT, decode, names::safe_name};
use crate::{Error, Result, progress::Progress, scene::files};
use choice::chosen;
use image::{ExtendedColorType, ImageEncoder, codecs::jpeg::JpegEncoder};
use samples::samples;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    fs, io,
    path::{Path, PathBuf},
};
use tool::{Tool, failed};

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
        let samples = samples(&self.path, params.frames, progress)?;
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_called_by_their_time() {
        let called = |microseconds| {
            Moment(microseconds)
                .called("walk")
                .to_str()
                .unwrap()
                .to_string()
        };
        assert_eq!(called(12_345_678), "walk_00m12s345.jpg");
        assert_eq!(called(0), "walk_00m00s000.jpg");
        assert_eq!(called(3_600_000_000 + 59_999_999), "walk_60m59s999.jpg");
    }

    #[test]
    fn counts_are_read_within_their_limits() {
        assert_eq!(parse_count("16"), Ok(16));
        for text in ["0", "1001", "-1", "many", ""] {
            assert!(parse_count(text).is_err(), "{text}");
        }
    }
}
