//! What frames attend to besides each other.

use candle_core::{Result, bail};

use crate::nn::Memory;

/// The keys and values that every transformer makes of a context: they are the same in all steps.
#[derive(Clone, Debug)]
pub struct Context {
    /// Of each transformer in the order in which they run; (rows, tokens, channels).
    memories: Vec<Memory>,
    rows: usize,
}

impl Context {
    pub(super) fn new(memories: Vec<Memory>, rows: usize) -> Self {
        Self { memories, rows }
    }

    /// 1 if all frames attend to the same, else the number of frames of all groups.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The rows of `frames` frames from number `first` on, as a context of its own; all of it if it is the
    /// same for all.
    ///
    /// # Errors
    ///
    /// If there are not as many rows.
    pub fn narrow(&self, first: usize, frames: usize) -> Result<Self> {
        if self.rows == 1 {
            return Ok(self.clone());
        }
        let memories = (self.memories.iter()).map(|memory| narrow(memory, first, frames));
        Ok(Self::new(memories.collect::<Result<_>>()?, frames))
    }

    /// What transformer `index` made of it.
    pub(super) fn memory(&self, index: usize) -> Result<&Memory> {
        match self.memories.get(index) {
            Some(memory) => Ok(memory),
            None => {
                bail!("the context was made by another network: there is no transformer {index}")
            }
        }
    }
}

/// `count` entries of the batch of a memory, from `first` on.
pub(super) fn narrow(memory: &Memory, first: usize, count: usize) -> Result<Memory> {
    Ok(Memory {
        k: memory.k.narrow(0, first, count)?,
        v: memory.v.narrow(0, first, count)?,
    })
}
