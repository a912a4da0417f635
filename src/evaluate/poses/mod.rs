//! Camera poses against their truth: pairs of cameras ([`pair_errors`], without any alignment), and all of
//! them together ([`trajectory_errors`], after a similarity).

mod pairs;
#[cfg(test)]
mod tests;
mod trajectory;

pub use pairs::{PairError, PoseAccuracy, accuracy, pair_errors};
pub use trajectory::{TrajectoryErrors, trajectory_errors};
