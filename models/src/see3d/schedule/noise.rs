//! Betas and alphas.

use candle_core::{Result, bail};

use super::{BetaSchedule, Config};

/// The variance of the noise that each timestep adds, as the configuration says it.
///
/// # Errors
///
/// If the configuration is one that this does not know, see [`Config::check`].
pub fn betas(config: &Config) -> Result<Vec<f64>> {
    config.check()?;
    let count = config.num_train_timesteps;
    let line = |start: f64, end: f64| {
        let step = (end - start) / (count - 1) as f64;
        (0..count).map(move |i| start + step * i as f64)
    };
    let (start, end) = (config.beta_start, config.beta_end);
    Ok(match &config.beta_schedule {
        BetaSchedule::Linear => line(start, end).collect(),
        BetaSchedule::ScaledLinear => line(start.sqrt(), end.sqrt())
            .map(|root| root * root)
            .collect(),
        BetaSchedule::Other(name) => bail!("the beta_schedule `{name}` is not known"),
    })
}

/// `alphas_cumprod`: the products of `1 - beta` up to each timestep.
pub fn cumulative(betas: &[f64]) -> Vec<f64> {
    let product = |product: &mut f64, beta: &f64| {
        *product *= 1.0 - beta;
        Some(*product)
    };
    betas.iter().scan(1.0, product).collect()
}

/// `betas` changed so that the last timestep is nothing but noise (Lin et al. 2024, algorithm 1).
pub fn rescaled_to_zero(betas: &[f64]) -> Vec<f64> {
    let roots: Vec<f64> = cumulative(betas).into_iter().map(f64::sqrt).collect();
    let (Some(&first), Some(&last)) = (roots.first(), roots.last()) else {
        return Vec::new();
    };
    let scale = first / (first - last);
    let alphas = roots.iter().map(|root| ((root - last) * scale).powi(2));
    let beta = |before: &mut f64, alpha: f64| {
        let beta = 1.0 - alpha / *before;
        *before = alpha;
        Some(beta)
    };
    alphas.scan(1.0, beta).collect()
}
