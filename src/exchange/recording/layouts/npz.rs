//! A folder `rgb` of photos and an archive `condition.npz` with the arrays `intrinsics` (n, 3, 3),
//! `poses` (n, 4, 4; camera to world) and `depths` (n, h, w; scene units).

use crate::exchange::{
    npz::NpzReader,
    recording::{
        ImportOptions, Lens,
        folder_pictures::Pictures,
        listing::{ArchiveKind, DepthSource, Entry, Listing, PhotoSource, PoseSource},
        pictures::SIDE_LIMIT,
        poses::Rows,
    },
};
use crate::{Error, Map, Result, photos::PHOTO_ENDINGS, scene::Scale};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
};

const ARCHIVE: &str = "condition.npz";

/// Whether `folder` has both parts.
pub(super) fn fits(folder: &Path) -> bool {
    folder.join(ARCHIVE).is_file() && folder.join("rgb").is_dir()
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let photos_folder = folder.join("rgb");
    let photos = Pictures::list(&photos_folder, &PHOTO_ENDINGS)?;
    let mut archive = Archive::open(&folder.join(ARCHIVE))?;
    let count = photos.files.len();
    let shape = archive.shape("depths")?;
    let [width, height] = [shape[2], shape[1]].map(|side| u32::try_from(side).ok());
    let size = match (width, height) {
        (Some(width), Some(height)) if width > 0 && height > 0 => [width, height],
        _ => return Err(archive.refuse("depths", "has no pixels")),
    };
    if width.max(height) > Some(SIDE_LIMIT) {
        let problem = format!("has maps of more than {SIDE_LIMIT} pixels a side");
        return Err(archive.refuse("depths", &problem));
    }
    if shape[0] != count {
        let problem = format!("has {} maps for the {count} photos in rgb", shape[0]);
        return Err(archive.refuse("depths", &problem));
    }
    let lenses = match options.intrinsics {
        Some(lens) => vec![lens; count],
        None => archive.lenses(count)?,
    };
    let poses = archive.poses(count)?;

    let names = photos.unique_names();
    let warnings = photos.warnings(&photos_folder);
    let rows = photos.files.into_iter().zip(names).zip(poses).zip(lenses);
    let entries = rows
        .enumerate()
        .map(|(index, (((photo, name), pose), lens))| Entry {
            number: photo.number,
            name,
            photo: PhotoSource::File(photo.path),
            depth: Some(DepthSource::Archive {
                path: archive.path.clone(),
                kind: ArchiveKind::Npz,
                index,
                size,
            }),
            pose: PoseSource::Known(archive.path.clone(), pose),
            lens: lens.into(),
            depth_lens: None,
            lens_from: archive.path.clone(),
        });
    Ok(Listing {
        entries: entries.collect(),
        warnings,
        scale: Scale::Relative,
    })
}

/// The depth maps `wanted` (places along the first axis) of an archive, as stored.
///
/// The array is read once and front to back; only wanted maps are held.
pub(in crate::exchange::recording) fn read_depths(
    path: &Path,
    wanted: &BTreeSet<usize>,
) -> Result<BTreeMap<usize, Map<f32>>> {
    let mut archive = Archive::open(path)?;
    let [_, height, width] = archive.shape("depths")?;
    let sides = u32::try_from(width).ok().zip(u32::try_from(height).ok());
    let (columns, rows) = sides.ok_or_else(|| archive.refuse("depths", "has become larger"))?;
    // Zeroed memory is not touched before values arrive, so a header that lies costs nothing.
    let empty = wanted
        .iter()
        .map(|&index| (index, Map::filled(columns, rows, 0.0)));
    let mut maps: BTreeMap<usize, Map<f32>> = empty.collect();
    archive.array("depths", |[i, y, x], value| {
        if let Some(map) = maps.get_mut(&i) {
            map.values_mut()[y * width + x] = value as f32;
        }
    })?;
    Ok(maps)
}

/// An archive of arrays with three axes.
struct Archive {
    path: PathBuf,
    npz: NpzReader<BufReader<File>>,
}

impl Archive {
    fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io("read", path))?;
        let npz = NpzReader::new(BufReader::new(file)).map_err(|error| {
            Error::file(
                path,
                format!("is not a readable .npz archive ({error})"),
                "write it again with numpy.savez or numpy.savez_compressed",
            )
        })?;
        Ok(Self {
            path: path.to_path_buf(),
            npz,
        })
    }

    fn refuse(&self, array: &str, problem: &str) -> Error {
        Error::file(
            &self.path,
            format!("the array `{array}` {problem}"),
            "the archive must hold intrinsics (n, 3, 3), poses (n, 4, 4) and depths (n, h, w), \
             float32 or float64, for the n photos in rgb",
        )
    }

    /// The length of an array along each of its three axes.
    fn shape(&mut self, array: &str) -> Result<[usize; 3]> {
        let shape = self.npz.array(array).map(|array| array.header.shape);
        let shape = shape.and_then(|shape| {
            let three = <[usize; 3]>::try_from(shape);
            three.map_err(|shape| format!("has the shape {shape:?}, not three axes"))
        });
        shape.map_err(|problem| self.refuse(array, &problem))
    }

    /// Hands every value of an array with its index to `take`.
    fn array(&mut self, array: &str, mut take: impl FnMut([usize; 3], f64)) -> Result<()> {
        let [_, rows, columns] = self.shape(array)?;
        let read = self.npz.array(array).and_then(|array| {
            array.read(|place, value| {
                let row = place / columns;
                take([row / rows, row % rows, place % columns], value);
            })
        });
        read.map_err(|problem| self.refuse(array, &problem))
    }

    /// The `count` square matrices of an array.
    fn matrices<const N: usize>(
        &mut self,
        array: &str,
        count: usize,
    ) -> Result<Vec<[[f64; N]; N]>> {
        let shape = self.shape(array)?;
        if shape != [count, N, N] {
            let problem = format!("has the shape {shape:?}, not {:?}", [count, N, N]);
            return Err(self.refuse(array, &problem));
        }
        let mut matrices = vec![[[0.0; N]; N]; count];
        self.array(array, |[i, row, column], value| {
            matrices[i][row][column] = value;
        })?;
        Ok(matrices)
    }

    fn lenses(&mut self, count: usize) -> Result<Vec<Lens>> {
        let matrices = self.matrices::<3>("intrinsics", count)?;
        let lenses = matrices.iter().enumerate().map(|(i, matrix)| {
            Lens::from_matrix(matrix).map_err(|problem| {
                self.refuse("intrinsics", &format!("is wrong at {i}: {problem}"))
            })
        });
        lenses.collect()
    }

    fn poses(&mut self, count: usize) -> Result<Vec<Option<Rows>>> {
        let matrices = self.matrices::<4>("poses", count)?;
        let known = |rows: Rows| rows.iter().flatten().all(|x| x.is_finite()).then_some(rows);
        Ok(matrices.into_iter().map(known).collect())
    }
}
