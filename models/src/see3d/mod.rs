//! See3D (Ma et al. 2024): sparse projections of a scene to whole pictures, guided by photos.
//!
//! A latent diffusion network without camera poses. All frames, photos and projections, are denoised
//! together by a [`unet`] whose attention spans them; [`schedule`] says how much noise there is at
//! which step, and [`denoise`] goes from noise to latents. Latents and pictures are made of each other by
//! a [`vae`]; what a picture or a text means to the network comes from [`clip`].
//!
//! Facts are from baaivision/See3D at 52594ef; tensor names are those of its checkpoints.

pub mod clip;
pub mod denoise;
pub mod schedule;
pub mod unet;
pub mod vae;
