//! Betas and alphas, in f32 as diffusers has them: near the end, where next to nothing of the signal is
//! left, its rounding is part of what networks were trained with.

use candle_core::{Result, bail};

use super::{BetaSchedule, Config};

/// The variance of the noise that each timestep adds, as the configuration says it.
///
/// # Errors
///
/// If the configuration is one that this does not know, see [`Config::check`].
pub fn betas(config: &Config) -> Result<Vec<f32>> {
    config.check()?;
    let (start, end, count) = (
        config.beta_start,
        config.beta_end,
        config.num_train_timesteps,
    );
    Ok(match &config.beta_schedule {
        BetaSchedule::Linear => line(start, end, count),
        BetaSchedule::ScaledLinear => {
            let roots = line(start.sqrt(), end.sqrt(), count);
            roots.into_iter().map(|root| root * root).collect()
        }
        BetaSchedule::Other(name) => bail!("the beta_schedule `{name}` is not known"),
    })
}

/// `count` numbers from `start` to `end`, from both of which PyTorch counts to the middle, rounding once.
fn line(start: f64, end: f64, count: usize) -> Vec<f32> {
    let (start, end) = (start as f32, end as f32);
    let step = (end - start) / (count - 1) as f32;
    let number = |i: usize| match i < count / 2 {
        true => step.mul_add(i as f32, start),
        false => step.mul_add(-((count - 1 - i) as f32), end),
    };
    (0..count).map(number).collect()
}

/// `alphas_cumprod`: the products of `1 - beta` up to each timestep.
pub fn cumulative(betas: &[f32]) -> Vec<f32> {
    let product = |product: &mut f64, beta: &f32| {
        *product *= f64::from(1.0 - beta);
        Some(*product as f32)
    };
    betas.iter().scan(1.0, product).collect()
}

/// `betas` changed so that the last timestep is nothing but noise (Lin et al. 2024, algorithm 1).
pub fn rescaled_to_zero(betas: &[f32]) -> Vec<f32> {
    let roots: Vec<f32> = cumulative(betas).into_iter().map(f32::sqrt).collect();
    let (Some(&first), Some(&last)) = (roots.first(), roots.last()) else {
        return Vec::new();
    };
    let scale = first / (first - last);
    let alphas = roots.iter().map(|root| {
        let root = (root - last) * scale;
        root * root
    });
    let beta = |before: &mut f32, alpha: f32| {
        let beta = 1.0 - alpha / *before;
        *before = alpha;
        Some(beta)
    };
    alphas.scan(1.0, beta).collect()
}
