//! A kernel as it is run: steps on registers that have places.

use crate::registers::{Lane, Mask, Registers};
use crate::syntax::Space;

/// A kernel.
pub(crate) struct Program {
    pub(crate) name: String,
    pub(crate) steps: Vec<Step>,
    /// How many registers of 32 bits a warp has.
    pub(crate) registers: u32,
    pub(crate) constants: Vec<Constant>,
    pub(crate) parameters: Vec<Parameter>,
    /// Bytes of shared memory that every block has, and of a thread's own memory.
    pub(crate) shared: usize,
    pub(crate) local: usize,
    /// The most threads in a block, if the kernel says.
    pub(crate) threads: Option<u32>,
    /// Whether warps wait for each other.
    pub(crate) has_barriers: bool,
    /// The lines of the PTX.
    pub(crate) lines: Vec<&'static str>,
}

/// What a register holds from the start.
#[derive(Clone, Copy)]
pub(crate) struct Constant {
    pub(crate) register: Place,
    pub(crate) value: u64,
}

#[derive(Clone, Copy)]
pub(crate) struct Parameter {
    pub(crate) offset: usize,
    pub(crate) bytes: usize,
}

pub(crate) struct Step {
    pub(crate) op: Op,
    /// A predicate's register, and whether it has to be false.
    pub(crate) guard: Option<(u32, bool)>,
    /// The line of the PTX, from 1.
    pub(crate) line: u32,
}

/// A register: of 64 bits, if it is wide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Place {
    pub(crate) slot: u32,
    pub(crate) wide: bool,
}

/// Registers that are there in every kernel, by name; each takes one slot, from 0.
pub(crate) const SPECIAL: [&str; 21] = [
    "%tid.x",
    "%tid.y",
    "%tid.z",
    "%ntid.x",
    "%ntid.y",
    "%ntid.z",
    "%ctaid.x",
    "%ctaid.y",
    "%ctaid.z",
    "%nctaid.x",
    "%nctaid.y",
    "%nctaid.z",
    "%laneid",
    "%warpid",
    "%nwarpid",
    "%lanemask_eq",
    "%lanemask_le",
    "%lanemask_lt",
    "%lanemask_ge",
    "%lanemask_gt",
    "%dynamic_smem_size",
];

/// The carry of additions, after those.
pub(crate) const CARRY: u32 = SPECIAL.len() as u32;

pub(crate) type Compute = Box<dyn Fn(&mut Registers, Mask) + Send + Sync>;
pub(crate) type ComputeTogether =
    Box<dyn Fn(&mut Registers, Mask) -> Result<(), String> + Send + Sync>;
/// What is in memory becomes what, given two operands.
pub(crate) type Change = Box<dyn Fn(u64, u64, u64) -> u64 + Send + Sync>;

pub(crate) enum Op {
    Compute(Compute),
    /// What threads do together: those of the mask in a register, or else all of the warp.
    Together {
        members: Option<u32>,
        run: ComputeTogether,
    },
    Load(Access),
    Store(Access),
    Atomic {
        at: Access,
        operands: [Option<Place>; 2],
        change: Change,
    },
    /// 8 x 8 numbers of 16 bits for each register.
    LoadMatrices {
        at: Access,
        transposed: bool,
    },
    CopyLater {
        to: Access,
        from: Access,
        given: Option<u32>,
    },
    CommitCopies,
    /// Until no more than this many groups of copies are left; None is for all copies, in groups or not.
    WaitForCopies(Option<usize>),
    Jump(u32),
    /// To the place with this number.
    JumpTo {
        number: u32,
        places: Vec<u32>,
    },
    /// A barrier's number, and how many threads it waits for, if not for all.
    Barrier {
        number: u32,
        threads: Option<u32>,
    },
    Exit,
    Nothing,
    Trap,
    Unknown,
}

/// Memory that registers are loaded from or stored to.
pub(crate) struct Access {
    pub(crate) space: Space,
    pub(crate) address: Place,
    pub(crate) offset: i64,
    /// Of one register's number.
    pub(crate) bytes: usize,
    pub(crate) signed: bool,
    pub(crate) registers: Vec<Place>,
}

/// Whether `T` lies in registers of 64 bits.
pub(crate) const fn is_wide<T: Lane>() -> bool {
    size_of::<T::Word>() == 8
}
