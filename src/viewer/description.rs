//! The scene as the page is told of it.

use super::{
    points::{CHUNK, RECORD},
    session::Snapshot,
};
use crate::{
    draw::colour_of,
    edit::{self, Edit},
    geometry::{Camera, Point, matrix4},
    scene::{FrameRecord, InstanceRecord, Role, Scale},
};
use serde::Serialize;

/// What `GET /api/scene` gives.
#[derive(Serialize)]
pub(super) struct Description<'a> {
    name: String,
    folder: String,
    version: &'a str,
    scale: Scale,
    /// Rows.
    floor_to_world: [[f64; 4]; 4],
    points: PointsDescription,
    /// Where the scene is, but for stray points: lowest and highest x, y, z in the floor's frame.
    floor_box: [[f64; 2]; 3],
    photos: Vec<PhotoDescription<'a>>,
    held_out: Vec<PhotoDescription<'a>>,
    instances: Vec<InstanceDescription<'a>>,
    edits: Vec<EditDescription<'a>>,
    /// How many edits can be done again.
    undone: usize,
    /// Why there can be no edits.
    #[serde(skip_serializing_if = "Option::is_none")]
    not_editable: Option<String>,
}

#[derive(Serialize)]
struct PointsDescription {
    count: usize,
    chunk: usize,
    record: usize,
}

#[derive(Serialize)]
struct PhotoDescription<'a> {
    name: &'a str,
    camera: &'a Camera,
}

#[derive(Serialize)]
struct InstanceDescription<'a> {
    #[serde(flatten)]
    record: &'a InstanceRecord,
    /// As overviews paint it.
    colour: [u8; 3],
    size: [f64; 3],
}

#[derive(Serialize)]
struct EditDescription<'a> {
    words: String,
    #[serde(flatten)]
    edit: &'a Edit,
}

impl<'a> Description<'a> {
    pub(super) fn new(snapshot: &'a Snapshot) -> Self {
        let Snapshot { scene, shown, .. } = snapshot;
        let manifest = scene.manifest();
        let cloud = &shown.edited.cloud;
        let places: Vec<Point> = (0..cloud.len()).map(|index| cloud.point(index)).collect();
        let folder = scene.folder();
        let folder = folder.canonicalize().unwrap_or_else(|_| folder.into());
        let photos = |role| {
            let describe = |record: &'a FrameRecord| PhotoDescription {
                name: &record.photo.name,
                camera: &record.camera,
            };
            scene.records(role).iter().map(describe).collect()
        };
        let (edits, undone) = match &snapshot.list {
            Ok(list) => (list.edits(), list.undone()),
            Err(_) => (&[][..], 0),
        };
        Self {
            name: folder.file_name().map_or_else(
                || folder.display().to_string(),
                |name| name.to_string_lossy().into_owned(),
            ),
            folder: folder.display().to_string(),
            version: &snapshot.version,
            scale: manifest.scale,
            floor_to_world: matrix4::rows(&manifest.floor_to_world),
            points: PointsDescription {
                count: snapshot.points().len(),
                chunk: CHUNK,
                record: RECORD,
            },
            floor_box: edit::floor_box(&places, &manifest.floor_to_world)
                .unwrap_or([[-1.0, 1.0]; 3]),
            photos: photos(Role::Input),
            held_out: photos(Role::HeldOut),
            instances: (snapshot.instances.iter())
                .map(|record| InstanceDescription {
                    record,
                    colour: colour_of(record.id),
                    size: record.size(),
                })
                .collect(),
            edits: (edits.iter())
                .map(|edit| EditDescription {
                    words: edit::describe(edit),
                    edit,
                })
                .collect(),
            undone,
            not_editable: snapshot.list.as_ref().err().map(ToString::to_string),
        }
    }
}
