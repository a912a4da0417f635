//! The paper's evaluation: its scenes, its settings where it gives them, and its figures.

use super::{Measure, SceneEntry};
use crate::{Error, Result, exchange::recording::Layout};
use std::path::{Path, PathBuf};

/// ScanNet's scenes for instances (the paper's first table).
const SCANNET_INSTANCES: [&str; 5] = [
    "scene0107_00",
    "scene0362_00",
    "scene0409_00",
    "scene0469_00",
    "scene0616_00",
];
/// ScanNet's scenes for depth and views.
const SCANNET_VIEWS: [&str; 3] = ["scene0758_00", "scene0738_00", "scene0708_00"];
/// ScanNet++'s scenes for depth and views.
const SCANNETPP_VIEWS: [&str; 4] = ["3e6ceea56c", "4610b2104c", "6126572846", "a8f7f66985"];
/// Width of ScanNet's pictures: 624x468.
const SCANNET_SIZE: u32 = 624;
/// Width of ScanNet++'s pictures: 640x480, which are the iPhone's.
const SCANNETPP_SIZE: u32 = 640;

/// A row of the paper's tables: what it is called, and its figures in the order of the columns.
pub type PaperRow = (&'static str, &'static [f64]);

/// AP, AP50, AP75.
pub const INSTANCES: [PaperRow; 3] = [
    ("paper", &[0.250, 0.418, 0.254]),
    ("paper, no unification", &[0.170, 0.268, 0.181]),
    ("paper, PE3R", &[0.202, 0.326, 0.223]),
];
/// RMSE, share below 1.25.
pub const DEPTH: [PaperRow; 3] = [
    ("paper", &[0.209, 0.981]),
    ("paper, MV-DUSt3R+ as is", &[0.219, 0.977]),
    ("paper, PE3R", &[0.378, 0.905]),
];
/// PSNR, SSIM, LPIPS (on which network, the paper does not say).
pub const VIEWS: [PaperRow; 3] = [
    ("paper", &[18.15, 0.645, 0.434]),
    ("paper, MV-DUSt3R+ cloud", &[17.69, 0.613, 0.458]),
    ("paper, PE3R cloud", &[14.68, 0.560, 0.529]),
];
/// Seconds for reconstruction (of 20 photos) and rendering (of 10 views) on an RTX 4090.
pub const SECONDS: PaperRow = ("paper (20 photos, 10 views, RTX 4090)", &[60.0, 150.0]);

/// Those of the paper's scenes that the folders of ScanNet and ScanNet++ hold, with the paper's settings, and the names
/// of those that they do not.
///
/// A scene is a folder `NAME`, `scans/NAME` (ScanNet) or `data/NAME` (ScanNet++) that holds either NAME.sens or extracted
/// frames, and for instances the unpacked `instance-filt` (or `instance`). Photos are chosen by overlap, 10 to 20 of each scene, with
/// 8 test views: the paper's own choice is not published.
///
/// # Errors
/// When there is none of the scenes.
pub fn scenes(
    scannet: Option<&Path>,
    scannetpp: Option<&Path>,
) -> Result<(Vec<SceneEntry>, Vec<String>)> {
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    let labels = |folder: &Path| {
        let labels = ["instance-filt", "instance"].map(|part| folder.join(part));
        labels.into_iter().find(|labels| labels.is_dir())
    };
    let mut add = |root: Option<&Path>,
                   name: &str,
                   settings: &dyn Fn(SceneEntry, &Path) -> SceneEntry| {
        let places = root.map(|root| ["", "scans", "data"].map(|part| root.join(part).join(name)));
        match places.and_then(|places| places.into_iter().find(|place| place.is_dir())) {
            Some(folder) => {
                let entry = settings(SceneEntry::of_recording(name, &folder), &folder);
                match entry.measures(Measure::Instances) && entry.truth_labels.is_none() {
                    true => missing.push(format!("{name} (no instance-filt/ in it)")),
                    false => found.push(entry),
                }
            }
            None => missing.push(name.to_string()),
        }
    };
    for name in SCANNET_INSTANCES {
        add(scannet, name, &|entry, folder| SceneEntry {
            truth_labels: labels(folder),
            measure: [Measure::Instances].into(),
            tests: 0,
            ..of_scannet(entry, folder)
        });
    }
    let views = [Measure::Cameras, Measure::Depth, Measure::Views];
    for name in SCANNET_VIEWS {
        add(scannet, name, &|entry, folder| SceneEntry {
            measure: views.into(),
            ..of_scannet(entry, folder)
        });
    }
    for name in SCANNETPP_VIEWS {
        add(scannetpp, name, &|entry, _| SceneEntry {
            layout: Some(Layout::ScannetppIphone),
            size: SCANNETPP_SIZE,
            measure: views.into(),
            ..entry
        });
    }
    if found.is_empty() {
        let root = scannet.or(scannetpp).unwrap_or(Path::new("."));
        return Err(Error::file(
            root,
            format!(
                "holds none of the paper's scenes ({}, …)",
                SCANNET_INSTANCES[0]
            ),
            "give the folders with --scannet and --scannetpp",
        ));
    }
    Ok((found, missing))
}

fn of_scannet(entry: SceneEntry, folder: &Path) -> SceneEntry {
    let sens: PathBuf = folder.join(format!("{}.sens", entry.name));
    SceneEntry {
        recording: Some(if sens.is_file() { sens } else { folder.into() }),
        layout: Some(Layout::Scannet),
        size: SCANNET_SIZE,
        ..entry
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn scenes_are_found_where_data_sets_have_them() {
        let root = tempfile::tempdir().unwrap();
        let scans = root.path().join("scannet/scans");
        fs::create_dir_all(scans.join("scene0107_00/instance-filt")).unwrap();
        fs::create_dir_all(scans.join("scene0362_00")).unwrap();
        fs::create_dir_all(scans.join("scene0758_00")).unwrap();
        fs::write(scans.join("scene0758_00/scene0758_00.sens"), "").unwrap();
        fs::create_dir_all(root.path().join("pp/data/4610b2104c")).unwrap();
        let (scannet, pp) = (root.path().join("scannet"), root.path().join("pp"));
        let (found, missing) = scenes(Some(&scannet), Some(&pp)).unwrap();
        assert_eq!((found.len(), missing.len()), (3, 9));
        assert!(missing[0].contains("no instance-filt"), "{missing:?}");
        assert!(found[0].truth_labels.is_some() && found[0].measures(Measure::Instances));
        assert!(!found[0].measures(Measure::Views) && found[0].tests == 0);
        assert!(
            found[1]
                .recording
                .as_ref()
                .unwrap()
                .ends_with("scene0758_00.sens")
        );
        assert_eq!((found[1].size, found[2].size), (624, 640));
        let refusal = scenes(Some(root.path()), None).unwrap_err().to_string();
        assert!(refusal.contains("none of the paper's scenes"), "{refusal}");
    }
}
