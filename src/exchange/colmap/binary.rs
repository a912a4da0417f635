//! The binary files: little-endian, without padding; every list begins with a 64-bit count.

use super::{
    ColmapCamera, ColmapImage, ColmapPoint, LensModel, NO_POINT, Observation, TrackElement,
    cam_to_world, world_to_cam,
};
use crate::exchange::half_pixels;
use std::io::{self, Write};

/// Bytes that have not been read yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or("is cut short")?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.take()?);
        }
        Ok(numbers)
    }

    /// A count of things that take at least `size` bytes each, so that no more is allocated than the file
    /// is large.
    fn count(&mut self, size: usize) -> Result<usize, String> {
        let count = usize::try_from(self.u64()?).unwrap_or(usize::MAX);
        match count.checked_mul(size) {
            Some(bytes) if bytes <= self.0.len() => Ok(count),
            _ => Err(format!("is cut short: it should hold {count} entries")),
        }
    }

    fn text(&mut self) -> Result<String, String> {
        let end = self.0.iter().position(|&byte| byte == 0);
        let end = end.ok_or("has a name without end")?;
        let name = str::from_utf8(&self.0[..end]).map_err(|_| "has a name that is not UTF-8")?;
        self.0 = &self.0[end + 1..];
        Ok(name.to_string())
    }

    fn list<T>(
        mut self,
        size: usize,
        mut item: impl FnMut(&mut Self) -> Result<T, String>,
    ) -> Result<Vec<T>, String> {
        let count = self.count(size)?;
        let items = (0..count)
            .map(|_| item(&mut self))
            .collect::<Result<_, _>>()?;
        match self.0 {
            [] => Ok(items),
            more => Err(format!("has {} bytes behind its last entry", more.len())),
        }
    }
}

pub(super) fn read_cameras(bytes: &[u8]) -> Result<Vec<ColmapCamera>, String> {
    Rest(bytes).list(24, |rest| {
        let id = rest.u32()?;
        let model = i32::from_le_bytes(rest.take()?);
        let size = [rest.u64()?, rest.u64()?];
        let model = LensModel::from_id(model)
            .ok_or_else(|| format!("has a camera {id} of a model {model} that tid3r has not"))?;
        let parameters = (0..model.parameter_count())
            .map(|_| rest.f64s::<1>().map(|[x]| x))
            .collect::<Result<Vec<_>, _>>()?;
        ColmapCamera::from_file(id, model, size, &parameters)
    })
}

pub(super) fn read_images(bytes: &[u8]) -> Result<Vec<ColmapImage>, String> {
    Rest(bytes).list(73, |rest| {
        let id = rest.u32()?;
        let cam_to_world = cam_to_world(rest.f64s()?, rest.f64s()?)
            .map_err(|problem| format!("image {id}: {problem}"))?;
        let camera = rest.u32()?;
        let name = rest.text()?;
        let count = rest.count(24)?;
        let observations = (0..count).map(|_| {
            let pixel = half_pixels::point_from(rest.f64s()?);
            let point = Some(rest.u64()?).filter(|&id| id != NO_POINT);
            Ok(Observation { pixel, point })
        });
        Ok(ColmapImage {
            observations: observations.collect::<Result<_, String>>()?,
            id,
            name,
            camera,
            cam_to_world,
        })
    })
}

pub(super) fn read_points(bytes: &[u8]) -> Result<Vec<ColmapPoint>, String> {
    Rest(bytes).list(51, |rest| {
        let id = rest.u64()?;
        let position = rest.f64s()?;
        let colour = rest.take()?;
        let [error] = rest.f64s()?;
        let count = rest.count(8)?;
        let track = (0..count).map(|_| {
            let [image, observation] = [rest.u32()?, rest.u32()?];
            Ok(TrackElement { image, observation })
        });
        Ok(ColmapPoint {
            track: track.collect::<Result<_, String>>()?,
            id,
            position,
            colour,
            error,
        })
    })
}

fn write_count(out: &mut dyn Write, count: usize) -> io::Result<()> {
    out.write_all(&(count as u64).to_le_bytes())
}

fn write_numbers(out: &mut dyn Write, numbers: &[f64]) -> io::Result<()> {
    let mut numbers = numbers.iter();
    numbers.try_for_each(|number| out.write_all(&number.to_le_bytes()))
}

pub(super) fn write_cameras(out: &mut dyn Write, cameras: &[ColmapCamera]) -> io::Result<()> {
    write_count(out, cameras.len())?;
    for camera in cameras {
        out.write_all(&camera.id.to_le_bytes())?;
        out.write_all(&camera.model.id().to_le_bytes())?;
        for side in [camera.intrinsics.width, camera.intrinsics.height] {
            out.write_all(&u64::from(side).to_le_bytes())?;
        }
        write_numbers(out, &camera.parameters())?;
    }
    Ok(())
}

pub(super) fn write_images(out: &mut dyn Write, images: &[ColmapImage]) -> io::Result<()> {
    write_count(out, images.len())?;
    for image in images {
        let (rotation, translation) = world_to_cam(&image.cam_to_world);
        out.write_all(&image.id.to_le_bytes())?;
        write_numbers(out, &rotation)?;
        write_numbers(out, &translation)?;
        out.write_all(&image.camera.to_le_bytes())?;
        out.write_all(image.name.as_bytes())?;
        out.write_all(&[0])?;
        write_count(out, image.observations.len())?;
        for observation in &image.observations {
            write_numbers(out, &half_pixels::point_to(observation.pixel))?;
            out.write_all(&observation.point.unwrap_or(NO_POINT).to_le_bytes())?;
        }
    }
    Ok(())
}

pub(super) fn write_points(out: &mut dyn Write, points: &[ColmapPoint]) -> io::Result<()> {
    write_count(out, points.len())?;
    for point in points {
        out.write_all(&point.id.to_le_bytes())?;
        write_numbers(out, &point.position)?;
        out.write_all(&point.colour)?;
        write_numbers(out, &[point.error])?;
        write_count(out, point.track.len())?;
        for seen in &point.track {
            out.write_all(&seen.image.to_le_bytes())?;
            out.write_all(&seen.observation.to_le_bytes())?;
        }
    }
    Ok(())
}
