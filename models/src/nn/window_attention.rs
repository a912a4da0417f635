//! Attention within windows of an image of tokens.

use candle_core::{Result, Tensor, bail};

use super::Memory;
use super::attention::softmax;
use super::cpu::{self, HostTensor, Isa};
use super::linear::product;
use crate::ComputeType;

/// What is added to the scores of attention within a window of `rows` x `columns` tokens, before the
/// softmax. Tokens of a window are numbered row by row.
#[derive(Clone, Debug)]
pub enum ScoreBias {
    /// Nothing.
    None,
    /// A number for each head, query and key: (heads, rows * columns, rows * columns). The same for
    /// all windows.
    Table(Tensor),
    /// What a query itself says of distances, in rows and in columns: with the key at (v, u), a query
    /// `q` at (y, x) has `q . rows[y - v + rows - 1] + q . columns[x - u + columns - 1]` added; the
    /// score itself is scaled, this is not (decomposed relative positions; Li et al. 2022, MViTv2).
    Relative {
        /// (2 * rows - 1, dim).
        rows: Tensor,
        /// (2 * columns - 1, dim).
        columns: Tensor,
    },
}

impl ScoreBias {
    /// # Errors
    ///
    /// If it is of other windows or heads.
    fn check(&self, [rows, columns]: [usize; 2], heads: usize, dim: usize) -> Result<()> {
        let check = |table: &Tensor, wanted: &[usize]| match table.dims() == wanted {
            true => Ok(()),
            false => bail!("a score bias {wanted:?} is wanted, got {:?}", table.shape()),
        };
        let (tokens, distances) = (rows * columns, |n: usize| (2 * n).saturating_sub(1));
        match self {
            Self::None => Ok(()),
            Self::Table(table) => check(table, &[heads, tokens, tokens]),
            Self::Relative {
                rows: of_rows,
                columns: of_columns,
            } => {
                check(of_rows, &[distances(rows), dim])?;
                check(of_columns, &[distances(columns), dim])
            }
        }
    }

    fn is_of_host(&self) -> bool {
        match self {
            Self::None => true,
            Self::Table(table) => HostTensor::fits(table),
            Self::Relative { rows, columns } => HostTensor::fits(rows) && HostTensor::fits(columns),
        }
    }
}

/// `softmax(q k^T / sqrt(dim) + bias) v` for each head, among the tokens of each window.
///
/// `q` and the tensors of `memory` are images of tokens, (batch, height, width, heads, dim), strided as
/// they like. An image is cut into windows of `window` (rows, columns) tokens, from its upper left
/// corner on; the last ones reach beyond it where `window` does not divide it. There, every token's key
/// and value are those of `beyond`, (heads, dim) each: they take part, as in the networks that pad
/// images with a constant. A window as large as the image is ordinary attention.
///
/// The result is (batch, height, width, heads * dim). Neither scores nor biases of all tokens are ever
/// in memory. What computing in 16 bits means is as for [`attention()`](super::attention()).
///
/// # Errors
///
/// If the shapes do not fit each other, or a window is empty.
pub fn window_attention(
    q: &Tensor,
    memory: &Memory,
    beyond: &Memory,
    window: [usize; 2],
    bias: &ScoreBias,
    compute_type: ComputeType,
) -> Result<Tensor> {
    let (_, _, _, heads, dim) = q.dims5()?;
    bias.check(window, heads, dim)?;
    let of_host = |memory: &Memory| HostTensor::fits(&memory.k) && HostTensor::fits(&memory.v);
    if HostTensor::fits(q) && of_host(memory) && of_host(beyond) && bias.is_of_host() {
        let isa = Isa::current()?;
        let pairs = compute_type.in_pairs(isa);
        cpu::window_attention(isa, q, memory, beyond, window, bias, pairs)
    } else {
        plain(q, memory, beyond, window, bias, compute_type)
    }
}

/// Attention within windows by candle's own operations.
pub(super) fn plain(
    q: &Tensor,
    memory: &Memory,
    beyond: &Memory,
    window: [usize; 2],
    bias: &ScoreBias,
    compute_type: ComputeType,
) -> Result<Tensor> {
    let (batch, height, width, heads, dim) = q.dims5()?;
    let [rows, columns] = window;
    if rows * columns == 0 {
        bail!("windows of {rows} x {columns} tokens are empty");
    }
    let (down, across) = (height.div_ceil(rows), width.div_ceil(columns));
    let windows = batch * down * across;
    // (batch, height, width, heads, dim) to (windows, heads, tokens, dim).
    let cut = |x: &Tensor, beyond: &Tensor| -> Result<Tensor> {
        let beyond = beyond.reshape((1, 1, 1, heads, dim))?;
        // Devices have no tensors of nothing.
        let filled = |x: Tensor, axis: usize, size: usize| match size - x.dim(axis)? {
            0 => Ok(x),
            more => {
                let mut shape = x.dims().to_vec();
                shape[axis] = more;
                Tensor::cat(&[&x, &beyond.broadcast_as(shape)?], axis)
            }
        };
        let x = filled(filled(x.clone(), 1, down * rows)?, 2, across * columns)?;
        x.reshape(&[batch, down, rows, across, columns, heads, dim][..])?
            .permute(vec![0, 1, 3, 5, 2, 4, 6])?
            .reshape((windows, heads, rows * columns, dim))
    };
    let (k, v) = (cut(&memory.k, &beyond.k)?, cut(&memory.v, &beyond.v)?);
    // The result of queries beyond the image is dropped.
    let q = cut(q, &beyond.k)?;
    let rounded = |x: &Tensor| x.to_dtype(compute_type.dtype());
    let (k, v) = (rounded(&k)?, rounded(&v)?);
    let scores = product(&(&q * (dim as f64).powf(-0.5))?, &k.t()?)?;
    let scores = match bias {
        ScoreBias::None => scores,
        ScoreBias::Table(table) => scores.broadcast_add(table)?,
        ScoreBias::Relative {
            rows: of_rows,
            columns: of_columns,
        } => {
            let shape = (windows * heads, rows, columns, dim);
            let q = q.reshape(shape)?;
            let (of_rows, of_columns) = (rounded(of_rows)?, rounded(of_columns)?);
            let by_row = said(&q.transpose(0, 1)?, &of_rows)?.transpose(0, 1)?;
            let by_column = said(&q.permute((2, 1, 0, 3))?, &of_columns)?.permute((2, 1, 0, 3))?;
            scores
                .reshape((windows * heads, rows, columns, rows, columns))?
                .broadcast_add(&by_row.unsqueeze(4)?)?
                .broadcast_add(&by_column.unsqueeze(3)?)?
                .reshape(scores.shape())?
        }
    };
    product(&softmax(&scores, 3)?, &v)?
        .reshape(&[batch, down, across, heads, rows, columns, dim][..])?
        .permute(vec![0, 1, 4, 2, 5, 3, 6])?
        .reshape((batch, down * rows, across * columns, heads * dim))?
        .narrow(1, 0, height)?
        .narrow(2, 0, width)?
        .contiguous()
}

/// What queries `q` (n, .., .., dim), in n places, say of their distances to n places by `table`
/// (2n - 1, dim): (n, .., .., n).
fn said(q: &Tensor, table: &Tensor) -> Result<Tensor> {
    let (n, a, b, dim) = q.dims4()?;
    let distances = |place: usize| (0..n).map(move |other| (place + n - 1 - other) as u32);
    let distances: Vec<u32> = (0..n).flat_map(distances).collect();
    let distances = Tensor::new(distances, q.device())?;
    let table = table.index_select(&distances, 0)?.reshape((n, n, dim))?;
    product(&q.reshape((n, a * b, dim))?, &table.t()?)?.reshape((n, a, b, n))
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn random(shape: &[usize]) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    /// Queries, keys and values side by side, as one layer makes them: (.., heads, 3, dim) or
    /// (.., 3, heads, dim).
    fn projected(shape: [usize; 5], by_head: bool) -> [Tensor; 3] {
        let [batch, height, width, heads, dim] = shape;
        let (wide, axis) = match by_head {
            true => ([batch, height, width, heads, 3, dim], 4),
            false => ([batch, height, width, 3, heads, dim], 3),
        };
        let all = random(&wide);
        [0, 1, 2].map(|i| all.narrow(axis, i, 1).unwrap().squeeze(axis).unwrap())
    }

    fn memory_of(k: Tensor, v: Tensor) -> Memory {
        Memory { k, v }
    }

    #[test]
    fn a_table_by_hand() {
        // Two tokens in a window that reaches to a third, one head of one channel. Queries are 0, so
        // weights are the softmax of the bias: ln 1, 2, 5 for the first query, ln 4, 2, 2 for the
        // second.
        let tensor = |values: &[f32]| Tensor::new(values, &Device::Cpu).unwrap();
        let image = |values: &[f32]| tensor(values).reshape((1, 1, 2, 1, 1)).unwrap();
        let memory = memory_of(image(&[3.0, -1.0]), image(&[8.0, 16.0]));
        let beyond = memory_of(
            tensor(&[7.0]).reshape((1, 1)).unwrap(),
            tensor(&[-8.0]).reshape((1, 1)).unwrap(),
        );
        let weights = [1.0, 2.0, 5.0, 4.0, 2.0, 2.0, 1.0, 1.0, 1.0];
        let table = tensor(&weights.map(f32::ln)).reshape((1, 3, 3)).unwrap();
        let q = image(&[0.0, 0.0]);
        let got = window_attention(
            &q,
            &memory,
            &beyond,
            [1, 3],
            &ScoreBias::Table(table),
            ComputeType::F32,
        )
        .unwrap();
        assert_eq!(got.dims(), [1, 1, 2, 1]);
        for (got, want) in flat(&got).iter().zip([0.0, 6.0]) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }

    #[test]
    fn relative_positions_by_hand() {
        // A column of two tokens with keys 0. The first query, 1, has rows[1] added for the first key
        // (distance 0), rows[0] for the second (distance -1), and columns[0] for both; the second, 2,
        // has twice rows[2] and twice rows[1]. Not divided by sqrt(dim) = 2.
        let tensor = |values: &[f32]| Tensor::new(values, &Device::Cpu).unwrap();
        let image = |a: f32, b: f32| {
            let values = [a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0];
            tensor(&values).reshape((1, 2, 1, 1, 4)).unwrap()
        };
        let beyond = tensor(&[0.0; 4]).reshape((1, 4)).unwrap();
        let line = |x: f32| [x, 9.0, 9.0, 9.0];
        let rows = [line(3.0_f32.ln()), line(0.0), line(7.0_f32.ln() / 2.0)];
        let bias = ScoreBias::Relative {
            rows: tensor(&rows.concat()).reshape((3, 4)).unwrap(),
            columns: tensor(&line(5.0)).reshape((1, 4)).unwrap(),
        };
        let memory = memory_of(image(0.0, 0.0), image(4.0, 8.0));
        let beyond = memory_of(beyond.clone(), beyond);
        let got = window_attention(
            &image(1.0, 2.0),
            &memory,
            &beyond,
            [2, 1],
            &bias,
            ComputeType::F32,
        )
        .unwrap();
        // Weights 1/4 and 3/4; 7/8 and 1/8.
        let got = flat(&got);
        assert!(
            (got[0] - 7.0).abs() < 1e-5 && (got[4] - 4.5).abs() < 1e-5,
            "{got:?}"
        );
    }

    proptest! {
        #[test]
        fn as_by_candle(
            batch in 1_usize..3,
            image in (1_usize..20, 1_usize..20),
            window in (1_usize..17, 1_usize..17),
            heads in 1_usize..4,
            dim in prop::sample::select(vec![1, 4, 8, 20, 32, 80]),
            by_head: bool,
            kind in 0..3,
            whole in prop::bool::weighted(0.2),
        ) {
            let window = if whole { [image.0, image.1] } else { [window.0, window.1] };
            let tokens = window[0] * window[1];
            let [q, k, v] = projected([batch, image.0, image.1, heads, dim], by_head);
            let memory = memory_of(k, v);
            let beyond = memory_of(random(&[heads, dim]), random(&[heads, dim]));
            let bias = match kind {
                0 => ScoreBias::None,
                1 => ScoreBias::Table(random(&[heads, tokens, tokens])),
                _ => ScoreBias::Relative {
                    rows: random(&[2 * window[0] - 1, dim]),
                    columns: random(&[2 * window[1] - 1, dim]),
                },
            };
            let want = plain(&q, &memory, &beyond, window, &bias, ComputeType::F32).unwrap();
            for isa in Isa::available() {
                let got = cpu::window_attention(isa, &q, &memory, &beyond, window, &bias, false).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    prop_assert!((got - want).abs() < 2e-4, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn many_keys_come_in_blocks() {
        // 35 x 33 keys: blocks begin in the midst of a row, and the greatest score changes.
        let (window, heads, dim) = ([35, 33], 2, 8);
        let [q, k, v] = projected([1, 35, 33, heads, dim], false);
        let memory = memory_of(k, v);
        let beyond = memory_of(random(&[heads, dim]), random(&[heads, dim]));
        let relative = ScoreBias::Relative {
            rows: random(&[69, dim]),
            columns: random(&[65, dim]),
        };
        let table = ScoreBias::Table(random(&[heads, 35 * 33, 35 * 33]));
        for bias in [ScoreBias::None, table, relative] {
            let want = plain(&q, &memory, &beyond, window, &bias, ComputeType::F32).unwrap();
            for (isa, pairs) in Isa::available()
                .into_iter()
                .flat_map(|isa| [(isa, false), (isa, true)])
            {
                let got = cpu::window_attention(isa, &q, &memory, &beyond, window, &bias, pairs);
                for (got, want) in flat(&got.unwrap()).iter().zip(flat(&want)) {
                    // Rounded to bf16, scores of up to 10 lose up to some 0.03.
                    let bound = if pairs { 0.1 } else { 2e-4 };
                    assert!((got - want).abs() < bound, "{isa}, {pairs}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let [q, k, v] = projected([1, 4, 5, 2, 8], true);
        let beyond = memory_of(random(&[2, 8]), random(&[2, 8]));
        let with = |k: &Tensor, v: &Tensor, beyond: &Memory, window, bias: &ScoreBias| {
            window_attention(
                &q,
                &memory_of(k.clone(), v.clone()),
                beyond,
                window,
                bias,
                ComputeType::F32,
            )
        };
        let none = &ScoreBias::None;
        assert!(with(&k, &v, &beyond, [2, 3], none).is_ok());
        assert!(with(&k, &v, &beyond, [0, 3], none).is_err());
        assert!(with(&random(&[1, 4, 5, 2, 7]), &v, &beyond, [2, 3], none).is_err());
        assert!(with(&k, &random(&[1, 4, 4, 2, 8]), &beyond, [2, 3], none).is_err());
        assert!(with(&k, &random(&[1, 4, 5, 16]), &beyond, [2, 3], none).is_err());
        let narrow = memory_of(random(&[2, 7]), random(&[2, 8]));
        assert!(with(&k, &v, &narrow, [2, 3], none).is_err());
        let table = |shape: &[usize]| ScoreBias::Table(random(shape));
        assert!(with(&k, &v, &beyond, [2, 3], &table(&[2, 6, 6])).is_ok());
        assert!(with(&k, &v, &beyond, [2, 3], &table(&[1, 6, 6])).is_err());
        assert!(with(&k, &v, &beyond, [3, 3], &table(&[2, 6, 6])).is_err());
        let relative = |rows: &[usize], columns: &[usize]| ScoreBias::Relative {
            rows: random(rows),
            columns: random(columns),
        };
        assert!(with(&k, &v, &beyond, [2, 3], &relative(&[3, 8], &[5, 8])).is_ok());
        assert!(with(&k, &v, &beyond, [2, 3], &relative(&[3, 8], &[3, 8])).is_err());
        assert!(with(&k, &v, &beyond, [2, 3], &relative(&[3, 7], &[5, 7])).is_err());
        let [q, k, v] = projected([0, 4, 5, 2, 8], true);
        let got = window_attention(
            &q,
            &memory_of(k, v),
            &beyond,
            [2, 3],
            none,
            ComputeType::F32,
        )
        .unwrap();
        assert_eq!(got.dims(), [0, 4, 5, 16]);
    }
}
