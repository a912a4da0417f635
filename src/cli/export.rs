use super::{SceneArgument, output};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use tid3r::{
    Error,
    edit::{EditList, InstanceList},
    exchange::ply,
    render::EditedScene,
    scene::{Role, Scene, Stage},
};

/// Write the edited cloud for other programs.
///
/// A binary PLY file with position, colour, instance id and confidence of each point. Before the scene
/// has been segmented, all ids are 0.
#[derive(Debug, Args)]
pub(super) struct Export {
    #[command(flatten)]
    scene: SceneArgument,
    /// The file to write
    #[arg(short, long, value_name = "FILE.ply")]
    output: PathBuf,
    /// Only these instances, by id or name
    #[arg(long, value_name = "INSTANCE", num_args = 1.., value_delimiter = ',')]
    only: Vec<String>,
}

impl Export {
    pub(super) fn run(self) -> Result<()> {
        if self
            .output
            .extension()
            .is_none_or(|extension| !extension.eq_ignore_ascii_case("ply"))
        {
            let remedy = "give a name that ends in .ply";
            return Err(Error::file(
                &self.output,
                "is no kind of file that can be written",
                remedy,
            )
            .into());
        }
        let scene = Scene::open(&self.scene.scene)?;
        let segmented = scene.manifest().stages.contains_key(&Stage::Unify);
        let mut cloud = if segmented {
            EditedScene::load(&scene)?.edited.cloud
        } else {
            scene.cloud(&scene.frames(Role::Input)?)?
        };
        if !self.only.is_empty() {
            let instances = InstanceList::load(&scene, EditList::load(&scene)?.edits())?;
            let resolve = |called: &String| instances.resolve(called);
            let wanted = self
                .only
                .iter()
                .map(resolve)
                .collect::<Result<Vec<_>, _>>()?;
            cloud = cloud
                .partition(|index, cloud| wanted.contains(&cloud.instances[index]))
                .0;
        }
        ply::write_cloud(&self.output, &cloud, scene.manifest().scale)?;
        output::line(format!("{}: {} points", self.output.display(), cloud.len()))
    }
}
