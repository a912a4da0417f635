//! Looking on while a network works.

use candle_core::{Result, Tensor};

/// Is shown the tensors between the stages of a network, and told of its progress.
pub trait Observer {
    /// The stage called `name` is done; `tensor` makes its tensor, which costs a copy.
    ///
    /// # Errors
    ///
    /// What `tensor` returns.
    fn stage(&mut self, name: &str, tensor: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        let _ = (name, tensor);
        Ok(())
    }

    /// So many more multiply-adds are done, of those that the network's `Work` counts as
    /// computed for a batch of one.
    fn advance(&mut self, multiply_adds: f64) {
        let _ = multiply_adds;
    }
}

/// Looks away.
#[derive(Clone, Copy, Debug)]
pub struct Unobserved;

impl Observer for Unobserved {}
