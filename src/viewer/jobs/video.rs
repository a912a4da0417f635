//! A video of numbered views, where there is an ffmpeg.

use crate::{progress::Progress, scene::files::TEMPORARY_PREFIX, viewer::gallery::VIDEO};
use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};

/// Makes a video of NAME_0001.png and so on in a folder. Without ffmpeg there is none; what else stands in its way is
/// told, and is no failure: the views are there.
pub(super) fn make(folder: &Path, name: &str, progress: &dyn Progress) {
    const FRAMES_PER_SECOND: &str = "24";
    let unfinished = format!("{TEMPORARY_PREFIX}{VIDEO}");
    let views = format!("{name}_%04d.png");
    let output = Command::new("ffmpeg")
        .args([
            "-nostdin",
            "-loglevel",
            "error",
            "-y",
            "-framerate",
            FRAMES_PER_SECOND,
            "-i",
            &views,
        ])
        // What players can show has even sides.
        .args([
            "-vf",
            "crop=trunc(iw/2)*2:trunc(ih/2)*2",
            "-pix_fmt",
            "yuv420p",
            &unfinished,
        ])
        .current_dir(folder)
        .stdin(Stdio::null())
        .output();
    let problem = match output {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return,
        Err(error) => error.to_string(),
        Ok(output) if !output.status.success() => {
            String::from_utf8_lossy(&output.stderr).trim().to_string()
        }
        Ok(_) => match fs::rename(folder.join(&unfinished), folder.join(VIDEO)) {
            Ok(()) => return,
            Err(error) => error.to_string(),
        },
    };
    progress.note(&format!("ffmpeg made no video: {problem}"));
}
