use super::{SceneArgument, edit, output};
use anyhow::Result;
use clap::{Args, Subcommand};
use serde::Serialize;
use tid3r::{
    edit::{self as edits, Edit, EditList, InstanceList, MOST_CLUSTERS, SplitBy, SplitRequest},
    parameters::{coordinate, coordinates, positive},
    scene::{InstanceRecord, Scale, Scene},
};

/// List, merge, split and rename instances.
///
/// Segmentation finds most objects, and now and then makes two of one or one of two; here that is put
/// right. Merging, splitting and renaming are edits like others: later ones see the new instances, `tid3r
/// edit SCENE list` lists them, and `tid3r edit SCENE undo` undoes them. Instances are called by id or
/// name; contact_sheet.png in the scene's folder shows them.
#[derive(Debug, Args)]
#[command(subcommand_required = true)]
pub(super) struct Instances {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    List(List),
    Merge(Merge),
    Split(Split),
    Rename(Rename),
}

/// List the instances as the edits left them.
///
/// Size is width, depth and height; place is where the middle of the base stands, and how high. Both are in
/// the floor's frame, whose coordinates top_down.png shows and `tid3r edit SCENE move --to` takes. The
/// score says how well the photos agreed on the instance, from 0 to 1.
#[derive(Debug, Args)]
struct List {
    #[command(flatten)]
    scene: SceneArgument,
    /// Print them as JSON
    #[arg(long)]
    json: bool,
}

/// Make several instances one.
///
/// The first one named keeps its id and its name, the others become part of it: what is done to it
/// later is done to all of it.
#[derive(Debug, Args)]
struct Merge {
    #[command(flatten)]
    scene: SceneArgument,
    /// Ids or names, at least two
    #[arg(value_name = "INSTANCE", required = true, num_args = 2..)]
    instances: Vec<String>,
    /// What to call it from now on
    #[arg(long)]
    name: Option<String>,
}

/// Make parts of an instance instances of their own.
///
/// The largest part keeps id and name; with --above and --box, what is outside does. Other parts get new
/// ids and are called after it, "NAME (part 2)".
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r instances split room 4 --components\n  \
    tid3r instances split room 4 --above 0.45\n  \
    tid3r instances split room sofa --clusters 2")]
struct Split {
    #[command(flatten)]
    scene: SceneArgument,
    /// Id or name
    instance: String,
    #[command(flatten)]
    how: How,
    /// Points no farther apart than this hang together, in scene units [default: 8 times the usual
    /// distance between its neighbouring points]
    #[arg(long, value_name = "DISTANCE", value_parser = positive, requires = "components",
          conflicts_with_all = ["clusters", "above", "sides"])]
    gap: Option<f64>,
}

/// What says which part a point belongs to.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct How {
    /// Parts are what hangs together: objects that do not touch each other. Specks of less than 2 % of
    /// its points go with the part next to them
    #[arg(long)]
    components: bool,
    /// Parts are where its points gather (k-means), as many as you say
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=i64::from(MOST_CLUSTERS)))]
    clusters: Option<u32>,
    /// A part is what is higher above the floor than this, in scene units
    #[arg(long, value_name = "Z", value_parser = coordinate, allow_hyphen_values = true)]
    above: Option<f64>,
    /// A part is what is in this box: lowest x, y and z, then highest, in the floor's frame
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", value_parser = coordinates::<6>,
          allow_hyphen_values = true)]
    sides: Option<[f64; 6]>,
}

/// Give an instance a name.
#[derive(Debug, Args)]
struct Rename {
    #[command(flatten)]
    scene: SceneArgument,
    /// Id or name
    instance: String,
    /// The new name
    name: String,
}

impl Instances {
    pub(super) fn run(self) -> Result<()> {
        match self.action {
            Action::List(list) => list.run(),
            Action::Merge(merge) => merge.run(),
            Action::Split(split) => split.run(),
            Action::Rename(rename) => rename.run(),
        }
    }
}

/// An instance, as `list --json` gives it.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    record: InstanceRecord,
    size: [f64; 3],
    place: [f64; 3],
}

impl List {
    fn run(self) -> Result<()> {
        let scene = Scene::open(&self.scene.scene)?;
        let list = EditList::load(&scene)?;
        let listed: Vec<Listed> = edits::instances(&scene, list.edits())?
            .into_iter()
            .map(|record| Listed {
                size: record.size(),
                place: record.place(),
                record,
            })
            .collect();
        let scale = scene.manifest().scale;
        if self.json {
            return output::json(&serde_json::json!({ "scale": scale, "instances": listed }));
        }
        let unit = match scale {
            Scale::Metric => " (m)",
            Scale::Relative => "",
        };
        let heading = ["id", "name", "points", "photos", "size", "place", "score"];
        let heading = heading.map(|title| match title {
            "size" | "place" => format!("{title}{unit}"),
            _ => title.to_string(),
        });
        let mut rows = vec![heading.to_vec()];
        for Listed {
            record,
            size,
            place,
        } in listed
        {
            let [width, depth, height] = size;
            let [x, y, z] = place;
            rows.push(vec![
                record.id.to_string(),
                record.name,
                record.points.to_string(),
                record.photos.len().to_string(),
                format!("{width:.2} x {depth:.2} x {height:.2}"),
                format!("{x:.2}, {y:.2}, {z:.2}"),
                format!("{:.2}", record.score),
            ]);
        }
        output::table(&rows)
    }
}

impl Merge {
    fn run(self) -> Result<()> {
        edit::add(&self.scene.scene, |scene, list, _| {
            let known = InstanceList::load(scene, list.edits())?;
            let mut others = edit::resolve_all(&known, &self.instances)?;
            let instance = others.remove(0);
            Ok(Edit::Merge {
                instance,
                others,
                name: self.name.map(|name| name.trim().to_string()),
            })
        })
    }
}

impl Split {
    fn run(self) -> Result<()> {
        let request = self.how.request(self.gap);
        edit::add(&self.scene.scene, |scene, list, _| {
            let instance = InstanceList::load(scene, list.edits())?.resolve(&self.instance)?;
            Ok(edits::split(scene, list.edits(), instance, &request)?)
        })
    }
}

impl How {
    fn request(&self, gap: Option<f64>) -> SplitRequest {
        SplitRequest::By(if let Some(count) = self.clusters {
            SplitBy::Clusters { count }
        } else if let Some(height) = self.above {
            SplitBy::Above { height }
        } else if let Some([x0, y0, z0, x1, y1, z1]) = self.sides {
            SplitBy::Box {
                low: [x0, y0, z0],
                high: [x1, y1, z1],
            }
        } else {
            return SplitRequest::Components(gap);
        })
    }
}

impl Rename {
    fn run(self) -> Result<()> {
        edit::add(&self.scene.scene, |scene, list, _| {
            let known = InstanceList::load(scene, list.edits())?;
            Ok(Edit::Rename {
                instance: known.resolve(&self.instance)?,
                name: self.name.trim().to_string(),
            })
        })
    }
}
