//! A solver of second order for few steps.

use candle_core::{Result, Tensor, bail};

use crate::see3d::schedule::Schedule;

/// The timesteps that are visited in so many steps.
///
/// # Errors
///
/// If there cannot be so many.
pub fn timesteps(steps: usize) -> Result<Vec<usize>> {
    if !(1..=Schedule::FIRST).contains(&steps) {
        bail!(
            "the number of steps must be from 1 to {}, got {steps}",
            Schedule::FIRST
        );
    }
    let of = |i: usize| (Schedule::FIRST * (steps - i)).div_ceil(steps);
    Ok((0..steps).map(of).collect())
}

/// TODO
pub struct Solver<'a> {
    schedule: &'a Schedule,
    /// The last prediction, and the angle at which it was made.
    before: Option<(Tensor, f64)>,
}

impl<'a> Solver<'a> {
    /// At the start.
    pub fn new(schedule: &'a Schedule) -> Self {
        Self {
            schedule,
            before: None,
        }
    }

    /// From `sample` at `timestep`, where the network gave `output`, to the `next` timestep or the end.
    ///
    /// # Errors
    ///
    /// As [`Schedule::told`].
    pub fn step(
        &mut self,
        output: &Tensor,
        sample: &Tensor,
        timestep: usize,
        next: Option<usize>,
    ) -> Result<Tensor> {
        let alpha = self.schedule.alpha(timestep)?;
        let to = match next {
            Some(next) => self.schedule.alpha(next)?,
            None => self.schedule.final_alpha(),
        };
        let told = self.schedule.told(output, sample, alpha)?;
        let (from, to_angle) = (angle(alpha), angle(to));
        let (signal, noise) = (to.sqrt(), (1.0 - to).sqrt());
        let ratio = noise / (1.0 - alpha).sqrt();
        let mut next = ((sample * ratio)? + (&told.sample * (signal - alpha.sqrt() * ratio))?)?;
        if let Some((before, at)) = self.before.take() {
            let slope = (signal * (from - to_angle) + noise * ratio.ln()) / (at - from);
            next = (next + ((&told.sample - before)? * slope)?)?;
        }
        self.before = Some((told.sample, from));
        Ok(next)
    }
}

/// The angle whose sine is the noise.
fn angle(alpha: f64) -> f64 {
    (1.0 - alpha).sqrt().atan2(alpha.sqrt())
}
