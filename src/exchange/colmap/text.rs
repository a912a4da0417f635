//! The text files: one entry a line, two for an image; `#` begins a comment.

use super::{
    ColmapCamera, ColmapImage, ColmapPoint, LensModel, Observation, TrackElement, cam_to_world,
    world_to_cam,
};
use crate::exchange::half_pixels;
use std::{
    io::{self, Write},
    str::{FromStr, SplitAsciiWhitespace},
};

/// A line with its number, from 1.
type Line<'a> = (usize, &'a str);

fn lines(bytes: &[u8]) -> Result<impl Iterator<Item = Line<'_>>, String> {
    let text = str::from_utf8(bytes).map_err(|_| "is not text in UTF-8")?;
    Ok(text
        .lines()
        .enumerate()
        .map(|(k, line)| (k + 1, line.trim())))
}

fn says_something(&(_, line): &Line) -> bool {
    !line.is_empty() && !line.starts_with('#')
}

/// The words of a line.
struct Words<'a>(SplitAsciiWhitespace<'a>);

impl<'a> Words<'a> {
    fn of(line: &'a str) -> Self {
        Self(line.split_ascii_whitespace())
    }

    fn word(&mut self) -> Result<&'a str, String> {
        self.0.next().ok_or_else(|| "ends too early".into())
    }

    fn number<T: FromStr>(&mut self) -> Result<T, String> {
        parse(self.word()?)
    }

    fn numbers<T: FromStr + Default + Copy, const N: usize>(&mut self) -> Result<[T; N], String> {
        let mut numbers = [T::default(); N];
        for number in &mut numbers {
            *number = self.number()?;
        }
        Ok(numbers)
    }
}

fn parse<T: FromStr>(word: &str) -> Result<T, String> {
    word.parse().map_err(|_| {
        let word: String = word.chars().take(30).collect();
        format!("'{word}' is not the number that should be there")
    })
}

fn in_line(number: usize) -> impl Fn(String) -> String {
    move |problem| format!("line {number}: {problem}")
}

pub(super) fn read_cameras(bytes: &[u8]) -> Result<Vec<ColmapCamera>, String> {
    let camera = |line: &str| {
        let mut words = Words::of(line);
        let id = words.number()?;
        let name = words.word()?;
        let model = LensModel::from_name(name)
            .ok_or_else(|| format!("tid3r has no camera model '{name}'"))?;
        let size = words.numbers()?;
        let parameters = words.0.map(parse).collect::<Result<Vec<f64>, _>>()?;
        ColmapCamera::from_file(id, model, size, &parameters)
    };
    lines(bytes)?
        .filter(says_something)
        .map(|(number, line)| camera(line).map_err(in_line(number)))
        .collect()
}

pub(super) fn read_images(bytes: &[u8]) -> Result<Vec<ColmapImage>, String> {
    let mut lines = lines(bytes)?;
    let mut images = Vec::new();
    while let Some((number, line)) = lines.find(says_something) {
        let mut image = image(line).map_err(in_line(number))?;
        // An image without points has an empty line, the file's last may have none.
        if let Some((number, line)) = lines.next() {
            image.observations = observations(line).map_err(in_line(number))?;
        }
        images.push(image);
    }
    Ok(images)
}

fn image(line: &str) -> Result<ColmapImage, String> {
    let mut words = Words::of(line);
    let id = words.number()?;
    let cam_to_world = cam_to_world(words.numbers()?, words.numbers()?)?;
    let camera = words.number()?;
    let first = words.word()?;
    // A name goes to the end of the line, spaces and all.
    let begin = first.as_ptr() as usize - line.as_ptr() as usize;
    Ok(ColmapImage {
        id,
        name: line[begin..].to_string(),
        camera,
        cam_to_world,
        observations: vec![],
    })
}

fn observations(line: &str) -> Result<Vec<Observation>, String> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let (triples, []) = words.as_chunks::<3>() else {
        return Err("image points are x, y and a point's id each".into());
    };
    let observation = |[x, y, id]: &[&str; 3]| {
        Ok(Observation {
            pixel: half_pixels::point_from([parse(x)?, parse(y)?]),
            point: match *id {
                "-1" => None,
                id => Some(parse(id)?),
            },
        })
    };
    triples.iter().map(observation).collect()
}

pub(super) fn read_points(bytes: &[u8]) -> Result<Vec<ColmapPoint>, String> {
    let point = |line: &str| {
        let mut words = Words::of(line);
        let id = words.number()?;
        let position = words.numbers()?;
        let colour = words.numbers()?;
        let error = words.number()?;
        let track = words.0.map(parse).collect::<Result<Vec<u32>, _>>()?;
        let (pairs, []) = track.as_chunks::<2>() else {
            return Err("a track is an image and a place in it each".into());
        };
        let pair = |&[image, observation]: &[u32; 2]| TrackElement { image, observation };
        Ok(ColmapPoint {
            id,
            position,
            colour,
            error,
            track: pairs.iter().map(pair).collect(),
        })
    };
    lines(bytes)?
        .filter(says_something)
        .map(|(number, line)| point(line).map_err(in_line(number)))
        .collect()
}

pub(super) fn write_cameras(out: &mut dyn Write, cameras: &[ColmapCamera]) -> io::Result<()> {
    writeln!(out, "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")?;
    for camera in cameras {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        write!(
            out,
            "{} {} {width} {height}",
            camera.id,
            camera.model.name()
        )?;
        for parameter in camera.parameters() {
            write!(out, " {parameter}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

pub(super) fn write_images(out: &mut dyn Write, images: &[ColmapImage]) -> io::Result<()> {
    writeln!(out, "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")?;
    writeln!(out, "# POINTS2D[] as (X Y POINT3D_ID)")?;
    for image in images {
        let ([w, x, y, z], [tx, ty, tz]) = world_to_cam(&image.cam_to_world);
        let (id, camera, name) = (image.id, image.camera, &image.name);
        writeln!(out, "{id} {w} {x} {y} {z} {tx} {ty} {tz} {camera} {name}")?;
        for (k, observation) in image.observations.iter().enumerate() {
            let [x, y] = half_pixels::point_to(observation.pixel);
            let gap = if k == 0 { "" } else { " " };
            match observation.point {
                Some(point) => write!(out, "{gap}{x} {y} {point}")?,
                None => write!(out, "{gap}{x} {y} -1")?,
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

pub(super) fn write_points(out: &mut dyn Write, points: &[ColmapPoint]) -> io::Result<()> {
    writeln!(
        out,
        "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)"
    )?;
    for point in points {
        let ([x, y, z], [r, g, b]) = (point.position, point.colour);
        write!(out, "{} {x} {y} {z} {r} {g} {b} {}", point.id, point.error)?;
        for seen in &point.track {
            write!(out, " {} {}", seen.image, seen.observation)?;
        }
        writeln!(out)?;
    }
    Ok(())
}
