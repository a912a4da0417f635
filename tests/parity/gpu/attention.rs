//! Attention by the kernel for GPUs beside attention in f32 on the CPU.

use anyhow::{Result, ensure};
use candle_core::{DType, Device, Tensor};
use libtest_mimic::{Failed, Trial};
use tid3r_models::{
    ComputeType,
    nn::{Memory, attention_by_group, causal_attention},
};

use super::wave;
use crate::case::device;

/// Channels of a head: those that there is a kernel for, and fewer.
const DIMS: [usize; 7] = [8, 16, 32, 40, 64, 72, 80];

/// Tokens and what they attend to.
struct Task {
    batch: usize,
    heads: usize,
    queries: usize,
    /// Tokens of each memory; of every second one, the same for the whole batch.
    keys: &'static [usize],
    /// Of tokens, which attend to all memories but that of their index, if there are several.
    groups: usize,
    causal: bool,
    /// The largest number in queries and keys.
    size: f32,
}

/// Of one token to many, in more blocks than the largest GPU has multiprocessors; of parts of a tile, whole ones and more.
const TASKS: [Task; 8] = [
    Task::of(1, 1, 1, &[1]),
    Task::of(2, 3, 65, &[63]),
    Task::of(1, 2, 130, &[64, 64]),
    Task::of(2, 2, 70, &[3, 1, 64, 100, 2]),
    Task::of(3, 16, 1100, &[70]),
    Task {
        groups: 3,
        ..Task::of(2, 2, 66, &[49, 17, 130])
    },
    Task {
        causal: true,
        ..Task::of(2, 2, 197, &[197])
    },
    Task {
        size: 20.0,
        ..Task::of(1, 2, 40, &[300])
    },
];

/// A test for each type and number of channels.
pub(super) fn trials() -> Vec<Trial> {
    let types = ComputeType::ALL
        .iter()
        .filter(|&&of| of != ComputeType::F32);
    let trial = |(&compute_type, dim): (&ComputeType, usize)| {
        let run = move || -> Result<()> {
            TASKS
                .iter()
                .try_for_each(|task| task.check(dim, compute_type))
        };
        let run = move || run().map_err(|error| Failed::from(format!("{error:#}")));
        Trial::test(format!("attention/{dim}/{compute_type}"), run)
    };
    types
        .flat_map(|of| DIMS.map(|dim| (of, dim)))
        .map(trial)
        .collect()
}

impl Task {
    const fn of(batch: usize, heads: usize, queries: usize, keys: &'static [usize]) -> Self {
        Self {
            batch,
            heads,
            queries,
            keys,
            groups: 1,
            causal: false,
            size: 2.0,
        }
    }

    /// Computes it both ways, with heads of `dim` channels.
    fn check(&self, dim: usize, compute_type: ComputeType) -> Result<()> {
        let dtype: DType = compute_type.name().parse()?;
        // All that the kernel rounds are the weights, which are up to 1.
        let bound = match dtype {
            DType::BF16 => 4e-3,
            _ => 6e-4,
        };
        let channels = self.heads * dim;
        let mut made = 0;
        // Tokens that do not fill their rows, in numbers of this type; every third time, they begin where the kernel
        // cannot read.
        let mut tokens = |batch: usize, count: usize, size: f32| {
            made += 1;
            let wide = channels + 16;
            let number = |i: usize| size * wave(i + made * 1_000_003);
            let numbers = (0..batch * count * wide).map(number).collect();
            let all = Tensor::from_vec(numbers, (batch, count, wide), &Device::Cpu)?;
            let start = if made % 3 == 0 { 3 } else { 8 };
            let of = |device: &Device| {
                all.to_device(device)?
                    .to_dtype(dtype)?
                    .narrow(2, start, channels)
            };
            anyhow::Ok([of(&Device::Cpu)?.to_dtype(DType::F32)?, of(device()?)?])
        };
        let [q, on_gpu] = tokens(self.groups * self.batch, self.queries, self.size)?;
        let on_gpu = on_gpu.to_dtype(DType::F32)?;
        let (mut memories, mut memories_on_gpu) = (Vec::new(), Vec::new());
        for (i, &count) in self.keys.iter().enumerate() {
            let batch = if i % 2 == 0 { self.batch } else { 1 };
            let [k, k_on_gpu] = tokens(batch, count, self.size)?;
            let [v, v_on_gpu] = tokens(batch, count, 1.0)?;
            memories.push(Memory { k, v });
            memories_on_gpu.push(Memory {
                k: k_on_gpu,
                v: v_on_gpu,
            });
        }
        let attend = |q: &Tensor, memories: &[Memory], compute_type| match (self.causal, memories) {
            (true, [Memory { k, v }]) => causal_attention(q, k, v, self.heads, compute_type),
            _ => attention_by_group(q, &self.grouped(memories), self.heads, compute_type),
        };
        let want = attend(&q, &memories, ComputeType::F32)?;
        let got = attend(&on_gpu, &memories_on_gpu, compute_type)?.to_device(&Device::Cpu)?;
        ensure!(got.dims() == want.dims(), "{got:?} is not {want:?}");
        let flat = |x: &Tensor| x.flatten_all()?.to_vec1::<f32>();
        let (got, want) = (flat(&got)?, flat(&want)?);
        for (i, (got, want)) in got.iter().zip(&want).enumerate() {
            let what = format!(
                "number {i} of {} queries, keys {:?}",
                self.queries, self.keys
            );
            ensure!((got - want).abs() <= bound, "{what}: {got}, not {want}");
        }
        Ok(())
    }

    /// What each group attends to.
    fn grouped(&self, memories: &[Memory]) -> Vec<Vec<Memory>> {
        let of_group = |group: usize| {
            let others = memories.iter().enumerate();
            let others = others.filter(|&(i, _)| self.groups == 1 || i != group);
            others.map(|(_, memory)| memory.clone()).collect()
        };
        (0..self.groups).map(of_group).collect()
    }
}
