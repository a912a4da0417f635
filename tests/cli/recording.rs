//! A small room of which everything is known, recorded in every layout that can be imported.
//!
//! World axes are OpenCV's: x right, y down, z ahead; metres. Two boxes stand on the floor. Seven photos,
//! numbered from 0, are taken along a line, all towards the boxes.

use flate2::{Compression, write::ZlibEncoder};
use image::{GrayImage, ImageBuffer, ImageFormat, Luma, Rgb, RgbImage};
use std::{
    fs,
    io::{Cursor, Write},
    path::Path,
};
use tid3r::exchange::npz::{Header, NpzWriter, Number};

pub(crate) const PHOTOS: usize = 7;
pub(crate) const WIDTH: u32 = 64;
pub(crate) const HEIGHT: u32 = 48;
/// As `--intrinsics` takes them.
pub(crate) const LENS: &str = "40,40,31.5,23.5";
const FOCAL: f64 = 40.0;

/// Lowest and highest x, y and z.
type Box3 = [[f64; 2]; 3];

const ROOM: Box3 = [[-2.0, 2.0], [-1.2, 1.0], [-2.0, 2.5]];
const BOXES: [Box3; 2] = [
    [[-0.9, -0.3], [0.2, 1.0], [0.8, 1.4]],
    [[0.3, 1.0], [0.0, 1.0], [0.9, 1.5]],
];

/// The boxes are 1 and 2.
const FLOOR: u16 = 3;
const CEILING: u16 = 4;
const WALL: u16 = 5;

struct Hit {
    depth: f64,
    label: u16,
    point: [f64; 3],
}

/// Where a camera stands, and how far it is turned about y.
fn camera(photo: usize) -> ([f64; 3], f64) {
    let k = photo as f64 - 3.0;
    ([0.15 * k, -0.1, -1.2], -0.05 * k)
}

/// The camera-to-world matrix of a photo.
pub(crate) fn pose(photo: usize) -> [[f64; 4]; 4] {
    let ([x, y, z], angle) = camera(photo);
    let (s, c) = angle.sin_cos();
    [
        [c, 0.0, s, x],
        [0.0, 1.0, 0.0, y],
        [-s, 0.0, c, z],
        [0.0, 0.0, 0.0, 1.0],
    ]
}

fn hit(photo: usize, u: u32, v: u32) -> Hit {
    let pose = pose(photo);
    let ray = [
        (f64::from(u) - 31.5) / FOCAL,
        (f64::from(v) - 23.5) / FOCAL,
        1.0,
    ];
    let from: [f64; 3] = std::array::from_fn(|axis| pose[axis][3]);
    let along: [f64; 3] = std::array::from_fn(|axis| (0..3).map(|k| pose[axis][k] * ray[k]).sum());
    // Along z the ray has length 1 in the camera's frame, so lengths are depths.
    let ends = |axis: usize, [low, high]: [f64; 2]| {
        let [a, b] = [low, high].map(|side| (side - from[axis]) / along[axis]);
        [a.min(b), a.max(b)]
    };
    let (mut depth, axis) = (0..3)
        .map(|axis| (ends(axis, ROOM[axis])[1], axis))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap();
    let mut label = match axis {
        1 if along[1] > 0.0 => FLOOR,
        1 => CEILING,
        _ => WALL,
    };
    for (number, sides) in (1..).zip(BOXES) {
        let spans: [[f64; 2]; 3] = std::array::from_fn(|axis| ends(axis, sides[axis]));
        let enter = spans.iter().map(|span| span[0]).fold(0.0, f64::max);
        let leave = spans
            .iter()
            .map(|span| span[1])
            .fold(f64::INFINITY, f64::min);
        if enter < leave && enter < depth {
            (depth, label) = (enter, number);
        }
    }
    Hit {
        depth,
        label,
        point: std::array::from_fn(|axis| from[axis] + depth * along[axis]),
    }
}

pub(crate) fn photo(photo: usize) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |u, v| {
        let Hit { label, point, .. } = hit(photo, u, v);
        let base: [f64; 3] = match label {
            1 => [190.0, 60.0, 50.0],
            2 => [50.0, 80.0, 180.0],
            FLOOR => [150.0, 120.0, 90.0],
            CEILING => [230.0, 230.0, 225.0],
            _ => [200.0, 190.0, 160.0],
        };
        let texture: f64 = point.iter().map(|x| 8.0 * (5.0 * x).sin()).sum();
        Rgb(base.map(|channel| (channel + texture).clamp(0.0, 255.0) as u8))
    })
}

fn map<T>(photo: usize, of: impl Fn(&Hit) -> T) -> Vec<T> {
    let pixels = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v)));
    pixels.map(|(u, v)| of(&hit(photo, u, v))).collect()
}

fn save_grey(path: &Path, values: Vec<u16>) {
    let picture = ImageBuffer::<Luma<u16>, _>::from_vec(WIDTH, HEIGHT, values);
    picture.unwrap().save(path).unwrap();
}

/// Millimetres.
fn save_depth(path: &Path, photo: usize) {
    save_grey(path, map(photo, |hit| (hit.depth * 1000.0).round() as u16));
}

/// frame-N.color.png, frame-N.depth.png, frame-N.pose.txt, camera-intrinsics.txt.
pub(crate) fn write_seven_scenes(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    let intrinsics = "40 0 31.5\n0 40 23.5\n0 0 1\n";
    fs::write(folder.join("camera-intrinsics.txt"), intrinsics).unwrap();
    for k in 0..PHOTOS {
        let file = |ending: &str| folder.join(format!("frame-{k:06}.{ending}"));
        photo(k).save(file("color.png")).unwrap();
        save_depth(&file("depth.png"), k);
        let rows = pose(k).map(|row| row.map(|x| x.to_string()).join(" "));
        fs::write(file("pose.txt"), rows.join("\n")).unwrap();
    }
}

/// color/N.png, depth/N.png, pose.txt. Needs --intrinsics and --depth-scale 1000.
pub(crate) fn write_color_depth(folder: &Path) {
    for part in ["color", "depth"] {
        fs::create_dir_all(folder.join(part)).unwrap();
    }
    let mut poses = String::new();
    for k in 0..PHOTOS {
        photo(k)
            .save(folder.join(format!("color/{k}.png")))
            .unwrap();
        save_depth(&folder.join(format!("depth/{k}.png")), k);
        let ([x, y, z], angle) = camera(k);
        let (s, c) = (angle / 2.0).sin_cos();
        poses += &format!("{x} {y} {z} 0 {s} 0 {c}\n");
    }
    fs::write(folder.join("pose.txt"), poses).unwrap();
}

/// rgb/N.png and condition.npz.
pub(crate) fn write_npz(folder: &Path) {
    fs::create_dir_all(folder.join("rgb")).unwrap();
    for k in 0..PHOTOS {
        photo(k).save(folder.join(format!("rgb/{k}.png"))).unwrap();
    }
    let lens = [FOCAL, 0.0, 31.5, 0.0, FOCAL, 23.5, 0.0, 0.0, 1.0];
    let all = PHOTOS;
    let poses = (0..PHOTOS).flat_map(pose).flatten().collect();
    let depths = (0..PHOTOS).flat_map(|k| map(k, |hit| hit.depth)).collect();
    write_condition(
        &folder.join("condition.npz"),
        &[
            ("intrinsics", [all, 3, 3], lens.repeat(PHOTOS)),
            ("poses", [all, 4, 4], poses),
            ("depths", [all, HEIGHT as usize, WIDTH as usize], depths),
        ],
    );
}

/// A `.sens` file: photos as PNG, depth packed by zlib, frame 6 without a pose if `lost`.
pub(crate) fn write_sens(path: &Path, lost: bool) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let numbers = |numbers: &[f64]| -> Vec<u8> {
        let numbers = numbers.iter().map(|x| *x as f32);
        numbers.flat_map(f32::to_le_bytes).collect()
    };
    let identity: Vec<f64> = (0..16).map(|at| f64::from(u8::from(at % 5 == 0))).collect();
    let mut lens = identity.clone();
    (lens[0], lens[2], lens[5], lens[6]) = (FOCAL, 31.5, FOCAL, 23.5);
    let mut out = [&4_u32.to_le_bytes()[..], &3_u64.to_le_bytes(), b"cam"].concat();
    for matrix in [&lens, &identity, &lens, &identity] {
        out.extend(numbers(matrix));
    }
    for number in [1, 1, WIDTH, HEIGHT, WIDTH, HEIGHT] {
        out.extend(number.to_le_bytes());
    }
    out.extend(1000_f32.to_le_bytes());
    out.extend((PHOTOS as u64).to_le_bytes());
    for k in 0..PHOTOS {
        let pose = if lost && k == 6 {
            vec![f64::NEG_INFINITY; 16]
        } else {
            pose(k).concat()
        };
        out.extend(numbers(&pose));
        out.extend([0; 16]);
        let mut photo_file = Cursor::new(Vec::new());
        photo(k)
            .write_to(&mut photo_file, ImageFormat::Png)
            .unwrap();
        let units = map(k, |hit| (hit.depth * 1000.0).round() as u16);
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::fast());
        let bytes: Vec<u8> = units.into_iter().flat_map(u16::to_le_bytes).collect();
        packed.write_all(&bytes).unwrap();
        let parts = [photo_file.into_inner(), packed.finish().unwrap()];
        for part in &parts {
            out.extend((part.len() as u64).to_le_bytes());
        }
        out.extend(parts.concat());
    }
    out.extend(0_u64.to_le_bytes());
    fs::write(path, out).unwrap();
}

/// ScanNet's extracted frames.
pub(crate) fn write_scannet(folder: &Path) {
    for part in ["color", "depth", "pose", "intrinsic"] {
        fs::create_dir_all(folder.join(part)).unwrap();
    }
    for name in ["color", "depth"] {
        let lens = "40 0 31.5 0\n0 40 23.5 0\n0 0 1 0\n0 0 0 1\n";
        fs::write(folder.join(format!("intrinsic/intrinsic_{name}.txt")), lens).unwrap();
    }
    for k in 0..PHOTOS {
        photo(k)
            .save(folder.join(format!("color/{k}.png")))
            .unwrap();
        save_depth(&folder.join(format!("depth/{k}.png")), k);
        let rows = pose(k).map(|row| row.map(|x| x.to_string()).join(" "));
        fs::write(folder.join(format!("pose/{k}.txt")), rows.join("\n")).unwrap();
    }
}

/// As the TUM RGB-D benchmark, one photo a second. Needs --intrinsics and --depth-scale 1000.
pub(crate) fn write_tum(folder: &Path) {
    write_color_depth(folder);
    fs::rename(folder.join("color"), folder.join("rgb")).unwrap();
    let poses = fs::read_to_string(folder.join("pose.txt")).unwrap();
    fs::remove_file(folder.join("pose.txt")).unwrap();
    let list = |line: &dyn Fn(usize) -> String| (0..PHOTOS).map(line).collect::<String>();
    let truth: Vec<&str> = poses.lines().collect();
    for (name, list) in [
        ("rgb.txt", list(&|k| format!("{k}.0 rgb/{k}.png\n"))),
        ("depth.txt", list(&|k| format!("{k}.015 depth/{k}.png\n"))),
        (
            "groundtruth.txt",
            list(&|k| format!("{k}.0 {}\n", truth[k])),
        ),
    ] {
        fs::write(folder.join(name), list).unwrap();
    }
}

/// Replica as in NICE-SLAM.
pub(crate) fn write_replica(folder: &Path) {
    fs::create_dir_all(folder.join("results")).unwrap();
    let mut trajectory = String::new();
    for k in 0..PHOTOS {
        photo(k)
            .save(folder.join(format!("results/frame{k:06}.png")))
            .unwrap();
        let units = map(k, |hit| (hit.depth * 6553.5).round() as u16);
        save_grey(&folder.join(format!("results/depth{k:06}.png")), units);
        let numbers = pose(k)
            .concat()
            .iter()
            .map(f64::to_string)
            .collect::<Vec<_>>();
        trajectory += &(numbers.join(" ") + "\n");
    }
    fs::write(folder.join("traj.txt"), trajectory).unwrap();
    let parameters = r#"{"camera": {"w": 64, "h": 48, "fx": 40.0, "fy": 40.0, "cx": 31.5, "cy": 23.5, "scale": 6553.5}}"#;
    fs::write(folder.join("cam_params.json"), parameters).unwrap();
}

/// An archive of arrays of doubles.
pub(crate) fn write_condition(path: &Path, arrays: &[(&str, [usize; 3], Vec<f64>)]) {
    let mut npz = NpzWriter::new(fs::File::create(path).unwrap());
    for (name, shape, values) in arrays {
        let header = Header::new(shape, Number::F64);
        npz.add(name, &header, values.iter().copied()).unwrap();
    }
    npz.finish().unwrap();
}

/// Label images NAME.png for the 7-Scenes recording, as a segmenter gives them: each photo has its own
/// numbers, and walls, floor and ceiling are masks too.
pub(crate) fn write_masks(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for k in 0..PHOTOS {
        let turned = |label: u16| 1 + (label + k as u16) % WALL;
        let path = folder.join(format!("frame-{k:06}.png"));
        save_grey(&path, map(k, |hit| turned(hit.label)));
    }
}

/// Label images with the boxes, called 1 and 2 in all photos, and nothing else; for the 7-Scenes recording.
pub(crate) fn write_true_labels(folder: &Path) {
    write_labels(folder, |k| format!("frame-{k:06}.png"));
}

/// The same, called as ScanNet's `instance-filt` calls them.
pub(crate) fn write_scannet_labels(folder: &Path) {
    write_labels(folder, |k| format!("{k}.png"));
}

fn write_labels(folder: &Path, name: impl Fn(usize) -> String) {
    fs::create_dir_all(folder).unwrap();
    for k in 0..PHOTOS {
        let labels = map(k, |hit| {
            if hit.label < FLOOR {
                hit.label as u8
            } else {
                0
            }
        });
        let picture = GrayImage::from_vec(WIDTH, HEIGHT, labels).unwrap();
        picture.save(folder.join(name(k))).unwrap();
    }
}
