//! A warp of threads that run a kernel: all that are at the same step run it at once.
//!
//! Threads that are furthest behind go first, so that those that took different ways meet again. Where threads have to
//! be together, they wait for each other.

use crate::access::{Copies, exchange};
use crate::memory::Range;
use crate::program::{Op, Place, Program, SPECIAL};
use crate::registers::{ALL, LANES, Mask, Registers};

/// Which memory an address is of: the GPU's, or one of these.
pub(crate) const REGION: u64 = 3 << 60;
pub(crate) const SHARED: u64 = 1 << 60;
pub(crate) const LOCAL: u64 = 2 << 60;

/// What must not happen.
pub(crate) struct Fault {
    pub(crate) what: String,
    pub(crate) line: u32,
    /// The thread of the warp.
    pub(crate) lane: usize,
}

/// What must not happen, and the thread of the warp, if it is of one.
pub(crate) type Mistake = (String, Option<usize>);

/// What the threads of a block share.
pub(crate) struct Block<'a> {
    pub(crate) program: &'a Program,
    pub(crate) parameters: &'a [u8],
    pub(crate) ranges: &'a [Range],
    pub(crate) shared: &'a mut [u8],
    /// For each step, the allocation that it used last.
    pub(crate) used: Vec<Range>,
}

/// Where a warp is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    Ready,
    /// A barrier, how many threads it waits for, and its line.
    Waiting {
        number: u32,
        threads: Option<u32>,
        line: u32,
    },
    Done,
}

pub(crate) struct Warp {
    pub(crate) registers: Registers,
    /// Threads that are at the same step, those behind first.
    groups: Vec<Group>,
    /// Threads that have not ended.
    pub(crate) live: Mask,
    pub(crate) local: Vec<u64>,
    pub(crate) copies: Vec<Copies>,
}

#[derive(Clone, Copy)]
struct Group {
    at: u32,
    mask: Mask,
    /// For other threads.
    waits: bool,
}

/// The threads of a mask.
pub(crate) fn lanes(mask: Mask) -> impl Iterator<Item = usize> {
    (0..LANES).filter(move |lane| mask >> lane & 1 == 1)
}

impl Warp {
    pub(crate) fn new(program: &Program) -> Self {
        let mut registers = Registers::new(program.registers);
        for constant in &program.constants {
            match constant.register {
                Place { slot, wide: true } => registers.fill(slot, constant.value),
                Place { slot, wide: false } => registers.fill(slot, constant.value as u32),
            }
        }
        let is_copy = |op: &Op| {
            matches!(
                op,
                Op::CopyLater { .. } | Op::CommitCopies | Op::WaitForCopies(_)
            )
        };
        let has_copies = program.steps.iter().any(|step| is_copy(&step.op));
        Self {
            registers,
            groups: Vec::new(),
            live: 0,
            local: vec![u64::MAX; LANES * program.local.div_ceil(8)],
            copies: (0..if has_copies { LANES } else { 0 })
                .map(|_| Copies::default())
                .collect(),
        }
    }

    /// Sets a register that every kernel has.
    pub(crate) fn set_special(&mut self, name: &str, values: [u32; LANES]) {
        let slot = SPECIAL.iter().position(|&special| special == name);
        self.registers
            .set(slot.expect("it is one of them") as u32, &values, ALL);
    }

    /// These threads are at the first step.
    pub(crate) fn start(&mut self, threads: Mask) {
        self.live = threads;
        self.groups.clear();
        self.insert(Group {
            at: 0,
            mask: threads,
            waits: false,
        });
        // Copies that nobody has waited for end with the block.
        self.copies.iter_mut().for_each(Copies::clear);
    }

    /// Until all threads have ended or wait for other warps.
    pub(crate) fn run(&mut self, block: &mut Block) -> Result<State, Fault> {
        loop {
            let Some(index) = self.groups.iter().position(|group| !group.waits) else {
                let Some(group) = self.groups.first() else {
                    return Ok(State::Done);
                };
                return Err(Fault {
                    what: format!(
                        "waits for threads that never come: {:032b}, of {:032b}, are here",
                        group.mask, self.live
                    ),
                    line: block.program.steps[group.at as usize].line,
                    lane: group.mask.trailing_zeros() as usize,
                });
            };
            let mut group = self.groups.remove(index);
            let limit = self.groups.get(index).map_or(u32::MAX, |next| next.at);
            let state = self.run_group(block, &mut group, limit);
            let state = state.map_err(|(what, lane)| Fault {
                what,
                line: block.program.steps[group.at as usize].line,
                lane: lane.unwrap_or(group.mask.trailing_zeros() as usize),
            })?;
            if group.mask != 0 {
                self.insert(group);
            }
            if state != State::Ready {
                return Ok(state);
            }
        }
    }

    fn insert(&mut self, group: Group) {
        match self
            .groups
            .binary_search_by_key(&group.at, |group| group.at)
        {
            Ok(at) => {
                self.groups[at].mask |= group.mask;
                self.groups[at].waits = false;
            }
            Err(at) => self.groups.insert(at, group),
        }
    }

    /// Until the threads part, meet others at `limit`, wait or end. A mistake comes with the thread, if it is of one.
    fn run_group(
        &mut self,
        block: &mut Block,
        group: &mut Group,
        limit: u32,
    ) -> Result<State, Mistake> {
        let program = block.program;
        let is_alone = self.groups.is_empty();
        while group.at < limit {
            let step = &program.steps[group.at as usize];
            let mask = match step.guard {
                None => group.mask,
                Some((slot, negate)) => {
                    group.mask & (self.registers.predicate(slot) ^ if negate { ALL } else { 0 })
                }
            };
            if mask == 0 {
                group.at += 1;
                continue;
            }
            // What all must reach before any goes on.
            let needed = match &step.op {
                Op::Together {
                    members: Some(members),
                    ..
                } => {
                    let first = mask.trailing_zeros() as usize;
                    let members = self.registers.words::<u32>(*members)[first];
                    if mask & !members != 0 {
                        return Err(("threads are here that its mask has not".into(), None));
                    }
                    members & self.live
                }
                Op::Together { .. } | Op::LoadMatrices { .. } | Op::Barrier { .. } => self.live,
                _ => 0,
            };
            if mask & needed != needed {
                group.waits = true;
                return Ok(State::Ready);
            }
            match &step.op {
                Op::Compute(run) => run(&mut self.registers, mask),
                Op::Together { run, .. } => {
                    run(&mut self.registers, mask).map_err(|what| (what, None))?
                }
                Op::Load(access) => self.load(block, access, mask, group.at)?,
                Op::Store(access) => self.store(block, access, mask, group.at)?,
                Op::Atomic {
                    at,
                    operands,
                    change,
                } => {
                    let addresses = self.addresses(block, at, mask, at.bytes, group.at)?;
                    let [b, c] =
                        operands.map(|place| place.map_or([0; LANES], |place| self.value(place)));
                    let mut old = [0; LANES];
                    for lane in lanes(mask) {
                        old[lane] = exchange(addresses[lane], at.bytes, |old| {
                            change(old, b[lane], c[lane])
                        });
                    }
                    if let Some(&place) = at.registers.first() {
                        self.set(place, &old, mask);
                    }
                }
                Op::LoadMatrices { at, transposed } => {
                    self.load_matrices(block, at, *transposed, mask, group.at)?
                }
                Op::CopyLater { to, from, given } => {
                    self.copy_later(block, to, from, *given, mask, group.at)?
                }
                Op::CommitCopies => {
                    for lane in lanes(mask) {
                        let copies = &mut self.copies[lane];
                        copies.groups.push_back(std::mem::take(&mut copies.open));
                    }
                }
                Op::WaitForCopies(left) => {
                    lanes(mask).for_each(|lane| self.copies[lane].wait(*left))
                }
                Op::Jump(to) => {
                    if mask == group.mask {
                        group.at = *to;
                        if is_alone {
                            continue;
                        }
                        return Ok(State::Ready);
                    }
                    group.mask &= !mask;
                    group.at += 1;
                    self.insert(Group {
                        at: *to,
                        mask,
                        waits: false,
                    });
                    return Ok(State::Ready);
                }
                Op::JumpTo { number, places } => {
                    let numbers = *self.registers.words::<u32>(*number);
                    group.mask &= !mask;
                    group.at += 1;
                    for lane in lanes(mask) {
                        let Some(&at) = places.get(numbers[lane] as usize) else {
                            return Err((
                                format!("there is no place {} to jump to", numbers[lane]),
                                Some(lane),
                            ));
                        };
                        self.insert(Group {
                            at,
                            mask: 1 << lane,
                            waits: false,
                        });
                    }
                    return Ok(State::Ready);
                }
                Op::Barrier { number, threads } => {
                    group.at += 1;
                    return Ok(State::Waiting {
                        number: self.registers.words::<u32>(*number)[0],
                        threads: threads.map(|threads| self.registers.words::<u32>(threads)[0]),
                        line: step.line,
                    });
                }
                Op::Exit => {
                    self.live &= !mask;
                    group.mask &= !mask;
                    // Others may have waited for these.
                    self.groups.iter_mut().for_each(|group| group.waits = false);
                    if group.mask == 0 {
                        return Ok(State::Ready);
                    }
                }
                Op::Nothing => {}
                Op::Trap => return Err(("the kernel gives up".into(), None)),
                Op::Unknown => return Err(("this instruction is not known".into(), None)),
            }
            group.at += 1;
        }
        Ok(State::Ready)
    }
}
