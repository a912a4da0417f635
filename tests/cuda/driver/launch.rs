//! A kernel's run: its blocks on the machine's cores, its warps one after the other.

use crate::memory::{self, Range};
use crate::program::Program;
use crate::registers::{ALL, LANES, Mask};
use crate::warp::{Block, Fault, State, Warp};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The largest grid and block, as x, y and z.
pub(crate) const GRID: [u32; 3] = [i32::MAX as u32, 65535, 65535];
pub(crate) const BLOCK: [u32; 3] = [1024, 1024, 64];
/// Threads in a block.
pub(crate) const THREADS: u32 = 1024;
/// Bytes of shared memory in a block: what all kernels may have, and what those may have that ask for it. GPUs of
/// some generations have more.
pub(crate) const SHARED: usize = 48 << 10;
pub(crate) const SHARED_ASKED: usize = 99 << 10;

pub(crate) struct Launch<'a> {
    pub(crate) program: &'a Program,
    pub(crate) grid: [u32; 3],
    pub(crate) block: [u32; 3],
    /// Bytes of shared memory beyond what the kernel has.
    pub(crate) dynamic: usize,
    /// Bytes of that which the kernel has asked for.
    pub(crate) asked: usize,
    pub(crate) parameters: Vec<u8>,
    /// Of the order in which warps run; 0 is from the first to the last.
    pub(crate) seed: u64,
}

impl Launch<'_> {
    fn threads(&self) -> u32 {
        self.block.iter().product()
    }

    /// Why a GPU would not run it.
    pub(crate) fn refusal(&self) -> Option<String> {
        let beyond = |size: [u32; 3], limit: [u32; 3]| {
            (0..3).any(|axis| size[axis] == 0 || size[axis] > limit[axis])
        };
        if beyond(self.grid, GRID) || beyond(self.block, BLOCK) {
            return Some(format!(
                "a grid of {:?} blocks of {:?} threads",
                self.grid, self.block
            ));
        }
        let limit = self.program.threads.unwrap_or(THREADS).min(THREADS);
        if self.threads() > limit {
            return Some(format!(
                "{} threads in a block, which may have {limit}",
                self.threads()
            ));
        }
        let shared = self.program.shared + self.dynamic;
        let limit = SHARED.max(self.program.shared + self.asked);
        (shared > limit).then(|| format!("{shared} bytes of shared memory, of {limit}"))
    }

    pub(crate) fn run(&self) -> Result<(), String> {
        let ranges = memory::ranges();
        let blocks: u64 = self.grid.iter().map(|&size| u64::from(size)).product();
        let (next, failed) = (AtomicU64::new(0), AtomicBool::new(false));
        let problem = Mutex::new(None);
        let work = || {
            if let Err(what) = self.work(&ranges, blocks, &next, &failed) {
                failed.store(true, Ordering::Relaxed);
                problem
                    .lock()
                    .expect("no thread panics")
                    .get_or_insert(what);
            }
        };
        let cores = std::thread::available_parallelism()
            .map_or(1, usize::from)
            .min(blocks as usize);
        std::thread::scope(|scope| {
            (1..cores).for_each(|_| drop(scope.spawn(work)));
            work();
        });
        let problem = problem.into_inner().expect("no thread panics");
        problem.map_or(Ok(()), Err)
    }

    /// Runs blocks until there are none.
    fn work(
        &self,
        ranges: &[Range],
        blocks: u64,
        next: &AtomicU64,
        failed: &AtomicBool,
    ) -> Result<(), String> {
        let program = self.program;
        let count = self.threads().div_ceil(LANES as u32) as usize;
        // Warps that never wait can have the same registers, one after the other.
        let kept = if program.has_barriers { count } else { 1 };
        let mut warps: Vec<Warp> = (0..kept).map(|_| self.warp()).collect();
        let mut shared = vec![0_u64; (program.shared + self.dynamic).div_ceil(8)];
        let (_, shared, _) = unsafe { shared.align_to_mut::<u8>() };
        let mut block = Block {
            program,
            parameters: &self.parameters,
            ranges,
            shared: &mut shared[..program.shared + self.dynamic],
            used: vec![Range::default(); program.steps.len()],
        };
        while !failed.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= blocks {
                break;
            }
            let [width, height, _] = self.grid.map(u64::from);
            let at = [
                index % width,
                index / width % height,
                index / (width * height),
            ]
            .map(|at| at as u32);
            self.run_block(&mut block, &mut warps, count, at, index)?;
        }
        Ok(())
    }

    fn run_block(
        &self,
        block: &mut Block,
        warps: &mut [Warp],
        count: usize,
        at: [u32; 3],
        index: u64,
    ) -> Result<(), String> {
        // What a block has not written is no number.
        block.shared.fill(0xff);
        let mut states = vec![State::Ready; count];
        let mut order: Vec<usize> = (0..count).collect();
        for round in 0.. {
            if self.seed != 0 {
                shuffle(&mut order, self.seed ^ index << 20 ^ round << 52);
            }
            for &number in &order {
                let warp = if warps.len() == count {
                    &mut warps[number]
                } else {
                    &mut warps[0]
                };
                if round == 0 {
                    self.start(warp, at, number);
                }
                if states[number] == State::Ready {
                    states[number] = warp
                        .run(block)
                        .map_err(|fault| self.message(&fault, at, number))?;
                }
            }
            if states.iter().all(|state| *state == State::Done) {
                break;
            }
            self.pass_barriers(warps, &mut states)
                .map_err(|(fault, number)| self.message(&fault, at, number))?;
        }
        Ok(())
    }

    /// A warp with what is the same in all blocks.
    fn warp(&self) -> Warp {
        let mut warp = Warp::new(self.program);
        let axes = ["x", "y", "z"]
            .into_iter()
            .zip(self.block.into_iter().zip(self.grid));
        for (axis, (block, grid)) in axes {
            warp.set_special(&format!("%ntid.{axis}"), [block; LANES]);
            warp.set_special(&format!("%nctaid.{axis}"), [grid; LANES]);
        }
        let lane: [u32; LANES] = std::array::from_fn(|lane| lane as u32);
        warp.set_special("%laneid", lane);
        warp.set_special("%nwarpid", [self.threads().div_ceil(LANES as u32); LANES]);
        warp.set_special("%lanemask_eq", lane.map(|lane| 1 << lane));
        warp.set_special("%lanemask_le", lane.map(|lane| ALL >> (31 - lane)));
        warp.set_special("%lanemask_lt", lane.map(|lane| (1 << lane) - 1));
        warp.set_special("%lanemask_ge", lane.map(|lane| ALL << lane));
        warp.set_special("%lanemask_gt", lane.map(|lane| ALL << lane << 1));
        warp.set_special("%dynamic_smem_size", [self.dynamic as u32; LANES]);
        warp
    }

    fn start(&self, warp: &mut Warp, at: [u32; 3], number: usize) {
        let threads = self.threads();
        let first = (number * LANES) as u32;
        let ids: [u32; LANES] = std::array::from_fn(|lane| first + lane as u32);
        let [width, height, _] = self.block;
        warp.set_special("%tid.x", ids.map(|id| id % width));
        warp.set_special("%tid.y", ids.map(|id| id / width % height));
        warp.set_special("%tid.z", ids.map(|id| id / (width * height)));
        warp.set_special("%ctaid.x", [at[0]; LANES]);
        warp.set_special("%ctaid.y", [at[1]; LANES]);
        warp.set_special("%ctaid.z", [at[2]; LANES]);
        warp.set_special("%warpid", [number as u32; LANES]);
        let left = threads - first;
        let live: Mask = if left >= LANES as u32 {
            ALL
        } else {
            (1 << left) - 1
        };
        warp.start(live);
    }

    /// Warps go on where all threads of a barrier have come; a barrier that is not reached by all is a mistake, which
    /// is found when no warp can go on.
    fn pass_barriers(&self, warps: &[Warp], states: &mut [State]) -> Result<(), (Fault, usize)> {
        let mut passed = false;
        for barrier in 0..16 {
            let is_here = |state: &State| matches!(state, State::Waiting { number, .. } if *number == barrier);
            let here: Vec<usize> = (0..states.len())
                .filter(|&warp| is_here(&states[warp]))
                .collect();
            let Some(State::Waiting { threads, .. }) = here.first().map(|&warp| states[warp])
            else {
                continue;
            };
            let come: u32 = here.iter().map(|&warp| warps[warp].live.count_ones()).sum();
            if come == threads.unwrap_or(self.threads()) {
                here.iter().for_each(|&warp| states[warp] = State::Ready);
                passed = true;
            }
        }
        if passed {
            return Ok(());
        }
        let waiting = states
            .iter()
            .enumerate()
            .find_map(|(warp, state)| match *state {
                State::Waiting { line, .. } => Some((warp, line)),
                _ => None,
            });
        let (warp, line) = waiting.unwrap_or_default();
        let what = "waits at a barrier that not all threads of the block reach".to_string();
        Err((
            Fault {
                what,
                line,
                lane: warps[warp].live.trailing_zeros() as usize,
            },
            warp,
        ))
    }

    fn message(&self, fault: &Fault, block: [u32; 3], warp: usize) -> String {
        let thread = (warp * LANES + fault.lane) as u32;
        let [width, height, _] = self.block;
        let thread = [
            thread % width,
            thread / width % height,
            thread / (width * height),
        ];
        let text = self
            .program
            .lines
            .get(fault.line as usize - 1)
            .map_or("", |line| line.trim());
        let Fault { what, line, .. } = fault;
        format!(
            "kernel {}, block {block:?}, thread {thread:?}: {what}, in line {line}: {text}",
            self.program.name
        )
    }
}

/// The next of a row of numbers that look random (SplitMix64).
pub(crate) fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut bits = *state;
    bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ bits >> 31
}

fn shuffle(order: &mut [usize], mut seed: u64) {
    for last in (1..order.len()).rev() {
        order.swap(last, (random(&mut seed) % (last as u64 + 1)) as usize);
    }
}
