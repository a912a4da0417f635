use super::{SceneArgument, output};
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use tid3r::{
    Error,
    edit::{self, ColourChange, EditList, Hex, InstanceList, Placement},
    parameters::{coordinate, coordinates, factor, not_negative},
    scene::{Scene, WriteLock},
};

/// Remove, move, copy, recolour or rename instances; undo and redo.
///
/// Instances are called by id or name; contact_sheet.png in the scene's folder shows them. Edits are a
/// list: nothing is lost, and every one can be undone.
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
    /// List the instances, and the edits made so far
    List {
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
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
    /// Give an instance a name
    Rename {
        /// Id or name
        instance: String,
        /// The new name
        name: String,
    },
    /// Undo the last edit
    Undo,
    /// Do the last undone edit again
    Redo,
    /// Undo all edits
    Clear,
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
        let scene = Scene::open(&self.scene.scene)?;
        if let Action::List { json } = self.action {
            return list(&scene, json);
        }
        let lock = WriteLock::acquire(scene.folder())?;
        if let Action::Clear = self.action {
            // Edits of instances that are no more cannot be done again.
            let mut list = EditList::load(&scene).or_else(|_| EditList::cleared(&scene))?;
            list.undo_all();
            edit::write_overviews(&scene, list.edits(), &lock)?;
            list.save(&scene, &lock)?;
            return output::line("all edits undone");
        }
        let mut list = EditList::load(&scene)?;
        let said = match self.action {
            Action::Undo => match list.undo() {
                Some(undone) => format!("undone: {}", edit::describe(undone)),
                None => return Err(Error::request("there is nothing to undo", "edit first").into()),
            },
            Action::Redo => match list.redo() {
                Some(redone) => format!("done again: {}", edit::describe(redone)),
                None => {
                    let problem = "there is nothing to do again";
                    return Err(Error::request(problem, "undo something first").into());
                }
            },
            action => {
                let edit = action.edit(&scene, &list, &lock)?;
                let said = edit::describe(&edit);
                list.push(edit)?;
                said
            }
        };
        edit::write_overviews(&scene, list.edits(), &lock)?;
        list.save(&scene, &lock)?;
        output::line(said)
    }
}

impl Action {
    /// The edit that is asked for; actions on the list itself are none.
    fn edit(self, scene: &Scene, list: &EditList, lock: &WriteLock) -> Result<edit::Edit> {
        let instances = InstanceList::load(scene, list.edits())?;
        let resolve = |called: &str| instances.resolve(called);
        let resolve_all = |called: &[String]| {
            called
                .iter()
                .map(|c| resolve(c))
                .collect::<Result<Vec<_>, _>>()
        };
        Ok(match self {
            Self::Remove { instances } => edit::Edit::Remove {
                instances: resolve_all(&instances)?,
            },
            Self::KeepOnly { instances } => edit::Edit::KeepOnly {
                instances: resolve_all(&instances)?,
            },
            Self::Move { instance, target } => edit::Edit::Move {
                instance: resolve(&instance)?,
                placement: target.placement(),
            },
            Self::Duplicate { instance, target } => edit::Edit::Duplicate {
                instance: resolve(&instance)?,
                copy: instances.unused_id(list.edits()),
                placement: target.placement(),
            },
            Self::Recolour(recolour) => edit::Edit::Recolour {
                change: recolour.change()?,
                instances: resolve_all(&recolour.instances)?,
            },
            Self::Restyle { photos } => edit::restyle(scene, &photos, lock)?,
            Self::Rename { instance, name } => {
                let instance = resolve(&instance)?;
                instances.check_new_name(instance, &name)?;
                edit::Edit::Rename {
                    instance,
                    name: name.trim().to_string(),
                }
            }
            Self::List { .. } | Self::Undo | Self::Redo | Self::Clear => {
                unreachable!("actions on the list are done before")
            }
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
    let instances = InstanceList::load(scene, list.edits())?;
    if json {
        return output::json(&serde_json::json!({
            "instances": instances.names,
            "found": instances.found.values().collect::<Vec<_>>(),
            "edits": list.edits(),
            "undone": list.undone(),
        }));
    }
    let heading = ["id", "name", "points", "photos", "agreement"];
    let mut rows = vec![heading.map(String::from).to_vec()];
    for (id, name) in &instances.names {
        let mut row = vec![id.to_string(), name.clone()];
        if let Some(found) = instances.found.get(id) {
            row.push(found.points.to_string());
            row.push(found.photos.len().to_string());
            row.push(format!("{:.2}", found.score));
        }
        rows.push(row);
    }
    output::table(&rows)?;
    for (k, edit) in (1..).zip(list.edits()) {
        output::line(format!("edit {k}: {}", edit::describe(edit)))?;
    }
    if list.undone() > 0 {
        output::line(format!("{} undone, which `redo` does again", list.undone()))?;
    }
    Ok(())
}
