use super::*;
use crate::{
    Map,
    demo::room::Room,
    geometry::Pose,
    photos::{Photo, PhotoTransform},
    scene::Frame,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

const SIZE: [u32; 2] = [160, 120];

/// A room as a cloud, and what held-out cameras truly see of it.
fn room() -> (Cloud, Vec<(Camera, RgbImage)>) {
    let room = Room::furnish(1);
    let (inputs, held_out) = room.cameras(8, 2);
    let small = |camera: Camera| Camera {
        intrinsics: camera.intrinsics.resized(SIZE[0], SIZE[1]),
        ..camera
    };
    let frames: Vec<Frame> = (inputs.into_iter().map(small).enumerate())
        .map(|(k, camera)| {
            let view = room.render(&camera);
            Frame {
                photo: Photo::new(k.to_string(), format!("{k}.png")),
                transform: PhotoTransform::whole(SIZE, SIZE),
                camera,
                colour: view.colour,
                confidence: view.depth.map(|_| 1.0),
                depth: view.depth,
            }
        })
        .collect();
    let valid: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    let cloud = Cloud::from_frames(&frames, &valid, None);
    let tests = held_out.into_iter().map(small);
    (
        cloud,
        tests
            .map(|camera| (camera, room.render(&camera).colour))
            .collect(),
    )
}

fn disturbed(camera: &Camera, turn_deg: [f64; 3], motion: [f64; 3]) -> Camera {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn_deg.map(f64::to_radians)));
    let by = Pose::from_parts(Translation3::from(Vector3::from(motion)), turn);
    Camera {
        cam_to_world: camera.cam_to_world * by,
        ..*camera
    }
}

fn apart(a: &Camera, b: &Camera) -> (f64, f64) {
    let motion = a.cam_to_world.inverse() * b.cam_to_world;
    (
        motion.rotation.angle().to_degrees(),
        motion.translation.vector.norm(),
    )
}

#[test]
fn disturbed_cameras_find_back() {
    let (cloud, tests) = room();
    let disturbances = [
        ([1.0, -0.7, 0.5], [0.03, -0.02, 0.04]),
        ([-2.0, 3.0, -1.0], [-0.08, 0.05, 0.06]),
        ([0.0, 5.0, 0.0], [0.1, 0.0, -0.1]),
    ];
    for (camera, photo) in &tests {
        for (turn, motion) in disturbances {
            let start = disturbed(camera, turn, motion);
            let refined = refine_pose(&cloud, &start, photo);
            let (degrees, metres) = apart(&refined.camera, camera);
            assert!(
                refined.report.refined && degrees < 0.15 && metres < 0.015,
                "{turn:?} {motion:?}: {degrees} degrees, {metres} m, {:?}",
                refined.report
            );
        }
    }
}

#[test]
fn exposure_does_not_matter() {
    let (cloud, tests) = room();
    let (camera, photo) = &tests[0];
    let mut darker = photo.clone();
    for value in darker.iter_mut() {
        *value = (f32::from(*value) * 0.6 + 20.0) as u8;
    }
    let start = disturbed(camera, [1.0, -1.0, 0.5], [0.03, -0.02, 0.04]);
    let refined = refine_pose(&cloud, &start, &darker);
    let (degrees, metres) = apart(&refined.camera, camera);
    assert!(
        degrees < 0.15 && metres < 0.015,
        "{degrees} degrees, {metres} m"
    );
}

#[test]
fn a_true_camera_stays() {
    let (cloud, tests) = room();
    for (camera, photo) in &tests {
        let refined = refine_pose(&cloud, camera, photo);
        let (degrees, metres) = apart(&refined.camera, camera);
        assert!(
            degrees < 0.1 && metres < 0.01,
            "{degrees} degrees, {metres} m"
        );
    }
}

#[test]
fn what_cannot_agree_is_kept_as_it_was() {
    let (cloud, tests) = room();
    let (camera, photo) = &tests[0];
    for (cloud, photo) in [
        (Cloud::default(), photo.clone()),
        (cloud, RgbImage::new(SIZE[0], SIZE[1])),
    ] {
        let refined = refine_pose(&cloud, camera, &photo);
        assert!(!refined.report.refined, "{:?}", refined.report);
        assert_eq!(refined.camera, *camera);
        assert_eq!(
            (refined.report.turned_deg, refined.report.moved),
            (0.0, 0.0)
        );
    }
}
