use crate::{
    Error, Result,
    error::network_problem,
    machine::{
        PROGRAM_BYTES, Pace, Reached, network_memory, readable_bytes, readable_seconds,
        seconds_to_load,
    },
};
use std::fmt;
use tid3r_models::{
    ComputeType, Footprint,
    mvdust3r::{Config, Memory, Options, Paths, Work},
};

/// What a run of the network will take on this machine.
#[derive(Clone, Debug)]
pub struct RunEstimate {
    config: Config,
    views: usize,
    /// Height and width of the pictures.
    size: (usize, usize),
    gaussians: bool,
    footprint: Footprint,
    work: Work,
    /// Seconds, about.
    pub seconds: f64,
    /// Bytes, about, if memory is no concern.
    pub bytes: u64,
}

/// Of the network with one reference view.
const REACHED: Reached = Reached {
    f32: 0.71,
    bf16: 1.0,
};
/// Of that with several, which multiplies more rows with the same weights.
const REACHED_WITH_SEVERAL: Reached = Reached {
    f32: 0.77,
    bf16: 1.05,
};
/// What a photo takes besides the network, by measurement: to be read and ordered, to get its camera, to be written.
const SECONDS_PER_PHOTO: f64 = 0.1;
/// Tokens at a time, from what is fast to what is small.
const ROWS: [usize; 5] = [4096, 2048, 1024, 512, 1];

impl RunEstimate {
    /// For `views` pictures of `size` (height, width), with weights of this footprint, in this type.
    ///
    /// # Errors
    /// When the machine cannot be measured, or no network has this configuration.
    pub fn new(
        config: &Config,
        views: usize,
        size: (usize, usize),
        gaussians: bool,
        footprint: Footprint,
        dtype: ComputeType,
    ) -> Result<Self> {
        let work = Work::new(config, views, size, Paths::First, gaussians && config.gs);
        let pace = Pace::measured(dtype).map_err(|error| unknown(&network_problem(&error)))?;
        let reached = match config.m_ref_flag {
            true => REACHED_WITH_SEVERAL,
            false => REACHED,
        };
        let computing = pace.seconds(work.computed(), reached);
        let mut estimate = Self {
            config: config.clone(),
            views,
            size,
            gaussians,
            footprint,
            work,
            seconds: computing + SECONDS_PER_PHOTO * views as f64,
            bytes: 0,
        };
        estimate.bytes = estimate.bytes_with(views, ROWS[0])?;
        let (Footprint::Owned(size) | Footprint::Mapped(size)) = footprint;
        let in_memory = Self {
            footprint: Footprint::Owned(size),
            ..estimate.clone()
        };
        estimate.seconds += seconds_to_load(in_memory.memory_with(views, ROWS[0])?.weights);
        Ok(estimate)
    }

    /// Multiply-adds that the run will compute.
    pub fn work(&self) -> f64 {
        self.work.computed()
    }

    /// What `views` pictures take with so many tokens at a time.
    fn memory_with(&self, views: usize, rows: usize) -> Result<Memory> {
        let options = Options {
            gaussians: self.gaussians && self.config.gs,
            rows,
            ..Options::default()
        };
        Memory::new(&self.config, views, self.size, &options, self.footprint)
            .map_err(|error| unknown(&network_problem(&error)))
    }

    fn bytes_with(&self, views: usize, rows: usize) -> Result<u64> {
        Ok(total(&self.memory_with(views, rows)?))
    }

    /// The most tokens at a time with which the run fits into `limit` bytes, or, if none is given, into
    /// what is available.
    ///
    /// # Errors
    /// When it does not fit; the message says what would.
    pub fn rows_within(&self, limit: Option<u64>) -> Result<usize> {
        let Some(limit) = limit.or_else(network_memory) else {
            return Ok(ROWS[0]);
        };
        for rows in ROWS {
            if self.bytes_with(self.views, rows)? <= limit {
                return Ok(rows);
            }
        }
        let smallest = ROWS[ROWS.len() - 1];
        let least = self.config.references().max(2);
        let mut fitting = None;
        for views in (least..self.views).rev() {
            if self.bytes_with(views, smallest)? <= limit {
                fitting = Some(views);
                break;
            }
        }
        let (height, width) = self.size;
        let needed = readable_bytes(self.bytes_with(self.views, smallest)?);
        Err(Error::request(
            format!(
                "{} photos at {width}x{height} need {needed} of memory, and there may be {}",
                self.views,
                readable_bytes(limit)
            ),
            match fitting {
                Some(views) => format!("give at most {views} photos, or a smaller --size"),
                None => format!("allow for {needed}, or give a smaller --size"),
            },
        ))
    }
}

impl fmt::Display for RunEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (height, width) = self.size;
        write!(
            f,
            "{} photos at {width}x{height}: about {} and {}",
            self.views,
            readable_seconds(self.seconds),
            readable_bytes(self.bytes)
        )
    }
}

/// Bytes of the program and the network.
fn total(memory: &Memory) -> u64 {
    PROGRAM_BYTES + memory.total() as u64
}

fn unknown(problem: &dyn fmt::Display) -> Error {
    Error::request(
        format!("what the run will take cannot be told: {problem}"),
        "report this as a defect",
    )
}
