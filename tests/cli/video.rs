//! Photos out of videos: by FFmpeg where it is installed, and by programs in its place that fail in every way.

use crate::{
    Place,
    place::{PROGRAM, assert_same_files},
};
use assert_cmd::Command;
use std::{fs, process};

/// With tiny weights in `mvd`.
fn place() -> Place {
    let place = Place::new();
    place.run_loud("weights synthesize mvdust3r --tiny -o mvd");
    place
}

/// Whether FFmpeg does this; none where it is not installed.
fn ffmpeg(place: &Place, arguments: &[&str]) -> Option<bool> {
    let done = process::Command::new("ffmpeg")
        .args(["-v", "quiet", "-nostdin", "-y"])
        .args(arguments)
        .current_dir(place.folder())
        .status();
    done.ok().map(|status| status.success())
}

/// Makes a video with FFmpeg; `false` where it is not installed.
fn film(place: &Place, arguments: &[&str]) -> bool {
    let made = ffmpeg(place, arguments);
    assert_ne!(made, Some(false), "{arguments:?}");
    #[expect(clippy::print_stderr, reason = "says what was not tested")]
    if made.is_none() {
        eprintln!("skipped: there is no ffmpeg on the PATH");
    }
    made.is_some()
}

/// Four seconds of a picture that moves, at 10 frames a second; blurred but for frames 5, 15, 25 and 35.
const FOUR_SECONDS: &[&str] = &[
    "-f",
    "lavfi",
    "-i",
    "testsrc2=size=96x64:rate=10:duration=4",
    "-vf",
    "boxblur=3:enable='not(eq(mod(n,10),5))'",
    "-c:v",
    "mpeg4",
    "-q:v",
    "2",
];

fn with_file(file: &'static str) -> Vec<&'static str> {
    [FOUR_SECONDS, &[file]].concat()
}

#[test]
fn the_sharpest_frame_of_each_part_becomes_a_photo() {
    let place = place();
    if !film(&place, &with_file("./-x.mp4")) {
        return;
    }
    let make = "reconstruct --weights mvd --size 48 --video-frames 4";
    place.run_loud(&format!("{make} -o scene -- -x.mp4"));
    let files = place.files("scene/photos");
    let names: Vec<&String> = files.keys().collect();
    let wanted = ["00m00s500", "00m01s500", "00m02s500", "00m03s500"];
    let mut wanted = wanted.map(|time| format!("-x_{time}.jpg")).to_vec();
    wanted.insert(0, "-x.frames.json".into());
    assert_eq!(names, wanted.iter().collect::<Vec<_>>());
    for name in &wanted[1..] {
        let photo = image::load_from_memory(&files[name]).unwrap();
        assert_eq!((photo.width(), photo.height()), (96, 64));
    }
    let times = place.times("scene");
    place.run(&format!("{make} -o scene -- -x.mp4"));
    assert_eq!(place.times("scene"), times, "nothing to do");

    // Stopped on the way: frames that are there stay, and the video is not gone through again.
    fs::remove_file(place.path("scene/scene.json")).unwrap();
    fs::remove_file(place.path("scene/photos/-x_00m01s500.jpg")).unwrap();
    let whole = place.times("scene/photos");
    place.run_loud(&format!("{make} -o scene -- -x.mp4"));
    assert_same_files(&place.files("scene/photos"), &files);
    for (name, time) in whole {
        assert_eq!(place.times("scene/photos")[&name], time, "{name}");
    }

    let message =
        place.fail("reconstruct --weights mvd --size 48 --video-frames 5 -o scene -- -x.mp4");
    assert!(message.contains("--force"), "{message}");
    place.run_loud(
        "reconstruct --weights mvd --size 48 --video-frames 2 --video-choice uniform -o even -- -x.mp4",
    );
    let names: Vec<String> = place.files("even/photos").into_keys().collect();
    assert_eq!(
        names,
        ["-x.frames.json", "-x_00m01s000.jpg", "-x_00m03s000.jpg"]
    );
}

#[test]
fn frames_are_upright_with_square_pixels_and_those_that_were_looked_at() {
    let place = place();
    // Each frame is as bright as its number says. Pixels are half as wide as high.
    let grey =
        "color=black:size=64x64:rate=30:duration=1,geq=lum='16+7*N':cb=128:cr=128,setsar=1/2";
    let encoded = [
        "-f", "lavfi", "-i", grey, "-c:v", "mpeg4", "-q:v", "1", "-g", "12", "flat.mp4",
    ];
    if !film(&place, &encoded) {
        return;
    }
    // As a telephone writes it that is held upright; before FFmpeg 6 in another way.
    let turn = [
        "-display_rotation",
        "90",
        "-i",
        "flat.mp4",
        "-c",
        "copy",
        "turned.mov",
    ];
    if ffmpeg(&place, &turn) == Some(false) {
        let turn = [
            "-i",
            "flat.mp4",
            "-c",
            "copy",
            "-metadata:s:v:0",
            "rotate=90",
            "turned.mov",
        ];
        assert!(film(&place, &turn));
    }
    for (film, size) in [("flat.mp4", (32, 64)), ("turned.mov", (128, 64))] {
        place.run_loud(&format!(
            "reconstruct {film} --weights mvd --size 48 --video-frames 5 --video-choice uniform -o {film}.scene"
        ));
        let photos = place.files(&format!("{film}.scene/photos"));
        assert_eq!(photos.len(), 6);
        for (name, bytes) in photos.iter().filter(|(name, _)| name.ends_with(".jpg")) {
            let photo = image::load_from_memory(bytes).unwrap().into_luma8();
            assert_eq!(photo.dimensions(), size, "{film}");
            // FILM_00m00s233: frame 7, 16 + 7 * 7 in 16 to 235.
            let stem = name.strip_suffix(".jpg").unwrap();
            let [seconds, milliseconds] = [
                &stem[stem.len() - 6..stem.len() - 4],
                &stem[stem.len() - 3..],
            ];
            let time: f64 = format!("{seconds}.{milliseconds}").parse().unwrap();
            let wanted = 7.0 * (30.0 * time).round() * 255.0 / 219.0;
            let found = f64::from(photo.get_pixel(16, 16)[0]);
            assert!(
                (found - wanted).abs() < 4.0,
                "{name}: {found}, not {wanted}"
            );
        }
    }
}

#[test]
fn what_is_no_video_is_an_error_of_the_file() {
    let place = place();
    let mp4 = b"\0\0\0\x18ftypmp42\0\0\0\0isomiso2";
    place.write("x.mp4", mp4);
    if film(
        &place,
        &["-f", "lavfi", "-i", "sine=duration=1", "sound.mp4"],
    ) {
        let message = place.fail("reconstruct x.mp4 -o scene --weights mvd --size 48");
        assert!(
            message.starts_with("x.mp4: is no video that ffprobe can read"),
            "{message}"
        );
        let message = place.fail("reconstruct sound.mp4 -o scene --weights mvd --size 48");
        assert!(message.contains("no moving picture"), "{message}");
    }
    place.misuse("reconstruct x.mp4 -o scene --video-frames 0");
    place.misuse("reconstruct x.mp4 -o scene --video-choice best");
    place.misuse("segment scene --video-frames 3");
}

/// What is said where `ffprobe` and `ffmpeg` are these scripts, or are not there.
#[cfg(unix)]
fn fail_with(place: &Place, scripts: Option<[&str; 2]>) -> String {
    use std::os::unix::fs::PermissionsExt;
    let folder = place.path("bin");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir(&folder).unwrap();
    for (name, script) in ["ffprobe", "ffmpeg"]
        .iter()
        .zip(scripts.into_iter().flatten())
    {
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\nPATH=/usr/bin:/bin\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let output = Command::new(PROGRAM)
        .args(["reconstruct", "x.mp4", "-o", "scene", "--weights", "mvd"])
        .current_dir(place.folder())
        .env("PATH", &folder)
        .output()
        .unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(
        err.starts_with("error: ") && !err.contains("panicked"),
        "{err}"
    );
    assert_eq!(err.trim_end().lines().count(), 1, "{err}");
    assert!(!place.path("scene/scene.json").exists());
    err
}

#[test]
#[cfg(unix)]
fn whatever_the_programs_do_there_is_one_message() {
    let place = place();
    place.write("x.mp4", b"\0\0\0\x18ftypmp42\0\0\0\0isomiso2");
    let message = fail_with(&place, None);
    assert!(
        message.contains("no `ffprobe` on the PATH") && message.contains("apt install"),
        "{message}"
    );

    let probed = r#"echo '{"streams": [{"duration": "1.0"}]}'"#;
    let line = "[Parsed_showinfo_4 @ 0x1] n: 0 pts: 7 pts_time:0.000007";
    let frame = "head -c 230400 /dev/zero";
    for (ffprobe, ffmpeg, wanted) in [
        ("exit 3", "", "ffprobe can read (exit status: 3)"),
        ("echo no such codec >&2; exit 1", "", "no such codec"),
        ("kill -9 $$", "", "signal: 9"),
        ("echo garbage", "", "nothing that makes sense"),
        ("cat /dev/zero", "", "gives too much"),
        (probed, "echo 'out of luck' >&2; exit 1", "out of luck"),
        (probed, "exit 0", "no frames"),
        (probed, "echo garbage", "half a frame"),
        (probed, frame, "1 frames and 0 times"),
        (
            probed,
            &format!("echo '{line}' >&2; echo '{line}' >&2; {frame}"),
            "1 frames and 2 times",
        ),
        (
            probed,
            &format!("yes '{line}' | head -n 1000000 >&2; exit 1"),
            "x.mp4",
        ),
        // Frames are chosen, and then cannot be read.
        (
            probed,
            &format!("case \"$*\" in *-ss*) echo P6; exit 0;; esac; echo '{line}' >&2; {frame}"),
            "readable picture",
        ),
        (
            probed,
            &format!("case \"$*\" in *-ss*) exit 0;; esac; echo '{line}' >&2; {frame}"),
            "no frame at",
        ),
    ] {
        let message = fail_with(&place, Some([ffprobe, ffmpeg]));
        assert!(message.contains(wanted), "{ffprobe}, {ffmpeg}: {message}");
        let _ = fs::remove_dir_all(place.path("scene"));
    }
}
