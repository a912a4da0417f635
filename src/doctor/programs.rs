use super::{Finding, Part, State};
use std::process::{Command, Stdio};

/// What is used where it is there: FFmpeg for videos, and the decoder of HEIC.
pub(super) fn findings() -> Vec<Finding> {
    vec![ffmpeg(), heic()]
}

fn ffmpeg() -> Finding {
    let finding = |state, text: String| Finding::new(Part::Extras, "ffmpeg", state, text);
    let [ffmpeg, ffprobe] = ["ffmpeg", "ffprobe"].map(version);
    match (ffmpeg, ffprobe) {
        (Some(version), Some(_)) => {
            finding(State::Ok, format!("{version}; videos can be read and made"))
        }
        (ffmpeg, _) => {
            let name = if ffmpeg.is_none() {
                "ffmpeg"
            } else {
                "ffprobe"
            };
            finding(
                State::Missing,
                format!("no `{name}` on the PATH that runs, so no videos"),
            )
            .fix("install FFmpeg, where photos come from videos")
        }
    }
}

/// What a program of FFmpeg says that it is; `None` where it is not there or does not run.
fn version(program: &str) -> Option<String> {
    let mut command = Command::new(program);
    let output = command.arg("-version").stdin(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let mut words = text.lines().next()?.split_whitespace();
    let version = words.nth(2)?.chars().take(40).collect();
    output.status.success().then_some(version)
}

fn heic() -> Finding {
    let finding = |state, text| Finding::new(Part::Extras, "heic", state, text);
    match cfg!(feature = "heic") {
        true => finding(State::Ok, "built in: photos of iPhones can be read"),
        false => finding(
            State::Missing,
            "not built in, so no photos of iPhones as they are",
        )
        .fix("convert them to JPEG, or build tid3r with `--features heic`"),
    }
}
