use super::Edit;
use crate::{
    Error, Result,
    scene::{InstanceRecord, Scene, Stage, files},
};
use std::collections::BTreeMap;

/// The instances of a scene as its edits left them: which there are, and what they are called.
#[derive(Clone, Debug)]
pub struct InstanceList {
    /// Those that segmentation found, by id.
    pub found: BTreeMap<u32, InstanceRecord>,
    /// The names of all instances that there are: found, copied or split off, and neither removed nor
    /// merged into others.
    pub names: BTreeMap<u32, String>,
    /// The scores of all that there are or were.
    scores: BTreeMap<u32, f64>,
}

impl InstanceList {
    /// Reads the list of instances and follows the edits.
    ///
    /// # Errors
    /// When the scene has not been segmented or a file is damaged.
    pub fn load(scene: &Scene, edits: &[Edit]) -> Result<Self> {
        scene.require(Stage::Unify)?;
        let path = scene.folder().join("instances.json");
        let again = scene.again(Stage::Unify);
        let records: Vec<InstanceRecord> = files::read_json(&path, &again)?;
        if !(1..).zip(&records).all(|(id, record)| record.id == id) {
            let problem = "is not what it should be (the ids are not 1, 2, 3, …)";
            return Err(Error::file(path, problem, again));
        }
        let found: BTreeMap<u32, InstanceRecord> = records
            .into_iter()
            .map(|record| (record.id, record))
            .collect();
        let name = |(&id, record): (&u32, &InstanceRecord)| (id, record.name.clone());
        let score = |(&id, record): (&u32, &InstanceRecord)| (id, record.score);
        let mut list = Self {
            names: found.iter().map(name).collect(),
            scores: found.iter().map(score).collect(),
            found,
        };
        for edit in edits {
            list.follow(edit);
        }
        Ok(list)
    }

    /// Whether an edit can be made of these instances.
    ///
    /// # Errors
    /// When it is about an instance that there is not, makes one whose id is not new, or gives a name
    /// that cannot be.
    pub fn check(&self, edit: &Edit) -> Result<()> {
        let known = |id: &&u32| self.names.contains_key(id);
        if let Some(id) = edit.named_instances().iter().find(|id| !known(id)) {
            return Err(self.unknown(&id.to_string()));
        }
        let first = self.unused_id();
        if let Some(id) = edit.new_instances().iter().find(|&&id| id < first) {
            return Err(Error::request(
                format!("the id {id} is not new"),
                format!("give new instances ids from {first} on"),
            ));
        }
        match edit {
            Edit::Rename { instance, name } => self.check_new_name(&[*instance], name),
            Edit::Merge {
                name: Some(name), ..
            } => self.check_new_name(&edit.named_instances(), name),
            _ => Ok(()),
        }
    }

    /// The instances after one more edit.
    pub fn follow(&mut self, edit: &Edit) {
        match edit {
            Edit::Rename { instance, name } => {
                self.names.insert(*instance, name.clone());
            }
            Edit::Merge {
                instance,
                others,
                name,
            } => {
                self.names.retain(|id, _| !others.contains(id));
                if let Some(name) = name {
                    self.names.insert(*instance, name.clone());
                }
                let scores = edit.named_instances().into_iter().map(|id| self.score(id));
                // Whether the views agree on all of it is as doubtful as of its worst part.
                let least = scores.fold(f64::INFINITY, f64::min);
                self.scores.insert(*instance, least);
            }
            Edit::Split {
                instance, parts, ..
            } => {
                for &part in parts {
                    self.derive(*instance, part, "part", 2);
                }
            }
            Edit::Remove { instances } => self.names.retain(|id, _| !instances.contains(id)),
            Edit::KeepOnly { instances } => self.names.retain(|id, _| instances.contains(id)),
            Edit::Duplicate { instance, copy, .. } => self.derive(*instance, *copy, "copy", 1),
            Edit::Move { .. } | Edit::Recolour { .. } | Edit::Restyle { .. } => {}
        }
    }

    /// A new instance that comes from another, called after it with a number, from `first` on.
    fn derive(&mut self, from: u32, new: u32, what: &str, first: u32) {
        let name = self.names.get(&from).cloned().unwrap_or_default();
        let numbered = (first..).map(|k| format!("{name} ({what} {k})"));
        let free = |name: &String| !self.names.values().any(|other| other == name);
        let name = numbered.into_iter().find(free).unwrap_or_default();
        self.names.insert(new, name);
        self.scores.insert(new, self.score(from));
    }

    /// How well the views agree on an instance, 0 to 1: of what it was copied or split from, and the
    /// least of those that were merged.
    pub fn score(&self, id: u32) -> f64 {
        self.scores.get(&id).copied().unwrap_or(0.0)
    }

    /// The scores of the instances that were found, by id: that of id 1 first.
    pub fn scores(&self) -> Vec<f64> {
        let highest = self.found.keys().last().copied().unwrap_or(0);
        let score = |id| self.found.get(&id).map_or(0.0, |record| record.score);
        (1..=highest).map(score).collect()
    }

    /// The instance that a person calls by its id or its name (case does not matter).
    ///
    /// # Errors
    /// When there is none, or several of that name.
    pub fn resolve(&self, called: &str) -> Result<u32> {
        let called = called.trim();
        if let Some(id) = called.parse().ok().filter(|id| self.names.contains_key(id)) {
            return Ok(id);
        }
        let same = |name: &str| name.to_lowercase() == called.to_lowercase();
        let named: Vec<u32> = self
            .names
            .iter()
            .filter(|(_, name)| same(name))
            .map(|(&id, _)| id)
            .collect();
        match named[..] {
            [id] => Ok(id),
            [] => Err(self.unknown(called)),
            _ => Err(Error::request(
                format!("several instances are called '{called}'"),
                format!("give one of the ids {named:?}"),
            )),
        }
    }

    fn unknown(&self, called: &str) -> Error {
        let remedy = match self.summary() {
            none if none.is_empty() => {
                "there are none; `tid3r edit SCENE undo` brings back what was removed".to_owned()
            }
            known => format!("the instances are {known}; contact_sheet.png shows them"),
        };
        Error::request(format!("there is no instance '{called}'"), remedy)
    }

    /// The first of the ids that no instance has, nor had before it was removed.
    pub fn unused_id(&self) -> u32 {
        let highest = self.scores.keys().last();
        highest.map_or(1, |highest| highest.saturating_add(1))
    }

    /// Whether an instance can be given a name; those of `instances` do not stand in the way.
    fn check_new_name(&self, instances: &[u32], name: &str) -> Result<()> {
        let remedy = "choose another name";
        let unusable = |c: char| c.is_control() || c == ',';
        if name.trim().is_empty() || name.chars().any(unusable) {
            let problem = "a name must have letters that can be shown, and no comma";
            return Err(Error::request(problem, remedy));
        }
        if name.trim().parse::<u32>().is_ok() {
            return Err(Error::request(
                format!("'{name}' would be taken for an id"),
                remedy,
            ));
        }
        let same = |other: &str| other.to_lowercase() == name.to_lowercase();
        match self
            .names
            .iter()
            .find(|(id, other)| !instances.contains(id) && same(other))
        {
            Some((id, _)) => Err(Error::request(
                format!("instance {id} is called '{name}' already"),
                remedy,
            )),
            None => Ok(()),
        }
    }

    fn summary(&self) -> String {
        const SHOWN: usize = 20;
        let shown = self.names.iter().take(SHOWN).map(|(id, name)| {
            if *name == format!("instance {id}") {
                id.to_string()
            } else {
                format!("{id} ({name})")
            }
        });
        let mut list: Vec<String> = shown.collect();
        if self.names.len() > SHOWN {
            list.push("…".into());
        }
        list.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Placement, SplitBy};

    fn list() -> InstanceList {
        let ids = [1, 2, 3];
        InstanceList {
            found: BTreeMap::new(),
            names: ids.map(|id| (id, format!("instance {id}"))).into(),
            scores: ids.map(|id| (id, 1.0 / f64::from(id))).into(),
        }
    }

    fn after(edits: &[Edit]) -> InstanceList {
        let mut list = list();
        for edit in edits {
            list.check(edit).unwrap();
            list.follow(edit);
        }
        list
    }

    fn merge(instance: u32, others: &[u32], name: Option<&str>) -> Edit {
        Edit::Merge {
            instance,
            others: others.to_vec(),
            name: name.map(String::from),
        }
    }

    fn split(instance: u32, parts: &[u32]) -> Edit {
        Edit::Split {
            instance,
            by: SplitBy::Clusters { count: 2 },
            parts: parts.to_vec(),
        }
    }

    fn names(list: &InstanceList) -> Vec<(u32, &str)> {
        let names = list.names.iter();
        names.map(|(&id, name)| (id, name.as_str())).collect()
    }

    #[test]
    fn merged_instances_go_by_the_first() {
        let merged = after(&[merge(2, &[1], None)]);
        assert_eq!(names(&merged), [(2, "instance 2"), (3, "instance 3")]);
        assert_eq!(merged.score(2), 0.5, "the lower one");
        assert_eq!(after(&[merge(1, &[2, 3], None)]).score(1), 1.0 / 3.0);
        let named = after(&[merge(3, &[1], Some("Instance 1"))]);
        assert_eq!(
            names(&named),
            [(2, "instance 2"), (3, "Instance 1")],
            "a name that was merged away is free"
        );
        let taken = list().check(&merge(3, &[1], Some("instance 2")));
        assert!(taken.unwrap_err().to_string().contains("already"));
    }

    #[test]
    fn parts_are_numbered() {
        let list = after(&[split(2, &[4, 5]), split(2, &[6]), split(4, &[7])]);
        let wanted = [
            (1, "instance 1"),
            (2, "instance 2"),
            (3, "instance 3"),
            (4, "instance 2 (part 2)"),
            (5, "instance 2 (part 3)"),
            (6, "instance 2 (part 4)"),
            (7, "instance 2 (part 2) (part 2)"),
        ];
        assert_eq!(names(&list), wanted);
        assert_eq!(list.score(7), 0.5);
        assert_eq!(list.unused_id(), 8);
    }

    #[test]
    fn ids_are_never_used_twice() {
        let remove = Edit::Remove { instances: vec![4] };
        let list = after(&[split(1, &[4]), remove]);
        assert_eq!(list.unused_id(), 5);
        let copy = |copy| Edit::Duplicate {
            instance: 1,
            copy,
            placement: Placement::default(),
        };
        assert!(list.check(&copy(5)).is_ok());
        let message = list.check(&copy(4)).unwrap_err().to_string();
        assert!(message.contains("from 5 on"), "{message}");
        assert!(list.check(&split(1, &[3])).is_err());
    }

    #[test]
    fn edits_of_what_is_not_there_are_refused() {
        let remove = |instances: &[u32]| Edit::Remove {
            instances: instances.to_vec(),
        };
        let list = after(&[merge(1, &[2], None)]);
        for edit in [
            remove(&[1, 2]),
            merge(1, &[2], None),
            merge(2, &[1], None),
            split(2, &[4]),
            split(9, &[4]),
        ] {
            let message = list.check(&edit).unwrap_err().to_string();
            assert!(message.contains("the instances are 1, 3;"), "{message}");
        }
        assert!(list.check(&remove(&[1, 3])).is_ok());
    }
}
