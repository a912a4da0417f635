//! A solver of second order for few steps.
//!
//! With `signal = cos(angle)` and `noise = sin(angle)`, the equation that DDIM steps through is, exactly,
//!
//! ```text
//! x(to) = x(from) noise(to) / noise(from) + noise(to) * integral of prediction(angle) / noise(angle)^2
//! ```
//!
//! from `to` to `from`, `prediction` being the sample without noise as the network sees it on the way. DDIM takes
//! it for constant. DPM-Solver++ (Lu et al. 2022) takes it for linear in the logarithm of signal to noise; that is
//! infinite at the start here, where there is nothing but noise, and the step after the start would be
//! of first order. Linear in the *angle* there is no such place, neither at the start nor at an end without
//! noise, and the integral has a closed form (`Segment`).
//!
//! A step extrapolates the line through the last two predictions. When the network has been asked at its end,
//! the step is done again with the line through the predictions at both ends (the corrector of UniPC; Zhao et
//! al. 2023), which costs no call of the network, and makes the first step one of second order, too.

use candle_core::{Result, Tensor, bail};

use crate::see3d::schedule::Schedule;

/// The timesteps that are visited in so many steps. Their square roots are equally far from each other: on the
/// way much changes where there is little noise. In equal steps of time, the same error takes twice as many.
///
/// # Errors
///
/// If there cannot be so many.
pub fn timesteps(steps: usize) -> Result<Vec<usize>> {
    let first = Schedule::FIRST;
    if !(1..=first).contains(&steps) {
        bail!("the number of steps must be from 1 to {first}, got {steps}");
    }
    let whole = ((first + 1) as f64).sqrt();
    let next = |last: &mut usize, left: usize| {
        let root = 1.0 + (whole - 1.0) * left as f64 / steps as f64;
        // Of very many steps, the last ones are neighbours.
        *last = ((root * root).round() as usize - 1).clamp(left - 1, *last - 1);
        Some(*last)
    };
    Ok((1..=steps).rev().scan(first + 1, next).collect())
}

/// Goes from step to step.
#[derive(Clone, Debug)]
pub struct Solver<'a> {
    schedule: &'a Schedule,
    /// The last step.
    before: Option<Asked>,
}

/// What the network said at a step.
#[derive(Clone, Debug)]
struct Asked {
    /// Where it was asked, after correction.
    sample: Tensor,
    /// The sample without noise, as it sees it.
    prediction: Tensor,
    alpha: f64,
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
        let prediction = self.schedule.told(output, sample, alpha)?.sample;
        let to = match next {
            Some(next) => self.schedule.alpha(next)?,
            None => self.schedule.final_alpha(),
        };
        let mut asked = Asked {
            sample: sample.clone(),
            prediction,
            alpha,
        };
        let slope = match self.before.take() {
            None => None,
            Some(before) => {
                let slope = before.slope_to(&asked)?;
                asked.sample = Segment::new(before.alpha, alpha).step(&before, Some(&slope))?;
                Some(slope)
            }
        };
        let sample = Segment::new(alpha, to).step(&asked, slope.as_ref())?;
        self.before = Some(asked);
        Ok(sample)
    }
}

impl Asked {
    /// By how much the prediction changes with the angle between here and `other`, which has a smaller one.
    fn slope_to(&self, other: &Self) -> Result<Tensor> {
        (&other.prediction - &self.prediction)? / (angle(self.alpha) - angle(other.alpha))
    }
}

/// The factors of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    /// Of the sample.
    sample: f64,
    /// Of the prediction at the beginning.
    prediction: f64,
    /// Of its slope.
    slope: f64,
}

impl Segment {
    /// From one alpha to another.
    fn new(from: f64, to: f64) -> Self {
        let (signal, noise) = (to.sqrt(), (1.0 - to).sqrt());
        let ratio = noise / (1.0 - from).sqrt();
        // x ln(x) is 0 where x is.
        let logarithm = if ratio > 0.0 { ratio.ln() } else { 0.0 };
        Self {
            sample: ratio,
            prediction: signal - from.sqrt() * ratio,
            slope: signal * (angle(from) - angle(to)) + noise * logarithm,
        }
    }

    fn step(self, from: &Asked, slope: Option<&Tensor>) -> Result<Tensor> {
        let sample = ((&from.sample * self.sample)? + (&from.prediction * self.prediction)?)?;
        match slope {
            Some(slope) => sample + (slope * self.slope)?,
            None => Ok(sample),
        }
    }
}

/// The angle whose cosine is the signal and whose sine is the noise.
fn angle(alpha: f64) -> f64 {
    (1.0 - alpha).sqrt().atan2(alpha.sqrt())
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use crate::see3d::schedule::{Config, Prediction};

    /// Independent Gaussian data: the best prediction is known, and so is where the equation leads.
    struct Gaussian {
        mean: Vec<f64>,
        variance: Vec<f64>,
    }

    impl Gaussian {
        fn new() -> Self {
            let variance = (0..40).map(|i| 10_f64.powf(-3.0 + 0.09 * f64::from(i)));
            let mean = (0..40).map(|i| (f64::from(i) * 1.7).sin());
            Self {
                mean: mean.collect(),
                variance: variance.collect(),
            }
        }

        fn start(&self) -> Vec<f64> {
            (0..40).map(|i| 1.5 * (f64::from(i) * 2.9).cos()).collect()
        }

        /// The sample without noise, as a perfect network sees it.
        fn prediction(&self, x: &[f64], alpha: f64) -> Vec<f64> {
            let signal = alpha.sqrt();
            let of = |(i, x): (usize, &f64)| {
                let (mean, variance) = (self.mean[i], self.variance[i]);
                mean + signal * variance * (x - signal * mean) / (alpha * variance + 1.0 - alpha)
            };
            x.iter().enumerate().map(of).collect()
        }

        /// Where the start leads: distances from the mean grow with the deviation.
        fn end(&self, alpha: f64) -> Vec<f64> {
            let of = |(i, x): (usize, f64)| {
                alpha.sqrt() * self.mean[i] + x * (alpha * self.variance[i] + 1.0 - alpha).sqrt()
            };
            self.start().into_iter().enumerate().map(of).collect()
        }
    }

    fn schedule() -> Schedule {
        let config = Config {
            prediction_type: Prediction::Sample,
            ..Config::released()
        };
        Schedule::new(&config).unwrap()
    }

    fn values(x: &Tensor) -> Vec<f64> {
        x.to_vec1().unwrap()
    }

    /// The relative error of a run with `step`, which goes from a sample at a timestep to the next.
    fn error(
        timesteps: &[usize],
        mut step: impl FnMut(&Tensor, &Tensor, usize, Option<usize>) -> Tensor,
    ) -> f64 {
        let (schedule, data) = (schedule(), Gaussian::new());
        let tensor = |values: Vec<f64>| Tensor::new(values, &Device::Cpu).unwrap();
        let mut x = tensor(data.start());
        for (i, &timestep) in timesteps.iter().enumerate() {
            let alpha = schedule.alpha(timestep).unwrap();
            let output = tensor(data.prediction(&values(&x), alpha));
            x = step(&output, &x, timestep, timesteps.get(i + 1).copied());
        }
        let want = data.end(schedule.final_alpha());
        let sum = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let got = values(&x);
        sum(&mut got.iter().zip(&want).map(|(g, w)| g - w)) / sum(&mut want.iter().copied())
    }

    fn fast(steps: usize) -> f64 {
        let schedule = schedule();
        let mut solver = Solver::new(&schedule);
        error(&timesteps(steps).unwrap(), |output, x, timestep, next| {
            solver.step(output, x, timestep, next).unwrap()
        })
    }

    /// DDIM from each timestep to the next.
    fn ddim(timesteps: &[usize]) -> f64 {
        let schedule = schedule();
        error(timesteps, |output, x, timestep, next| {
            Solver::new(&schedule)
                .step(output, x, timestep, next)
                .unwrap()
        })
    }

    /// The original's sampler, with its steps that are longer than the way to the next timestep.
    fn exact(steps: usize) -> f64 {
        let schedule = schedule();
        error(
            &schedule.timesteps(steps).unwrap(),
            |output, x, timestep, _| schedule.step(output, x, timestep, steps).unwrap(),
        )
    }

    #[test]
    fn few_steps_come_closer_than_many_of_the_original() {
        let (fast, exact) = (fast(12), exact(50));
        assert!(fast < 0.01 && fast < exact / 2.0, "{fast} {exact}");
    }

    #[test]
    fn errors_fall_with_the_square_of_the_steps() {
        let errors = [10, 20, 40, 80].map(fast);
        for pair in errors.windows(2) {
            assert!(pair[1] < pair[0] / 3.0, "{errors:?}");
        }
        let first_order = [10, 20, 40, 80].map(|steps| ddim(&timesteps(steps).unwrap()));
        assert!(first_order[3] > first_order[0] / 12.0, "{first_order:?}");
        for (second, first) in errors.iter().zip(first_order) {
            assert!(*second < first / 4.0, "{errors:?} {first_order:?}");
        }
    }

    #[test]
    fn a_prediction_that_is_a_line_is_integrated_exactly() {
        // prediction = angle: the integral of angle / sin(angle)^2 by 10^5 trapezoids.
        let (from, to) = (0.2, 0.6);
        let segment = Segment::new(from, to);
        let got = segment.prediction * angle(from) - segment.slope;
        let (start, end, count) = (angle(to), angle(from), 100_000);
        let step = (end - start) / f64::from(count);
        let value = |i| {
            let at: f64 = start + step * f64::from(i);
            at / at.sin().powi(2) * if i == 0 || i == count { 0.5 } else { 1.0 }
        };
        let want = (1.0_f64 - to).sqrt() * step * (0..=count).map(value).sum::<f64>();
        assert!((got - want).abs() < 1e-9, "{got} {want}");
    }

    #[test]
    fn an_end_without_noise_is_the_prediction() {
        let segment = Segment::new(0.9, 1.0);
        assert_eq!((segment.sample, segment.prediction), (0.0, 1.0));
        assert!((segment.slope - angle(0.9)).abs() < 1e-12);
        let start = Segment::new(0.0, 0.5);
        assert_eq!(
            (start.sample, start.prediction),
            (0.5_f64.sqrt(), 0.5_f64.sqrt())
        );
    }

    #[test]
    fn visited_timesteps() {
        assert_eq!(timesteps(1).unwrap(), [999]);
        let twelve = timesteps(12).unwrap();
        assert_eq!((twelve.len(), twelve[0], twelve[11]), (12, 999, 12));
        for steps in 1..=999 {
            let all = timesteps(steps).unwrap();
            assert!(
                all.windows(2).all(|pair| pair[0] > pair[1]) && all[0] == 999,
                "{steps}"
            );
        }
        assert!(timesteps(0).is_err() && timesteps(1000).is_err());
    }
}
