//! Which scenes of many are one process's own, as a scheduler says.

use crate::{Error, Result};
use std::{fmt, str::FromStr};

/// One of several processes that divide scenes among them. The process takes every `count`-th scene, so that each scene
/// is one process's own and a process that is started again finds the same ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 0.
    index: usize,
    count: usize,
}

/// A [`Shard`] as people ask for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShardChoice {
    /// What the scheduler's variables say.
    Auto,
    /// This one.
    This(Shard),
}

impl Shard {
    /// All scenes.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// The process's share by the variables of its scheduler, which `variable` gives by name: a task of a Slurm array
    /// (`SLURM_ARRAY_TASK_ID`, `_MIN`, `_COUNT`, `_STEP`), a task of an `srun` (`SLURM_PROCID`, `SLURM_STEP_NUM_TASKS`) or both, or a
    /// pod of a Kubernetes indexed job (`JOB_COMPLETION_INDEX`; the job must set `JOB_COMPLETIONS`, as Kubernetes does not say
    /// how many there are).
    ///
    /// # Errors
    /// When no scheduler is there, or its variables do not tell one process from the others.
    pub fn of_scheduler(variable: impl Fn(&str) -> Option<String>) -> Result<Self> {
        let number = |name: &str| -> Result<Option<usize>> {
            let Some(text) = variable(name) else {
                return Ok(None);
            };
            let parsed = text.trim().parse().map(Some);
            parsed.map_err(|_| scheduler_says(format!("{name} is '{text}', which is no number")))
        };
        // Not SLURM_NTASKS: a batch script has that as well, and runs once.
        let task = match (number("SLURM_PROCID")?, number("SLURM_STEP_NUM_TASKS")?) {
            (Some(index), Some(count)) => Self::new(index, count).map_err(scheduler_says)?,
            _ => Self::WHOLE,
        };
        if let Some(id) = number("SLURM_ARRAY_TASK_ID")? {
            let count = number("SLURM_ARRAY_TASK_COUNT")?;
            let Some(count) = count else {
                return Err(scheduler_says("SLURM_ARRAY_TASK_COUNT is not set"));
            };
            let first = number("SLURM_ARRAY_TASK_MIN")?.unwrap_or(0);
            let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
            let place = id.checked_sub(first).filter(|steps| steps % step == 0);
            let array = place
                .map(|steps| steps / step)
                .map(|index| Self::new(index, count));
            let Some(Ok(array)) = array else {
                let problem = format!("task {id} is not one of {count} evenly numbered ones");
                return Err(scheduler_says(problem));
            };
            return Ok(Self {
                index: array.index * task.count + task.index,
                count: array.count * task.count,
            });
        }
        if task.count > 1 {
            return Ok(task);
        }
        if let Some(index) = number("JOB_COMPLETION_INDEX")? {
            let Some(count) = number("JOB_COMPLETIONS")? else {
                let problem = "JOB_COMPLETION_INDEX is set, but not of how many";
                return Err(Error::request(
                    problem,
                    "set JOB_COMPLETIONS in the pod's template to the job's `completions`, or give --shard I/N",
                ));
            };
            return Self::new(index, count).map_err(scheduler_says);
        }
        Err(Error::request(
            "--shard auto needs the variables of a Slurm array or step, or of a Kubernetes indexed job, and there are none",
            "start it as `sbatch --array=0-7`, or say which share it is: --shard 1/8",
        ))
    }

    fn new(index: usize, count: usize) -> Result<Self, String> {
        let possible = (index < count).then_some(Self { index, count });
        possible.ok_or_else(|| format!("there is no process {index} (from 0) of {count}"))
    }

    /// Whether the scene in this place of the list is this process's.
    pub fn takes(&self, place: usize) -> bool {
        place % self.count == self.index
    }
}

impl ShardChoice {
    /// The shard that is meant.
    ///
    /// # Errors
    /// As [`Shard::of_scheduler`].
    pub fn resolve(self) -> Result<Shard> {
        match self {
            Self::Auto => Shard::of_scheduler(|name| std::env::var(name).ok()),
            Self::This(shard) => Ok(shard),
        }
    }
}

fn scheduler_says(problem: impl fmt::Display) -> Error {
    Error::request(
        format!("the scheduler's variables cannot be used: {problem}"),
        "number the tasks from 0 on without gaps, or say which share this process has, as in --shard 1/8",
    )
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index + 1, self.count)
    }
}

impl FromStr for ShardChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let numbers = text.split_once('/').and_then(|(index, count)| {
            let index: usize = index.parse().ok()?;
            Some((index.checked_sub(1)?, count.parse().ok()?))
        });
        let shard = numbers.map(|(index, count)| Shard::new(index, count));
        match shard {
            Some(Ok(shard)) => Ok(Self::This(shard)),
            _ => Err("write auto, or I/N with I from 1 to N, as in 1/8".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Result<Shard> {
        Shard::of_scheduler(|name| {
            let found = variables.iter().find(|(key, _)| *key == name);
            found.map(|(_, value)| (*value).to_string())
        })
    }

    #[test]
    fn shards_divide_all_scenes_among_them() {
        let shards: Vec<Shard> = (1..=3)
            .map(|k| match format!("{k}/3").parse().unwrap() {
                ShardChoice::This(shard) => shard,
                ShardChoice::Auto => unreachable!(),
            })
            .collect();
        for place in 0..20 {
            assert_eq!(shards.iter().filter(|shard| shard.takes(place)).count(), 1);
        }
        assert!((0..5).all(|place| Shard::WHOLE.takes(place)));
    }

    #[test]
    fn schedulers_are_understood() {
        let array = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
        ];
        assert_eq!(of(&array).unwrap().to_string(), "4/4");
        let step = [("SLURM_PROCID", "1"), ("SLURM_STEP_NUM_TASKS", "2")];
        assert_eq!(of(&step).unwrap().to_string(), "2/2");
        let both: Vec<_> = array.into_iter().chain(step).collect();
        assert_eq!(of(&both).unwrap().to_string(), "8/8");
        let script = [("SLURM_PROCID", "0"), ("SLURM_NTASKS", "2")];
        let of_script: Vec<_> = array.into_iter().chain(script).collect();
        assert_eq!(of(&of_script).unwrap().to_string(), "4/4");
        let job = [("JOB_COMPLETION_INDEX", "0"), ("JOB_COMPLETIONS", "5")];
        assert_eq!(of(&job).unwrap().to_string(), "1/5");
    }

    #[test]
    fn what_does_not_tell_one_from_another_is_refused() {
        for (variables, says) in [
            (&[][..], "--shard auto needs"),
            (&[("JOB_COMPLETION_INDEX", "0")], "JOB_COMPLETIONS"),
            (
                &[("JOB_COMPLETION_INDEX", "5"), ("JOB_COMPLETIONS", "5")],
                "no process 5",
            ),
            (&[("SLURM_ARRAY_TASK_ID", "x")], "no number"),
            (&[("SLURM_ARRAY_TASK_ID", "1")], "TASK_COUNT"),
            // --array=1,3,7
            (
                &[
                    ("SLURM_ARRAY_TASK_ID", "7"),
                    ("SLURM_ARRAY_TASK_MIN", "1"),
                    ("SLURM_ARRAY_TASK_COUNT", "3"),
                ],
                "evenly",
            ),
        ] {
            let refusal = of(variables).unwrap_err().to_string();
            assert!(refusal.contains(says), "{refusal}");
        }
        for text in ["0/3", "4/3", "1", "a/b", "/", "1/0"] {
            assert!(text.parse::<ShardChoice>().is_err(), "{text}");
        }
    }
}
