use super::{
    Edit, EditList, Edited, InstanceList, SplitBy, apply::Work, floor_box, split::usual_gap,
};
use crate::{
    Error, Result,
    geometry::Camera,
    photos::Photo,
    render,
    scene::{Frame, InstanceRecord, Role, Scene, Stage, WriteLock, files},
};
use image::RgbImage;
use std::path::Path;

/// Applies edits to a scene; `frames` are its input frames.
///
/// # Errors
/// When the scene has not been segmented or a file is damaged.
pub fn edited(scene: &Scene, frames: &[Frame], edits: &[Edit]) -> Result<Edited> {
    Ok(work(scene, frames, edits)?.finish())
}

fn work(scene: &Scene, frames: &[Frame], edits: &[Edit]) -> Result<Work> {
    let instances = scene.labels(Stage::Unify)?;
    let cloud = scene.cloud(frames)?;
    let style = |name: &str| {
        frames
            .iter()
            .map(|frame| {
                let path = scene.style_file(name, &frame.photo.name);
                frame_sized(Photo::new(name, &path).load()?, frame, &path)
            })
            .collect()
    };
    let floor = &scene.manifest().floor_to_world;
    Work::new(cloud, frames, instances).with_edits(edits, floor, style)
}

fn frame_sized(picture: RgbImage, frame: &Frame, path: &Path) -> Result<RgbImage> {
    if picture.dimensions() == frame.colour.dimensions() {
        return Ok(picture);
    }
    Err(Error::file(
        path,
        "is not of its frame's size",
        "undo the restyling and do it again",
    ))
}

/// Copies a second set of photos of a scene's views into the scene, cut and resized like the first, and
/// gives the edit that shows them. `folder` holds one picture for each photo, called like it.
///
/// # Errors
/// When a photo's picture is missing, unreadable, or of another size than the photo.
pub fn restyle(scene: &Scene, folder: &Path, _lock: &WriteLock) -> Result<Edit> {
    let records = scene.records(Role::Input);
    let mut pictures = Vec::new();
    for record in records {
        let name = &record.photo.name;
        let found = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"]
            .iter()
            .map(|extension| folder.join(format!("{name}.{extension}")))
            .find(|path| path.is_file());
        let Some(path) = found else {
            return Err(Error::file(
                folder,
                format!("has no picture for the photo '{name}'"),
                format!("add {name}.png or {name}.jpg: the restyled photo, of the photo's size"),
            ));
        };
        let photo = Photo {
            path,
            ..record.photo.clone()
        };
        let picture = photo.load()?;
        let size = [picture.width(), picture.height()];
        pictures.push(if size == record.transform.frame_size {
            picture
        } else {
            record.transform.apply(&picture, &photo.path)?
        });
    }
    let style = (1..)
        .map(|k| format!("style_{k}"))
        .find(|style| !scene.style_file(style, "").exists())
        .unwrap_or_default();
    for (record, picture) in records.iter().zip(&pictures) {
        files::write_png(&scene.style_file(&style, &record.photo.name), picture)?;
    }
    Ok(Edit::Restyle { style })
}

/// Draws `contact_sheet.png` and `top_down.png`: the instances with their ids, as edited.
///
/// # Errors
/// When the scene has not been segmented, or a file cannot be read or written.
pub fn write_overviews(scene: &Scene, edits: &[Edit], lock: &WriteLock) -> Result<()> {
    let frames = scene.frames(Role::Input)?;
    let edited = edited(scene, &frames, edits)?;
    draw_overviews(scene, &frames, edits, &edited, lock)
}

/// Writes a changed list of edits into its scene, after the overviews that it leads to, and gives what the
/// edits make of the scene. `frames` are its input frames.
///
/// # Errors
/// When the scene has not been segmented, or a file cannot be read or written.
pub fn keep(scene: &Scene, frames: &[Frame], list: &EditList, lock: &WriteLock) -> Result<Edited> {
    let edited = edited(scene, frames, list.edits())?;
    draw_overviews(scene, frames, list.edits(), &edited, lock)?;
    list.save(scene, lock)?;
    Ok(edited)
}

fn draw_overviews(
    scene: &Scene,
    frames: &[Frame],
    edits: &[Edit],
    edited: &Edited,
    _lock: &WriteLock,
) -> Result<()> {
    let Edited {
        cloud,
        photos,
        instances,
        ..
    } = edited;
    let names = InstanceList::load(scene, edits)?.names;
    let floor = &scene.manifest().floor_to_world;
    let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
    let plan = render::top_down(cloud, &cameras, floor);
    files::write_png(&scene.folder().join("top_down.png"), &plan)?;
    let sheet = render::contact_sheet(photos, instances, &names);
    files::write_png(&scene.folder().join("contact_sheet.png"), &sheet)
}

/// The instances of a scene that have points once `edits` are applied, as `instances.json` lists those
/// that were found.
///
/// # Errors
/// When the scene has not been segmented or a file is damaged.
pub fn instances(scene: &Scene, edits: &[Edit]) -> Result<Vec<InstanceRecord>> {
    let edited = edited(scene, &scene.frames(Role::Input)?, edits)?;
    instances_of(scene, edits, &edited)
}

/// The same for a scene whose edits have been applied.
///
/// # Errors
/// When the scene has not been segmented or a file is damaged.
pub fn instances_of(scene: &Scene, edits: &[Edit], edited: &Edited) -> Result<Vec<InstanceRecord>> {
    let list = InstanceList::load(scene, edits)?;
    let manifest = scene.manifest();
    let score = |id| list.score(id);
    let mut records = InstanceRecord::all(
        &edited.cloud,
        score,
        &manifest.frames,
        &manifest.floor_to_world,
    );
    records.retain_mut(|record| {
        let name = list.names.get(&record.id);
        record.name = name.cloned().unwrap_or_default();
        name.is_some()
    });
    Ok(records)
}

/// How a person wants an instance split: [`SplitBy`], with what is known only of the instance left open.
#[derive(Clone, Debug, PartialEq)]
pub enum SplitRequest {
    /// By its gaps: those that separate parts, or those that are wide for this instance.
    Components(Option<f64>),
    /// By something else.
    By(SplitBy),
}

/// The edit that splits an instance of a scene with `edits`.
///
/// # Errors
/// When the instance does not fall into several parts; when the scene has not been segmented or a file
/// is damaged.
pub fn split(scene: &Scene, edits: &[Edit], instance: u32, request: &SplitRequest) -> Result<Edit> {
    let list = InstanceList::load(scene, edits)?;
    let floor = &scene.manifest().floor_to_world;
    let work = work(scene, &scene.frames(Role::Input)?, edits)?;
    let by = match request {
        SplitRequest::Components(gap) => SplitBy::Components {
            gap: gap.unwrap_or_else(|| usual_gap(&work.radii(instance))),
        },
        SplitRequest::By(by) => by.clone(),
    };
    by.check()
        .map_err(|problem| Error::request(problem, "give other numbers"))?;
    let parts = work.parts(&work.places(instance), &by, floor);
    let split_off = parts.iter().max().copied().unwrap_or(0);
    if split_off == 0 || !parts.contains(&0) {
        return Err(in_one_part(&work, instance, &by, scene));
    }
    let first = list.unused_id();
    Ok(Edit::Split {
        instance,
        by,
        parts: (first..).take(split_off).collect(),
    })
}

fn in_one_part(work: &Work, instance: u32, by: &SplitBy, scene: &Scene) -> Error {
    let points = work.points(&work.places(instance));
    let place = match floor_box(&points, &scene.manifest().floor_to_world) {
        Some(sides) => {
            let sides = ["x", "y", "z"]
                .iter()
                .zip(sides)
                .map(|(axis, [low, high])| format!("{axis} {low:.3} to {high:.3}"));
            format!("it reaches over {}", sides.collect::<Vec<_>>().join(", "))
        }
        None => "it has no points".into(),
    };
    let remedy = match by {
        SplitBy::Components { .. } => "give a smaller gap, or split it in another way",
        SplitBy::Clusters { .. } => "give fewer clusters",
        SplitBy::Above { .. } => "give another height",
        SplitBy::Box { .. } => "give another box",
        SplitBy::Outline { .. } => "draw another outline",
    };
    let problem = format!("instance {instance} stays in one part when split {by}");
    Error::request(problem, format!("{place}: {remedy}"))
}
