//! See3D (Ma et al. 2024): sparse projections of a scene to whole pictures, guided by photos.
//!
//! A latent diffusion network without camera poses. All frames, photos and projections, are denoised
//! together by a [`unet`] whose attention spans them; [`schedule`] says how much noise there is at
//! which step, and [`denoise`] goes from noise to latents. Latents and pictures are made of each other by
//! a [`vae`]; what a picture or a text means to the network comes from [`clip`].
//!
//! Facts are from baaivision/See3D at 52594ef; tensor names are those of its checkpoints.
//!
//! How often the network is asked, by the original's sampler and by the fast one:
//!
//! ```
//! use tid3r_models::see3d::{
//!     denoise::{Quality, Reuse, Sampler, Variant},
//!     schedule::{Config, Schedule},
//! };
//!
//! let schedule = Schedule::new(&Config::default())?;
//! // It begins with nothing but noise.
//! assert_eq!(schedule.alpha(Schedule::FIRST)?, 0.0);
//!
//! let exact = Sampler::released(Variant::Main);
//! assert_eq!((exact.steps, exact.timesteps(&schedule)?.len()), (50, 53));
//! let fast = Sampler { steps: 12, quality: Quality::Fast(Reuse::Never), ..exact };
//! let visited = fast.timesteps(&schedule)?;
//! assert_eq!((visited.len(), visited[0]), (12, Schedule::FIRST));
//! // Each time with the condition and without.
//! assert_eq!(fast.groups(), 2);
//! # Ok::<(), candle_core::Error>(())
//! ```

pub mod clip;
pub mod denoise;
pub mod schedule;
pub mod unet;
pub mod vae;
