//! Products of matrices, in f32 or f64, on all cores.

use crate::memory;
use crate::number::{Bf16, F16, Half};
use std::ffi::c_uint;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rows and columns that are summed in registers.
const ROWS: usize = 6;
const COLUMNS: usize = 32;
/// Rows and columns of a part of the result that one thread makes, and the factors for it that are laid out at a time.
const PART_ROWS: usize = 120;
const PART_COLUMNS: usize = 256;
const PART_DEPTH: usize = 256;

/// What sums are.
pub(crate) trait Sum: Copy + Default + Send + Sync {
    fn of_f32(x: f32) -> Self;
    fn of_f64(x: f64) -> Self;
    fn value(self) -> f64;
    fn add_product(self, a: Self, b: Self) -> Self;
}

macro_rules! sums {
    ($($type:ty),*) => {
        $(impl Sum for $type {
            fn of_f32(x: f32) -> Self {
                x as $type
            }
            fn of_f64(x: f64) -> Self {
                x as $type
            }
            fn value(self) -> f64 {
                self as f64
            }
            fn add_product(self, a: Self, b: Self) -> Self {
                a.mul_add(b, self)
            }
        })*
    };
}

sums!(f32, f64);

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    F32,
    F64,
    F16,
    Bf16,
}

impl Kind {
    /// By CUDA's number.
    pub(crate) fn of(number: c_uint) -> Option<Self> {
        Some(match number {
            0 => Self::F32,
            1 => Self::F64,
            2 => Self::F16,
            14 => Self::Bf16,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
            Self::F16 | Self::Bf16 => 2,
        }
    }

    /// The number at an index. Addresses were looked at before.
    fn read<S: Sum>(self, address: u64, index: usize) -> S {
        unsafe {
            match self {
                Self::F32 => S::of_f32((address as *const f32).add(index).read()),
                Self::F64 => S::of_f64((address as *const f64).add(index).read()),
                Self::F16 => S::of_f32(F16((address as *const u16).add(index).read()).value()),
                Self::Bf16 => S::of_f32(Bf16((address as *const u16).add(index).read()).value()),
            }
        }
    }

    fn write<S: Sum>(self, address: u64, index: usize, value: S) {
        unsafe {
            match self {
                Self::F32 => (address as *mut f32).add(index).write(value.value() as f32),
                Self::F64 => (address as *mut f64).add(index).write(value.value()),
                Self::F16 => (address as *mut u16)
                    .add(index)
                    .write(F16::near(value.value() as f32).0),
                Self::Bf16 => (address as *mut u16)
                    .add(index)
                    .write(Bf16::near(value.value() as f32).0),
            }
        }
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Matrices {
    pub(crate) address: u64,
    pub(crate) kind: Kind,
    /// Numbers from one column to the next, and from one matrix to the next.
    pub(crate) leading: usize,
    pub(crate) stride: usize,
    pub(crate) transposed: bool,
}

impl Matrices {
    fn index(&self, batch: usize, row: usize, column: usize) -> usize {
        let (row, column) = if self.transposed {
            (column, row)
        } else {
            (row, column)
        };
        batch * self.stride + column * self.leading + row
    }

    /// Whether this many of them are the GPU's memory, and columns do not overlap.
    fn are_there(&self, count: usize, rows: usize, columns: usize) -> bool {
        let (rows, columns) = if self.transposed {
            (columns, rows)
        } else {
            (rows, columns)
        };
        if count * rows * columns == 0 {
            return true;
        }
        let last = (count - 1) * self.stride + (columns - 1) * self.leading + rows;
        self.leading >= rows && memory::contains(self.address, last * self.kind.bytes())
    }
}

/// What factors of f32 are rounded to.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rounded {
    No,
    F16,
    Bf16,
    Tf32,
}

impl Rounded {
    fn round<S: Sum>(self, x: S) -> S {
        let near = x.value() as f32;
        match self {
            Self::No => x,
            Self::F16 => S::of_f32(F16::near(near).value()),
            Self::Bf16 => S::of_f32(Bf16::near(near).value()),
            Self::Tf32 => S::of_f32(f32::from_bits(
                near.to_bits().wrapping_add(0x1000) & !0x1fff,
            )),
        }
    }
}

pub(crate) struct Product {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) depth: usize,
    pub(crate) count: usize,
    pub(crate) a: Matrices,
    pub(crate) b: Matrices,
    pub(crate) c: Matrices,
    pub(crate) alpha: f64,
    pub(crate) beta: f64,
    pub(crate) rounded: Rounded,
}

impl Product {
    /// Whether all matrices are there.
    pub(crate) fn run<S: Sum>(&self) -> bool {
        let Self {
            rows,
            columns,
            depth,
            count,
            ..
        } = *self;
        let are_there = self.a.are_there(count, rows, depth)
            && self.b.are_there(count, depth, columns)
            && self.c.are_there(count, rows, columns);
        if !are_there {
            return false;
        }
        let (high, wide) = (rows.div_ceil(PART_ROWS), columns.div_ceil(PART_COLUMNS));
        let parts = count * high * wide;
        let next = AtomicUsize::new(0);
        let work = || {
            let mut room = Room::default();
            loop {
                let part = next.fetch_add(1, Ordering::Relaxed);
                if part >= parts {
                    break;
                }
                let at = (
                    part / (high * wide),
                    part % high * PART_ROWS,
                    part / high % wide * PART_COLUMNS,
                );
                self.part::<S>(at, &mut room);
            }
        };
        let cores = std::thread::available_parallelism()
            .map_or(1, usize::from)
            .min(parts);
        // What is small is done before a thread has begun.
        let cores = if rows * columns * depth * count < 1 << 16 {
            1
        } else {
            cores
        };
        std::thread::scope(|scope| {
            (1..cores).for_each(|_| drop(scope.spawn(work)));
            work();
        });
        true
    }

    /// A part of one matrix, from a row and a column on.
    fn part<S: Sum>(&self, (batch, row, column): (usize, usize, usize), room: &mut Room<S>) {
        let rows = PART_ROWS.min(self.rows - row);
        let columns = PART_COLUMNS.min(self.columns - column);
        let (high, wide) = (rows.div_ceil(ROWS), columns.div_ceil(COLUMNS));
        room.sums.clear();
        room.sums
            .resize(high * wide, [[S::default(); COLUMNS]; ROWS]);
        for from in (0..self.depth).step_by(PART_DEPTH) {
            let depth = PART_DEPTH.min(self.depth - from);
            let round = self.rounded;
            let get = |matrices: &Matrices, row, column| {
                round.round(
                    matrices
                        .kind
                        .read::<S>(matrices.address, matrices.index(batch, row, column)),
                )
            };
            room.a.clear();
            room.a.resize(high * ROWS * depth, S::default());
            for (i, depth_of) in (0..rows).flat_map(|i| (0..depth).map(move |p| (i, p))) {
                room.a[(i / ROWS * depth + depth_of) * ROWS + i % ROWS] =
                    get(&self.a, row + i, from + depth_of);
            }
            room.b.clear();
            room.b.resize(wide * COLUMNS * depth, S::default());
            for (j, depth_of) in (0..columns).flat_map(|j| (0..depth).map(move |p| (j, p))) {
                room.b[(j / COLUMNS * depth + depth_of) * COLUMNS + j % COLUMNS] =
                    get(&self.b, from + depth_of, column + j);
            }
            for (j, b) in room.b.chunks_exact(depth * COLUMNS).enumerate() {
                for (i, a) in room.a.chunks_exact(depth * ROWS).enumerate() {
                    add_products(a, b, &mut room.sums[j * high + i]);
                }
            }
        }
        let c = self.c;
        for j in 0..columns {
            for i in 0..rows {
                let sum = room.sums[j / COLUMNS * high + i / ROWS][i % ROWS][j % COLUMNS];
                let index = c.index(batch, row + i, column + j);
                let mut value = sum.value() * self.alpha;
                if self.beta != 0.0 {
                    value += self.beta * c.kind.read::<S>(c.address, index).value();
                }
                c.kind.write(c.address, index, S::of_f64(value));
            }
        }
    }
}

/// Where a thread lays out what it multiplies.
#[derive(Default)]
struct Room<S> {
    a: Vec<S>,
    b: Vec<S>,
    sums: Vec<[[S; COLUMNS]; ROWS]>,
}

fn add_products<S: Sum>(a: &[S], b: &[S], sums: &mut [[S; COLUMNS]; ROWS]) {
    let mut all = *sums;
    for (a, b) in a.chunks_exact(ROWS).zip(b.chunks_exact(COLUMNS)) {
        for i in 0..ROWS {
            for j in 0..COLUMNS {
                all[i][j] = all[i][j].add_product(a[i], b[j]);
            }
        }
    }
    *sums = all;
}
