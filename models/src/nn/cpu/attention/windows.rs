//! Attention within windows of an image of tokens.
//!
//! Tokens are read and results written where they are in the image: a window is a list of pointers.

use std::ops::Range;

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::super::shared::{Shared, filled};
use super::super::{HostTensor, Isa};
use super::bias::{Bias, Relative};
use super::head::Head;
use super::{block_size, rows_whole};
use crate::nn::profile::{Operation, Timer};
use crate::nn::{Memory, ScoreBias};

/// [`crate::nn::window_attention()`] of f32 on the CPU, with a bias of the right shape.
///
/// # Errors
///
/// If tokens have other shapes than each other.
pub(in crate::nn) fn window_attention(
    isa: Isa,
    q: &Tensor,
    memory: &Memory,
    beyond: &Memory,
    size: [usize; 2],
    bias: &ScoreBias,
    pairs: bool,
) -> Result<Tensor> {
    let (batch, height, width, heads, dim) = q.dims5()?;
    if size.contains(&0) || dim == 0 {
        bail!("{dim} channels cannot attend within windows of {size:?} tokens");
    }
    let (image, single) = ([batch, height, width, heads, dim], [1, 1, 1, heads, dim]);
    let tensors = [
        rows_whole(q)?,
        rows_whole(&memory.k)?,
        rows_whole(&memory.v)?,
        rows_whole(&beyond.k.reshape(&single[..])?)?,
        rows_whole(&beyond.v.reshape(&single[..])?)?,
    ];
    let hosts = tensors.iter().map(HostTensor::new);
    let hosts = hosts.collect::<Result<Vec<_>>>()?;
    let tables = match bias {
        ScoreBias::None => Vec::new(),
        ScoreBias::Table(table) => vec![table.contiguous()?],
        ScoreBias::Relative { rows, columns } => vec![rows.contiguous()?, columns.contiguous()?],
    };
    let tables = tables.iter().map(HostTensor::new);
    let tables = tables.collect::<Result<Vec<_>>>()?;
    let windows = Windows {
        q: Field::new(&hosts[0], image)?,
        memory: [Field::new(&hosts[1], image)?, Field::new(&hosts[2], image)?],
        beyond: [
            Field::new(&hosts[3], single)?,
            Field::new(&hosts[4], single)?,
        ],
        image: [height, width],
        size,
        dim,
        bias: Biases::new(&tables)?,
    };
    let grid = [height.div_ceil(size[0]), width.div_ceil(size[1])];
    let groups = batch * grid[0] * grid[1] * heads;
    let most = size[0].min(height) * size[1].min(width);
    let at_once = block_size(most, groups);
    let blocks = most.div_ceil(at_once);
    let pairs_of_tokens = batch * height * width * heads * size[0] * size[1];
    let _timer = Timer::start(Operation::Attention, 2 * pairs_of_tokens * dim);
    // SAFETY: tasks write the channels of their head for all their queries; no two have the same.
    let values = unsafe {
        filled(batch * height * width * heads * dim, |values| {
            let out = Shared(values);
            (0..groups * blocks)
                .into_par_iter()
                .with_max_len(1)
                .for_each(|task| {
                    let (rest, block) = (task / blocks, task % blocks);
                    let (rest, head) = (rest / heads, rest % heads);
                    let (rest, column) = (rest / grid[1], rest % grid[1]);
                    let (item, row) = (rest / grid[0], rest % grid[0]);
                    let corner = [row * size[0], column * size[1]];
                    let queries = block * at_once..(block + 1) * at_once;
                    let result = |[y, x]: [usize; 2]| {
                        let token = (item * height + y) * width + x;
                        out.add((token * heads + head) * dim)
                    };
                    let head = windows.head(item, corner, head, queries, result);
                    head.attend(isa, pairs);
                });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, (batch, height, width, heads * dim), &Device::Cpu)
}

/// An image of tokens that is cut into windows.
struct Windows<'a> {
    q: Field<'a>,
    /// Keys and values.
    memory: [Field<'a>; 2],
    /// A token, in place of all that are in windows but not in the image.
    beyond: [Field<'a>; 2],
    /// Rows and columns of tokens.
    image: [usize; 2],
    /// Rows and columns of a window.
    size: [usize; 2],
    dim: usize,
    bias: Biases<'a>,
}

impl Windows<'_> {
    /// Some of the queries in the window whose first token is at `corner`, as far as there are any;
    /// `result` says where the result of the token at (y, x) goes.
    fn head(
        &self,
        item: usize,
        corner: [usize; 2],
        head: usize,
        queries: Range<usize>,
        result: impl Fn([usize; 2]) -> *mut f32,
    ) -> Head<'_> {
        let [rows, columns] = self.size;
        let [height, width] =
            [0, 1].map(|axis| self.size[axis].min(self.image[axis] - corner[axis]));
        let in_image = |[y, x]: [usize; 2]| [corner[0] + y, corner[1] + x];
        let places: Vec<[usize; 2]> = (queries.start..queries.end.min(height * width))
            .map(|i| [i / width, i % width])
            .collect();
        let tokens = places.iter().map(|&place| in_image(place));
        let token = |i: usize| {
            let place = [i / columns, i % columns];
            match place[0] < height && place[1] < width {
                true => (self.memory.each_ref()).map(|x| x.pointer(item, in_image(place), head)),
                false => self.beyond.each_ref().map(|x| x.pointer(0, [0, 0], head)),
            }
        };
        Head {
            q: tokens
                .clone()
                .map(|at| self.q.pointer(item, at, head))
                .collect(),
            memory: (0..rows * columns).map(token).collect(),
            dim: self.dim,
            out: tokens.map(result).collect(),
            bias: self.bias.of(head, places, self.size, self.dim),
        }
    }
}

/// Tokens (batch, height, width, heads, dim).
struct Field<'a> {
    data: &'a [f32],
    /// Of all dimensions but the last.
    strides: [usize; 4],
}

impl<'a> Field<'a> {
    fn new(tensor: &'a HostTensor<'_>, shape: [usize; 5]) -> Result<Self> {
        let (dims, data) = (tensor.dims(), tensor.data()?);
        let (&[batch, row, column, head, _], true) = (tensor.strides(), dims == shape) else {
            bail!("tokens {shape:?} are wanted, got {dims:?}");
        };
        let strides = [batch, row, column, head];
        let steps = strides.iter().zip(shape);
        let last: usize = steps.map(|(stride, n)| stride * n.saturating_sub(1)).sum();
        if !shape.contains(&0) && last + shape[4] > data.len() {
            bail!("tokens {dims:?} reach beyond their memory");
        }
        Ok(Self { data, strides })
    }

    /// Where the numbers of one head of a token are.
    fn pointer(&self, item: usize, [y, x]: [usize; 2], head: usize) -> *const f32 {
        let [of_item, of_row, of_column, of_head] = self.strides;
        let at = item * of_item + y * of_row + x * of_column + head * of_head;
        self.data.as_ptr().wrapping_add(at)
    }
}

/// What is added to the scores of all heads.
enum Biases<'a> {
    None,
    /// (heads, queries, keys) of a window.
    Table(&'a [f32]),
    /// For rows and for columns, (distances, dim).
    Relative([&'a [f32]; 2]),
}

impl<'a> Biases<'a> {
    /// Tables of the shapes that [`ScoreBias`] says.
    fn new(tables: &'a [HostTensor<'_>]) -> Result<Self> {
        let numbers = |table: &'a HostTensor<'_>| -> Result<&'a [f32]> {
            Ok(&table.data()?[..table.dims().iter().product()])
        };
        Ok(match tables {
            [] => Self::None,
            [table] => Self::Table(numbers(table)?),
            [rows, columns, ..] => Self::Relative([numbers(rows)?, numbers(columns)?]),
        })
    }

    /// What is added to the scores of the queries at `places` of a window.
    fn of(&self, head: usize, places: Vec<[usize; 2]>, size: [usize; 2], dim: usize) -> Bias<'a> {
        match *self {
            Self::None => Bias::None,
            Self::Table(table) => {
                let keys = size[0] * size[1];
                let row = |[y, x]: [usize; 2]| (head * keys + y * size[1] + x) * keys;
                let rows = places.into_iter().map(|place| &table[row(place)..][..keys]);
                Bias::Table(rows.collect())
            }
            Self::Relative(tables) => Bias::Relative(Relative::new(size, tables, dim, places)),
        }
    }
}
