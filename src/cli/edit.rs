use super::{SceneArgument, output};
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use tid3r::{
    Error,
    edit::{self, ColourChange, EditList, Hex, InstanceList, Placement},
    parameters::{coordinate, coordinates, factor, not_negative},
    scene::{Role, Scene, WriteLock},
};

/// Remove, move, copy, recolour or restyle instances; undo and redo.
///
/// Instances are called by id or name, as `tid3r instances list SCENE` and contact_sheet.png show them.
/// Edits are a list, applied when the scene is used: nothing is lost, and every one can be undone, those
/// that `tid3r instances` made too.
#[derive(Debug, Args)]
#[command(subcommand_required = true)]
pub(super) struct Edit {
    #[command(flatten)]
    scene: SceneArgument,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List the edits made so far
    List {
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    #[command(flatten)]
    Add(NewEdit),
    /// Undo the last edit
    Undo,
    /// Do the last undone edit again
    Redo,
    /// Undo all edits
    Clear,
}

/// An edit to be added to the list.
#[derive(Debug, Subcommand)]
enum NewEdit {
    /// Remove instances
    Remove {
        /// Ids or names
        #[arg(value_name = "INSTANCE", required = true)]
        instances: Vec<String>,
    },
    /// Remove everything else
    KeepOnly {
        /// Ids or names
        #[arg(value_name = "INSTANCE", required = true)]
        instances: Vec<String>,
    },
    /// Move, turn or scale an instance
    Move {
        /// Id or name
        instance: String,
        #[command(flatten)]
        target: Target,
    },
    /// Put a copy of an instance somewhere else
    Duplicate {
        /// Id or name
        instance: String,
        #[command(flatten)]
        target: Target,
    },
    /// Change the colour of instances
    Recolour(Recolour),
    /// Take all colours from a second set of photos of the same views
    Restyle {
        /// A folder with one picture for each photo, called like it
        #[arg(value_name = "FOLDER")]
        photos: PathBuf,
    },
}

/// Where an instance goes.
#[derive(Debug, Args)]
#[group(required = true, multiple = true)]
struct Target {
    /// Displacement: right, ahead and up as the first photo looks, in scene units
    #[arg(long, value_name = "X,Y,Z", value_parser = coordinates::<3>, allow_hyphen_values = true)]
    by: Option<[f64; 3]>,
    /// Target on the floor, in the coordinates of top_down.png
    #[arg(long, value_name = "X,Y", value_parser = coordinates::<2>, allow_hyphen_values = true)]
    to: Option<[f64; 2]>,
    /// Turn about the vertical, counter-clockwise as seen from above
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true,
          value_parser = coordinate)]
    turn: Option<f64>,
    /// Make it larger or smaller; its base stays on the floor
    #[arg(long, value_name = "FACTOR", value_parser = factor)]
    scale: Option<f64>,
}

#[derive(Debug, Args)]
struct Recolour {
    /// Ids or names
    #[arg(value_name = "INSTANCE", required = true)]
    instances: Vec<String>,
    /// Take this colour, keeping light and shadow
    #[arg(long, value_name = "#RRGGBB", conflicts_with_all = ["hue", "saturation", "value"])]
    to: Option<Hex>,
    /// Turn the hue
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, value_parser = coordinate)]
    hue: Option<f64>,
    /// Multiply the saturation
    #[arg(long, value_name = "FACTOR", value_parser = not_negative)]
    saturation: Option<f64>,
    /// Multiply the value
    #[arg(long, value_name = "FACTOR", value_parser = not_negative)]
    value: Option<f64>,
}

impl Edit {
    pub(super) fn run(self) -> Result<()> {
        let folder = &self.scene.scene;
        match self.action {
            Action::List { json } => list(&Scene::open(folder)?, json),
            Action::Undo => change(folder, EditList::load, |list| match list.undo() {
                Some(undone) => Ok(format!("undone: {}", edit::describe(undone))),
                None => Err(Error::request("there is nothing to undo", "edit first")),
            }),
            Action::Redo => change(folder, EditList::load, |list| match list.redo() {
                Some(redone) => Ok(format!("done again: {}", edit::describe(redone))),
                None => {
                    let problem = "there is nothing to do again";
                    Err(Error::request(problem, "undo something first"))
                }
            }),
            Action::Clear => {
                // Edits of instances that are no more cannot be done again.
                let load =
                    |scene: &Scene| EditList::load(scene).or_else(|_| EditList::cleared(scene));
                change(folder, load, |list| {
                    list.undo_all();
                    Ok("all edits undone".into())
                })
            }
            Action::Add(edit) => add(folder, |scene, list, lock| edit.resolved(scene, list, lock)),
        }
    }
}

/// Adds the edit that `make` gives to the list of the scene in `folder`, and says what it does.
pub(super) fn add(
    folder: &Path,
    make: impl FnOnce(&Scene, &EditList, &WriteLock) -> Result<edit::Edit>,
) -> Result<()> {
    let scene = Scene::open(folder)?;
    let lock = WriteLock::acquire(scene.folder())?;
    let mut list = EditList::load(&scene)?;
    let edit = make(&scene, &list, &lock)?;
    let said = edit::describe(&edit);
    list.push_checked(&scene, edit)?;
    keep(&scene, &list, &lock)?;
    output::line(said)
}

/// Changes the list of the scene in `folder`, as `load` gives it, by `how`, and says what that says.
fn change(
    folder: &Path,
    load: impl FnOnce(&Scene) -> tid3r::Result<EditList>,
    how: impl FnOnce(&mut EditList) -> tid3r::Result<String>,
) -> Result<()> {
    let scene = Scene::open(folder)?;
    let lock = WriteLock::acquire(scene.folder())?;
    let mut list = load(&scene)?;
    let said = how(&mut list)?;
    keep(&scene, &list, &lock)?;
    output::line(said)
}

/// Writes a changed list into its scene, and draws the overviews by it.
pub(super) fn keep(scene: &Scene, list: &EditList, lock: &WriteLock) -> tid3r::Result<()> {
    edit::keep(scene, &scene.frames(Role::Input)?, list, lock).map(drop)
}

/// The ids of instances that a person calls by id or name.
pub(super) fn resolve_all(list: &InstanceList, called: &[String]) -> tid3r::Result<Vec<u32>> {
    called.iter().map(|called| list.resolve(called)).collect()
}

impl NewEdit {
    /// The edit, with the ids of the instances that it names.
    fn resolved(self, scene: &Scene, list: &EditList, lock: &WriteLock) -> Result<edit::Edit> {
        let known = InstanceList::load(scene, list.edits())?;
        Ok(match self {
            Self::Remove { instances } => edit::Edit::Remove {
                instances: resolve_all(&known, &instances)?,
            },
            Self::KeepOnly { instances } => edit::Edit::KeepOnly {
                instances: resolve_all(&known, &instances)?,
            },
            Self::Move { instance, target } => edit::Edit::Move {
                instance: known.resolve(&instance)?,
                placement: target.placement(),
            },
            Self::Duplicate { instance, target } => edit::Edit::Duplicate {
                instance: known.resolve(&instance)?,
                copy: known.unused_id(),
                placement: target.placement(),
            },
            Self::Recolour(recolour) => edit::Edit::Recolour {
                change: recolour.change()?,
                instances: resolve_all(&known, &recolour.instances)?,
            },
            Self::Restyle { photos } => edit::restyle(scene, &photos, lock)?,
        })
    }
}

impl Target {
    fn placement(&self) -> Placement {
        Placement {
            by: self.by.unwrap_or_default(),
            to: self.to,
            turn_degrees: self.turn.unwrap_or(0.0),
            scale: self.scale.unwrap_or(1.0),
        }
    }
}

impl Recolour {
    fn change(&self) -> Result<ColourChange> {
        if let Some(colour) = self.to {
            return Ok(ColourChange::To { colour });
        }
        if self.hue.or(self.saturation).or(self.value).is_none() {
            let remedy = "give --to, or one of --hue, --saturation and --value";
            return Err(Error::request("nothing says what to change", remedy).into());
        }
        Ok(ColourChange::Adjust {
            hue_degrees: self.hue.unwrap_or(0.0),
            saturation: self.saturation.unwrap_or(1.0),
            value: self.value.unwrap_or(1.0),
        })
    }
}

fn list(scene: &Scene, json: bool) -> Result<()> {
    let list = EditList::load(scene)?;
    if json {
        return output::json(&serde_json::json!({
            "edits": list.edits(),
            "undone": list.undone(),
        }));
    }
    for (k, edit) in (1..).zip(list.edits()) {
        output::line(format!("edit {k}: {}", edit::describe(edit)))?;
    }
    if list.edits().is_empty() {
        output::line("no edits")?;
    }
    if list.undone() > 0 {
        output::line(format!("{} undone, which `redo` does again", list.undone()))?;
    }
    Ok(())
}
