//! What cannot be.

use candle_core::{Result, bail};

use super::{Config, Repeats};
use crate::see3d::unet::plan::Plan;

impl Config {
    /// Refuses what no network can be built of, and variants that See3D does not use.
    ///
    /// # Errors
    ///
    /// With the key and what is wrong with it.
    pub fn validate(&self) -> Result<()> {
        const WIDEST: usize = 1 << 14;
        const LEVELS: usize = 8;
        if !(1..=LEVELS).contains(&self.levels()) {
            bail!(
                "channel_mult must have from 1 to {LEVELS} levels, got {}",
                self.levels()
            );
        }
        if let Repeats::Each(numbers) = &self.num_res_blocks
            && numbers.len() != self.levels()
        {
            bail!(
                "num_res_blocks {numbers:?} and channel_mult {:?} differ in length",
                self.channel_mult
            );
        }
        let sizes = [
            ("in_channels", self.in_channels),
            ("model_channels", self.model_channels),
            ("out_channels", self.out_channels),
            ("context_dim", self.context_dim),
        ];
        let levels = (0..self.levels()).flat_map(|level| {
            let multiple = self.channel_mult[level];
            let width = self.model_channels.saturating_mul(multiple);
            let repeats = self.num_res_blocks.of(level).saturating_mul(1 << 8);
            [
                ("channel_mult", multiple),
                ("model_channels * channel_mult", width),
                ("256 * num_res_blocks", repeats),
            ]
        });
        for (name, size) in sizes.into_iter().chain(levels) {
            if !(1..=WIDEST).contains(&size) {
                bail!("{name} must be from 1 to {WIDEST}, got {size}");
            }
        }
        if !self.model_channels.is_multiple_of(Self::NORM_GROUPS) {
            bail!(
                "model_channels = {} is no multiple of the norms' 32 groups",
                self.model_channels
            );
        }
        if self.channel_mult[0] != 1 {
            bail!(
                "channel_mult must begin with 1, got {:?}: the last convolution takes model_channels",
                self.channel_mult
            );
        }
        self.validate_variant()?;
        self.validate_heads()
    }

    fn validate_variant(&self) -> Result<()> {
        if self.ip_dim > 0 {
            bail!(
                "ip_dim = {}: a network with image prompts takes inputs that See3D's pipeline never \
                 gives; only ip_dim = 0 is supported",
                self.ip_dim
            );
        }
        for (key, wanted, is_so) in [
            ("transformer_depth", "1", self.transformer_depth == 1),
            ("use_scale_shift_norm", "false", !self.use_scale_shift_norm),
            ("resblock_updown", "false", !self.resblock_updown),
            ("num_classes", "null", self.num_classes.is_none()),
            ("n_embed", "null", self.n_embed.is_none()),
            ("conv_resample", "true", self.conv_resample),
            ("dims", "2", self.dims == 2),
        ] {
            if !is_so {
                bail!("{key} must be {wanted}: See3D has no other networks");
            }
        }
        Ok(())
    }

    fn validate_heads(&self) -> Result<()> {
        let width = usize::try_from(self.num_head_channels).ok();
        for channels in Plan::of(self).transformer_channels() {
            let heads = self.heads(channels);
            let shared = heads > 0 && channels.is_multiple_of(heads);
            if !shared || width.is_some_and(|width| width != channels / heads) {
                bail!(
                    "a transformer's {channels} channels cannot be shared among heads as num_head_channels \
                     = {} and num_heads = {} say",
                    self.num_head_channels,
                    self.num_heads
                );
            }
        }
        Ok(())
    }
}
