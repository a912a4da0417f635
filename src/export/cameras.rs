use super::{contents::counted, photos};
use crate::{
    exchange::cameras::{CameraFile, CameraView},
    scene::{Role, Scene},
};

/// The cameras of a scene's photos.
pub(super) fn file(scene: &Scene) -> CameraFile {
    let view = |record| {
        let camera = photos::camera(record);
        CameraView {
            name: Some(record.photo.name.clone()),
            cam_to_world: camera.cam_to_world,
            intrinsics: Some(camera.intrinsics),
        }
    };
    CameraFile {
        scale: Some(scene.manifest().scale),
        views: scene.records(Role::Input).iter().map(view).collect(),
        steps: 0,
    }
}

pub(super) fn count(cameras: usize) -> String {
    counted(cameras, "camera")
}
