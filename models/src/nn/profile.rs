//! Where the time of networks goes, by kind of operation.
//!
//! Kernels on CPUs note how long they took and how many multiply-adds they did. That costs a
//! fraction of a microsecond for each call, and nothing but a look at a flag while nobody [records].
//!
//! [records]: Recording

use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Kinds of operations that are told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Affine maps of channels.
    Linear,
    /// Attention of any form, scores to weighted sums.
    Attention,
    /// Convolutions that transform tiles and filters.
    Winograd,
    /// Other convolutions that mix channels, transposed ones too.
    Convolution,
    /// Convolutions of single channels.
    Depthwise,
    /// Normalisation of layers and groups.
    Norm,
    /// What is left: activations, rotations, resampling, pooling.
    Elementwise,
}

impl Operation {
    /// All, in the order of a table.
    pub const ALL: [Self; 7] = [
        Self::Linear,
        Self::Attention,
        Self::Winograd,
        Self::Convolution,
        Self::Depthwise,
        Self::Norm,
        Self::Elementwise,
    ];

    /// In a few words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Attention => "attention",
            Self::Winograd => "convolution (Winograd)",
            Self::Convolution => "convolution (direct)",
            Self::Depthwise => "convolution (depthwise)",
            Self::Norm => "norm",
            Self::Elementwise => "elementwise",
        }
    }
}

/// What all operations of a kind took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// How many there were.
    pub calls: u64,
    /// How long they took, each on all threads.
    pub time: Duration,
    /// Multiply-adds that were really computed.
    pub multiply_adds: f64,
}

static RECORDING: AtomicBool = AtomicBool::new(false);
static RECORDERS: Mutex<()> = Mutex::new(());
static TOTALS: [Total; Operation::ALL.len()] = [const { Total::new() }; Operation::ALL.len()];

struct Total {
    calls: AtomicU64,
    nanoseconds: AtomicU64,
    multiply_adds: AtomicU64,
}

impl Total {
    const fn new() -> Self {
        Self {
            calls: AtomicU64::new(0),
            nanoseconds: AtomicU64::new(0),
            multiply_adds: AtomicU64::new(0),
        }
    }
}

/// Notes the operations of the whole process while it exists. There is one at a time; another one waits.
pub struct Recording {
    _alone: std::sync::MutexGuard<'static, ()>,
}

impl Recording {
    /// From now on.
    pub fn start() -> Self {
        let alone = RECORDERS.lock().unwrap_or_else(PoisonError::into_inner);
        for total in &TOTALS {
            total.calls.store(0, Ordering::Relaxed);
            total.nanoseconds.store(0, Ordering::Relaxed);
            total.multiply_adds.store(0, Ordering::Relaxed);
        }
        RECORDING.store(true, Ordering::Relaxed);
        Self { _alone: alone }
    }

    /// What operations of each kind took so far.
    pub fn spent(&self) -> [(Operation, Spent); Operation::ALL.len()] {
        Operation::ALL.map(|operation| {
            let total = &TOTALS[operation as usize];
            let spent = Spent {
                calls: total.calls.load(Ordering::Relaxed),
                time: Duration::from_nanos(total.nanoseconds.load(Ordering::Relaxed)),
                multiply_adds: total.multiply_adds.load(Ordering::Relaxed) as f64,
            };
            (operation, spent)
        })
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        RECORDING.store(false, Ordering::Relaxed);
    }
}

/// An operation that is under way until this is dropped.
pub(in crate::nn) struct Timer(Option<(Operation, usize, Instant)>);

impl Timer {
    /// Begins an operation that does so many multiply-adds.
    pub(in crate::nn) fn start(operation: Operation, multiply_adds: usize) -> Self {
        let recorded = RECORDING.load(Ordering::Relaxed);
        Self(recorded.then(|| (operation, multiply_adds, Instant::now())))
    }
}

impl Drop for Timer {
    fn drop(&mut self) {
        if let Some((operation, multiply_adds, start)) = self.0 {
            let total = &TOTALS[operation as usize];
            let nanoseconds = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
            total.calls.fetch_add(1, Ordering::Relaxed);
            total.nanoseconds.fetch_add(nanoseconds, Ordering::Relaxed);
            (total.multiply_adds).fetch_add(multiply_adds as u64, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};

    use super::*;
    use crate::Weights;
    use crate::nn::{Activation, Linear};

    #[test]
    fn operations_are_counted_while_recorded() {
        let weights = Weights::from_fn(|_, shape| vec![1.0; shape.iter().product()], &Device::Cpu);
        let layer = Linear::new(5, 7, &weights).unwrap();
        let x = Tensor::zeros((3, 5), DType::F32, &Device::Cpu).unwrap();
        let recording = Recording::start();
        layer.forward(&x, Activation::Identity).unwrap();
        let (operation, linear) = recording.spent()[0];
        // Other tests may run meanwhile.
        assert_eq!(operation, Operation::Linear);
        assert!(linear.calls >= 1 && linear.multiply_adds >= 105.0 && !linear.time.is_zero());
        drop(recording);
        assert!(
            Timer::start(Operation::Linear, 1).0.is_none() || RECORDING.load(Ordering::Relaxed)
        );
    }
}
