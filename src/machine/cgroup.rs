//! How much memory the control groups that this process is in leave it: those of containers, batch systems and
//! systemd, on Linux.
//!
//! Files of the kernel, version 1 and 2, as described in its `cgroup-v1/memory.rst` and `cgroup-v2.rst`.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// What a group allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Allowance {
    /// Bytes that all processes of the group may have together.
    pub(super) limit: u64,
    /// Bytes that they do not have yet. What is cached of files does not count: the system drops it where memory is
    /// wanted.
    pub(super) left: u64,
}

/// Larger limits are none: version 1 says "no limit" by the largest number of pages.
const NO_LIMIT: u64 = 1 << 60;

/// The lowest limit, and the least that is left, of all groups that this process is in; `None` where there is no
/// limit, or no such groups.
pub(super) fn memory() -> Option<Allowance> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let mounts = fs::read_to_string("/proc/self/mountinfo").ok()?;
    memory_of(&groups, &mounts)
}

fn memory_of(groups: &str, mounts: &str) -> Option<Allowance> {
    let allowances = groups.lines().filter_map(|line| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let version = match controllers {
            "" => &V2,
            _ if controllers.split(',').any(|name| name == "memory") => &V1,
            _ => return None,
        };
        let (root, mounted) = mount(mounts, version)?;
        // Seen from within a container, the path may begin outside of what is mounted.
        let below = Path::new(path).strip_prefix(&root).unwrap_or(Path::new(""));
        let folder = mounted.join(below);
        let folders = folder.ancestors();
        let inside = folders.take_while(|folder| folder.starts_with(&mounted));
        least(inside.filter_map(|folder| version.allowance(folder)))
    });
    least(allowances)
}

fn least(allowances: impl Iterator<Item = Allowance>) -> Option<Allowance> {
    allowances.reduce(|a, b| Allowance {
        limit: a.limit.min(b.limit),
        left: a.left.min(b.left),
    })
}

/// How a version of control groups calls its things.
struct Version {
    filesystem: &'static str,
    /// What its mount must control; empty where one controls everything.
    controller: &'static str,
    limit: &'static str,
    used: &'static str,
    /// Lines of `memory.stat` that count what is cached of files.
    cached: [&'static str; 2],
}

const V1: Version = Version {
    filesystem: "cgroup",
    controller: "memory",
    limit: "memory.limit_in_bytes",
    used: "memory.usage_in_bytes",
    cached: ["total_active_file", "total_inactive_file"],
};

const V2: Version = Version {
    filesystem: "cgroup2",
    controller: "",
    limit: "memory.max",
    used: "memory.current",
    cached: ["active_file", "inactive_file"],
};

/// Which group is mounted, and where.
fn mount(mounts: &str, version: &Version) -> Option<(PathBuf, PathBuf)> {
    mounts.lines().find_map(|line| {
        let (mount, system) = line.split_once(" - ")?;
        let mut system = system.split(' ');
        let is_wanted = system.next() == Some(version.filesystem)
            && (version.controller.is_empty()
                || (system.nth(1)?.split(',')).any(|option| option == version.controller));
        let mut mount = mount.split(' ').skip(3);
        let (root, mounted) = (mount.next()?, mount.next()?);
        is_wanted.then(|| (root.into(), mounted.into()))
    })
}

impl Version {
    fn allowance(&self, folder: &Path) -> Option<Allowance> {
        let read = |name| fs::read_to_string(folder.join(name)).ok();
        // "max" is no number, and no limit.
        let number = |name| read(name)?.trim().parse::<u64>().ok();
        let limit = number(self.limit).filter(|&limit| limit < NO_LIMIT)?;
        let used = number(self.used)?;
        let cached = read("memory.stat").unwrap_or_default();
        let cached = cached.lines().filter_map(|line| {
            let (name, bytes) = line.split_once(' ')?;
            self.cached.contains(&name).then(|| bytes.parse().ok())?
        });
        let cached: u64 = cached.fold(0, u64::saturating_add);
        Some(Allowance {
            limit,
            left: limit.saturating_sub(used.saturating_sub(cached)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A group's folder with these files.
    fn group(root: &Path, path: &str, files: [(&str, &str); 3]) {
        let folder = root.join(path);
        fs::create_dir_all(&folder).unwrap();
        for (name, text) in files {
            fs::write(folder.join(name), format!("{text}\n")).unwrap();
        }
    }

    #[test]
    fn the_tightest_of_nested_groups_counts_and_caches_do_not() {
        let root = tempfile::tempdir().unwrap();
        let stat = "anon 5\nactive_file 200\ninactive_file 100\nfile 300";
        let files = |limit, used| {
            [
                ("memory.max", limit),
                ("memory.current", used),
                ("memory.stat", stat),
            ]
        };
        group(root.path(), "job", files("5000", "1000"));
        group(root.path(), "job/step", files("max", "900"));
        group(root.path(), "job/step/task", files("6000", "5900"));
        let mounts = format!(
            "24 23 0:5 / /proc rw - proc proc rw\n30 23 0:26 /slice {} rw - cgroup2 cgroup rw",
            root.path().display()
        );
        assert_eq!(
            memory_of("1:cpu:/x\n0::/slice/job/step/task\n", &mounts),
            Some(Allowance {
                limit: 5000,
                left: 400
            })
        );
        // Groups outside of what is mounted: what is mounted limits all the same, and here does not.
        assert_eq!(memory_of("0::/elsewhere\n", &mounts), None);
        assert_eq!(memory_of("0::/slice/job\n", ""), None);
        assert_eq!(memory_of("nonsense\n::\n", "nonsense - cgroup2"), None);
    }

    #[test]
    fn groups_of_the_first_version_are_understood() {
        let root = tempfile::tempdir().unwrap();
        let files = |limit, used| {
            [
                ("memory.limit_in_bytes", limit),
                ("memory.usage_in_bytes", used),
                (
                    "memory.stat",
                    "active_file 7\ntotal_active_file 30\ntotal_inactive_file 20",
                ),
            ]
        };
        group(root.path(), "", files("9223372036854771712", "100"));
        group(root.path(), "docker", files("1000", "450"));
        let mounts = format!(
            "34 31 0:31 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n\
             35 31 0:32 / {} rw,nosuid shared:9 - cgroup cgroup rw,memory",
            root.path().display()
        );
        let wanted = Allowance {
            limit: 1000,
            left: 600,
        };
        let found = memory_of("5:cpu,cpuacct:/docker\n4:memory:/docker\n0::/\n", &mounts);
        assert_eq!(found, Some(wanted));
        assert_eq!(memory_of("4:memory:/\n", &mounts), None);
    }
}
