use crate::{
    geometry::{Camera, Pose, matrix4},
    photos::{Photo, PhotoTransform},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// The version of the scene folder that this program reads and writes.
pub(crate) const VERSION: u32 = 1;

/// What the scene's units are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scale {
    /// Metres.
    Metric,
    /// Unknown, but the same throughout the scene.
    Relative,
}

/// A step of the pipeline whose result the scene folder keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Photos to cameras and depth, by a network or a recording.
    Reconstruct,
    /// Removal of anomalous points.
    Clean,
    /// Frames to masks.
    Masks,
    /// Masks to instances.
    Unify,
}

impl Stage {
    /// The stages whose results this one reads.
    pub fn inputs(self) -> &'static [Self] {
        match self {
            Self::Reconstruct => &[],
            Self::Clean | Self::Masks => &[Self::Reconstruct],
            Self::Unify => &[Self::Clean, Self::Masks],
        }
    }

    /// The verb that makes this stage's result.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Reconstruct => "import",
            Self::Clean => "clean",
            Self::Masks | Self::Unify => "segment",
        }
    }
}

/// What is known of a stage that was run to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// The parameters it ran with.
    pub parameters: Value,
    /// A hash of the parameters and of the results that it read.
    pub recipe: String,
    /// A hash of its own result.
    pub output: String,
    /// What it has to tell, for people.
    pub report: Value,
}

/// A frame as `scene.json` lists it; its pixels and maps are in a folder of its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// The photo.
    #[serde(flatten)]
    pub photo: Photo,
    /// How the frame was cut out of it.
    pub transform: PhotoTransform,
    /// Lens and pose, of the frame (not of the photo).
    pub camera: Camera,
}

/// `scene.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Of the folder's layout: 1 so far.
    pub version: u32,
    /// The program that wrote it.
    pub generator: String,
    /// What the units are.
    pub scale: Scale,
    /// From the floor's frame to the scene's: x right and y ahead as the first camera looks, z up,
    /// the origin on the floor under the first camera.
    #[serde(with = "matrix4")]
    pub floor_to_world: Pose,
    /// The photos that the scene is made from.
    pub frames: Vec<FrameRecord>,
    /// Photos kept apart, to compare rendered views with.
    pub held_out: Vec<FrameRecord>,
    /// The stages that have been run.
    pub stages: BTreeMap<Stage, StageRecord>,
}

impl Manifest {
    /// The hash that identifies `stage` run with `parameters` on what the scene holds now; `None`
    /// while a stage that it needs is missing or out of date.
    pub fn recipe(&self, stage: Stage, parameters: &Value) -> Option<String> {
        let mut hasher = Hasher::new();
        if stage != Stage::Reconstruct {
            // Another version of the program may come to another result. It cannot redo the
            // reconstruction by itself, though.
            hasher.text(env!("CARGO_PKG_VERSION"));
        }
        hasher
            .text(&format!("{stage:?}"))
            .text(&parameters.to_string());
        for &input in stage.inputs() {
            hasher.text(&self.fresh(input)?.output);
        }
        Some(hasher.finish())
    }

    /// The record of `stage`, if it has been run and nothing that it read has changed since.
    pub fn fresh(&self, stage: Stage) -> Option<&StageRecord> {
        let record = self.stages.get(&stage)?;
        (self.recipe(stage, &record.parameters)? == record.recipe).then_some(record)
    }
}

/// SHA-256 over a sequence of parts, each with its length, so that no two sequences collide.
pub struct Hasher(Sha256);

impl Hasher {
    /// Of nothing yet.
    #[expect(clippy::new_without_default, reason = "a hasher is never a default")]
    pub fn new() -> Self {
        Self(Sha256::new())
    }

    /// One more part.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// One more part.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.bytes(text.as_bytes())
    }

    /// The hash of all parts, in hexadecimal.
    pub fn finish(self) -> String {
        let digits = self.0.finalize();
        digits.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn run(manifest: &mut Manifest, stage: Stage, parameters: Value, output: &str) {
        let recipe = manifest.recipe(stage, &parameters).unwrap();
        let record = StageRecord {
            parameters,
            recipe,
            output: output.into(),
            report: Value::Null,
        };
        manifest.stages.insert(stage, record);
    }

    #[test]
    fn a_stage_is_fresh_until_something_it_read_changes() {
        let mut manifest = Manifest {
            version: VERSION,
            generator: "test".into(),
            scale: Scale::Relative,
            floor_to_world: Pose::identity(),
            frames: vec![],
            held_out: vec![],
            stages: BTreeMap::new(),
        };
        assert!(
            manifest.recipe(Stage::Clean, &json!({})).is_none(),
            "nothing to clean yet"
        );
        run(&mut manifest, Stage::Reconstruct, json!({}), "depth 1");
        run(
            &mut manifest,
            Stage::Clean,
            json!({"tau": 0.75}),
            "validity 1",
        );
        run(&mut manifest, Stage::Masks, json!({}), "masks 1");
        run(&mut manifest, Stage::Unify, json!({}), "instances 1");
        assert!(manifest.fresh(Stage::Unify).is_some());
        run(
            &mut manifest,
            Stage::Clean,
            json!({"tau": 0.5}),
            "validity 1",
        );
        assert!(
            manifest.fresh(Stage::Unify).is_some(),
            "other parameters, same result"
        );
        run(
            &mut manifest,
            Stage::Clean,
            json!({"tau": 0.5}),
            "validity 2",
        );
        assert!(manifest.fresh(Stage::Unify).is_none());
        assert!(
            manifest.fresh(Stage::Masks).is_some(),
            "masks do not read the validity"
        );
        run(&mut manifest, Stage::Reconstruct, json!({}), "depth 2");
        assert!(manifest.fresh(Stage::Masks).is_none() && manifest.fresh(Stage::Clean).is_none());
    }
}
