//! How the time of a network is divided.

use serde::Serialize;
use tid3r_models::nn::profile::Recording;

/// What operations of one kind take in a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProfileRow {
    /// The kind.
    pub operation: &'static str,
    /// How many there are.
    pub calls: f64,
    /// Seconds that they take.
    pub seconds: f64,
    /// The share of the run's time.
    pub share_of_time: f64,
    /// The share of the machine's measured peak in f32 that they reach with the multiply-adds that they
    /// really compute; `None` where these are not what takes the time. In bf16 it can be more than 1.
    pub share_of_peak: Option<f64>,
}

/// A row for each kind of operation that was recorded in runs of these `seconds`, and one for what is beside
/// them; those that take longest first. `peak` is in operations a second, two for a multiply-add.
pub(super) fn rows(recording: &Recording, seconds: &[f64], peak: f64) -> Vec<ProfileRow> {
    let (runs, total) = (seconds.len() as f64, seconds.iter().sum::<f64>());
    let mut rest = total;
    let mut rows: Vec<ProfileRow> = (recording.spent().into_iter())
        .filter(|(_, spent)| spent.calls > 0)
        .map(|(operation, spent)| {
            let time = spent.time.as_secs_f64();
            rest -= time;
            let share = 2.0 * spent.multiply_adds / time / peak;
            ProfileRow {
                operation: operation.name(),
                calls: spent.calls as f64 / runs,
                seconds: time / runs,
                share_of_time: time / total,
                share_of_peak: (spent.multiply_adds > 0.0).then_some(share),
            }
        })
        .collect();
    rows.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    rows.push(ProfileRow {
        operation: "everything else",
        calls: 0.0,
        seconds: rest.max(0.0) / runs,
        share_of_time: rest.max(0.0) / total,
        share_of_peak: None,
    });
    rows
}
