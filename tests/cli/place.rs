use crate::recording;
use assert_cmd::Command;
use serde_json::Value;
use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
    process::Output,
};
use tempfile::TempDir;

/// A temporary folder to run the program in.
pub(crate) struct Place(TempDir);

/// The files of a folder by their paths in it, with what they hold.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The program's file.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_tid3r");

impl Place {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// With a 7-Scenes recording in `recording`.
    pub(crate) fn with_recording() -> Self {
        let place = Self::new();
        recording::write_seven_scenes(&place.path("recording"));
        place
    }

    /// With a scene in `scene`: five photos, two held out, cleaned, and segmented by label images.
    pub(crate) fn with_scene() -> Self {
        let place = Self::with_recording();
        recording::write_masks(&place.path("masks"));
        place.run("import recording -o scene --test-frames 2,4");
        place.run("clean scene");
        place.run("segment scene --masks masks");
        place
    }

    pub(crate) fn folder(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn path(&self, path: &str) -> PathBuf {
        self.folder().join(path)
    }

    pub(crate) fn write(&self, path: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(path), content).unwrap();
    }

    /// A JSON file.
    pub(crate) fn read_json(&self, path: &str) -> Value {
        serde_json::from_slice(&fs::read(self.path(path)).unwrap()).unwrap()
    }

    /// The ids of the red and the blue box in `scene`.
    pub(crate) fn boxes(&self) -> [u64; 2] {
        let instances = self.read_json("scene/instances.json");
        let id = |strong: usize, weak: usize| {
            let found = instances.as_array().unwrap().iter().find(|instance| {
                let channel = |k: usize| instance["mean_colour"][k].as_u64().unwrap();
                channel(strong) > channel(weak) + 60
            });
            found.unwrap()["id"].as_u64().unwrap()
        };
        [id(0, 2), id(2, 0)]
    }

    /// What the program does with arguments that have no spaces within.
    pub(crate) fn output(&self, arguments: &str) -> Output {
        self.output_of(&Vec::from_iter(arguments.split_whitespace()))
    }

    /// What the program does with arguments.
    pub(crate) fn output_of(&self, arguments: &[impl AsRef<OsStr>]) -> Output {
        Command::new(PROGRAM)
            .args(arguments)
            .current_dir(self.folder())
            .env_remove("RUST_LOG")
            .env("RUST_BACKTRACE", "1")
            .output()
            .unwrap()
    }

    /// Exit code, standard output and standard error of a run that sees nothing of the tester's own set-up: home and
    /// the cache of Hugging Face are in the place.
    pub(crate) fn secluded(
        &self,
        arguments: &str,
        environment: &[(&str, &str)],
    ) -> (i32, String, String) {
        let mut command = Command::new(PROGRAM);
        for name in [
            "TID3R_MODELS",
            "TID3R_CPU",
            "HF_HOME",
            "HF_HUB_CACHE",
            "HUGGINGFACE_HUB_CACHE",
            "XDG_CACHE_HOME",
            "RUST_LOG",
        ] {
            command.env_remove(name);
        }
        let output = command
            .args(arguments.split_whitespace())
            .current_dir(self.folder())
            .env("HOME", self.folder())
            .envs(environment.iter().copied())
            .output()
            .unwrap();
        let [out, err] = texts(&output);
        (output.status.code().unwrap(), out, err)
    }

    /// Standard output and standard error of a run that succeeds.
    pub(crate) fn run_loud(&self, arguments: &str) -> [String; 2] {
        let output = self.output(arguments);
        let [out, err] = texts(&output);
        assert_eq!(output.status.code(), Some(0), "{arguments}: {err}");
        [out, err]
    }

    /// Standard output of a run that succeeds and has nothing to complain about.
    pub(crate) fn run(&self, arguments: &str) -> String {
        let [out, err] = self.run_loud(arguments);
        assert_eq!(err, "", "{arguments}");
        out
    }

    /// The one JSON value on standard output.
    pub(crate) fn json(&self, arguments: &str) -> Value {
        serde_json::from_str(&self.run(arguments)).unwrap()
    }

    /// What a run that fails says: one message, naming what is wrong and a remedy, and nothing else.
    pub(crate) fn fail(&self, arguments: &str) -> String {
        let output = self.output(arguments);
        let [out, err] = texts(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {out}{err}");
        assert_eq!(out, "", "{arguments}");
        let message = err.strip_prefix("error: ").unwrap_or_else(|| {
            panic!("{arguments}: {err}");
        });
        let message = message.trim_end();
        assert!(!message.contains("panicked"), "{arguments}: {err}");
        assert_eq!(message.lines().count(), 1, "{arguments}: {err}");
        let said = message.matches("os error").count();
        assert!(said <= 1, "{arguments}, said twice: {err}");
        message.to_string()
    }

    /// What is said of arguments that cannot be.
    pub(crate) fn misuse(&self, arguments: &str) -> String {
        let output = self.output(arguments);
        let [out, err] = texts(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments}: {out}{err}");
        assert_eq!(out, "", "{arguments}");
        err
    }

    /// All files below a folder but locks, and timings, which no two runs share.
    ///
    /// A server may tidy up meanwhile: what is gone when its turn comes is left out.
    pub(crate) fn files(&self, folder: &str) -> Files {
        fn there<T>(result: io::Result<T>) -> Option<T> {
            match result {
                Err(error) if error.kind() == io::ErrorKind::NotFound => None,
                result => Some(result.unwrap()),
            }
        }
        fn collect(root: &Path, folder: &Path, files: &mut Files) {
            for entry in there(fs::read_dir(folder)).into_iter().flatten() {
                let path = entry.unwrap().path();
                let name = path.file_name().unwrap().to_string_lossy();
                if path.is_dir() {
                    collect(root, &path, files);
                } else if name != "timings.json" && name != ".tid3r-lock" {
                    let below = path.strip_prefix(root).unwrap().to_string_lossy();
                    let bytes = there(fs::read(&path));
                    files.extend(bytes.map(|bytes| (below.into_owned(), bytes)));
                }
            }
        }
        let mut files = Files::new();
        let root = self.path(folder);
        collect(&root, &root, &mut files);
        files
    }

    /// When each file below a folder was written last.
    pub(crate) fn times(&self, folder: &str) -> BTreeMap<String, std::time::SystemTime> {
        let time = |name: &String| {
            let path = self.path(folder).join(name);
            fs::metadata(path).unwrap().modified().unwrap()
        };
        let names = self.files(folder).into_keys();
        names.map(|name| (name.clone(), time(&name))).collect()
    }
}

fn texts(output: &Output) -> [String; 2] {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8(bytes.clone()).unwrap())
}

/// Fails with the names of the files that differ.
pub(crate) fn assert_same_files(found: &Files, wanted: &Files) {
    let names = found.keys().chain(wanted.keys());
    let mut different: Vec<&String> = names
        .filter(|name| found.get(*name) != wanted.get(*name))
        .collect();
    different.dedup();
    assert!(different.is_empty(), "{different:?}");
}
