//! What `scheduler_config.json` says.

use candle_core::{Result, bail};
use serde::{Deserialize, Serialize};

/// The settings of the scheduler, under the names and with the defaults of diffusers' `DDIMScheduler`. What
/// the pipeline forces (`rescale_betas_zero_snr`, `clip_sample`, `steps_offset`) is not read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Config {
    /// Number of timesteps.
    pub num_train_timesteps: usize,
    /// Variance that the first timestep adds.
    pub beta_start: f64,
    /// Variance that the last one adds, before the terminal SNR is made zero.
    pub beta_end: f64,
    /// What lies between.
    pub beta_schedule: BetaSchedule,
    /// Variances one by one; not supported.
    pub trained_betas: Option<Vec<f64>>,
    /// Whether the last step ends without noise; else with that of timestep 0.
    pub set_alpha_to_one: bool,
    /// What the network predicts.
    pub prediction_type: Prediction,
    /// Whether samples are clipped to percentiles; not supported.
    pub thresholding: bool,
    /// The timesteps that the scheduler itself visits.
    pub timestep_spacing: Spacing,
    /// A key that See3D adds: `trailing`, if the pipeline visits timesteps of its own. The original fails
    /// without it; here its absence stands for `trailing`, see [`Self::warning`].
    pub timestep_scaling: Option<String>,
}

/// How variances grow.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum BetaSchedule {
    /// Linearly.
    Linear,
    /// Their square roots linearly.
    ScaledLinear,
    /// Another way, which is not supported.
    Other(String),
}

/// What a network predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Prediction {
    /// The noise.
    #[serde(rename = "epsilon")]
    Epsilon,
    /// The sample without noise.
    #[serde(rename = "sample")]
    Sample,
    /// `signal * noise - noise level * sample` (Salimans and Ho 2022).
    #[serde(rename = "v_prediction")]
    V,
}

/// Which timesteps the scheduler itself visits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Spacing {
    /// From 1 up in equal steps.
    Leading,
    /// From the last down in equal steps.
    Trailing,
    /// Equally from the last to 0.
    Linspace,
}

impl From<String> for BetaSchedule {
    fn from(name: String) -> Self {
        match name.as_str() {
            "linear" => Self::Linear,
            "scaled_linear" => Self::ScaledLinear,
            _ => Self::Other(name),
        }
    }
}

impl From<BetaSchedule> for String {
    fn from(schedule: BetaSchedule) -> Self {
        match schedule {
            BetaSchedule::Linear => "linear".to_owned(),
            BetaSchedule::ScaledLinear => "scaled_linear".to_owned(),
            BetaSchedule::Other(name) => name,
        }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            num_train_timesteps: 1000,
            beta_start: 1e-4,
            beta_end: 0.02,
            beta_schedule: BetaSchedule::Linear,
            trained_betas: None,
            set_alpha_to_one: true,
            prediction_type: Prediction::Epsilon,
            thresholding: false,
            timestep_spacing: Spacing::Leading,
            timestep_scaling: None,
        }
    }
}

impl Config {
    const TRAILING: &str = "trailing";

    /// The released settings, as far as is known.
    pub fn released() -> Self {
        Self {
            beta_start: 0.00085,
            beta_end: 0.012,
            beta_schedule: BetaSchedule::ScaledLinear,
            set_alpha_to_one: false,
            prediction_type: Prediction::V,
            timestep_scaling: Some(Self::TRAILING.to_owned()),
            ..Self::default()
        }
    }

    /// Whether the pipeline visits timesteps of its own, and not the scheduler's.
    pub(super) fn is_trailing(&self) -> bool {
        (self.timestep_scaling.as_deref()).is_none_or(|scaling| scaling == Self::TRAILING)
    }

    /// What a user should hear of these settings.
    pub fn warning(&self) -> Option<String> {
        let assumed = "scheduler_config.json has no timestep_scaling, without which the original does not \
                       run; \"trailing\" is assumed";
        self.timestep_scaling.is_none().then(|| assumed.to_owned())
    }

    /// Refuses settings that are not supported, or cannot be.
    ///
    /// # Errors
    ///
    /// With the key and what is wrong with it.
    pub fn check(&self) -> Result<()> {
        const MOST: usize = 100_000;
        // The pipeline's own first timestep must be there.
        let least = super::Schedule::FIRST + 1;
        if !(least..=MOST).contains(&self.num_train_timesteps) {
            bail!(
                "num_train_timesteps must be from {least} to {MOST}, got {}",
                self.num_train_timesteps
            );
        }
        if let BetaSchedule::Other(name) = &self.beta_schedule {
            bail!("the beta_schedule `{name}` is not supported, only linear and scaled_linear");
        }
        if self.trained_betas.is_some() {
            bail!("trained_betas are not supported: a beta_schedule is wanted");
        }
        if self.thresholding {
            bail!("thresholding is not supported");
        }
        let (start, end) = (self.beta_start, self.beta_end);
        if !(0.0 < start && start <= end && end < 1.0) {
            bail!("beta_start and beta_end must rise between 0 and 1, got {start} and {end}");
        }
        Ok(())
    }
}
