//! What other programs write and read: recordings in, scenes out.
//!
//! Each format is a pair of reader and writer between a file and plain structs in tid3r's conventions;
//! formats know nothing of scenes.
//!
//! Points that some other program wrote:
//!
//! ```
//! use tid3r::exchange::ply::read_cloud;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("points.ply");
//! let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
//!               property float z\nproperty int instance\nend_header\n";
//! std::fs::write(&path, format!("{header}1 2 3 7\n4 5 6 0\n"))?;
//! let cloud = read_cloud(&path)?;
//! assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
//! assert_eq!(cloud.instances, Some(vec![7, 0]));
//! assert_eq!(cloud.colours, None);
//! # Ok(())
//! # }
//! ```

pub mod cameras;
pub mod colmap;
pub mod glb;
mod half_pixels;
pub mod npz;
pub mod ply;
pub mod recording;
#[cfg(feature = "rerun")]
pub mod rrd;
pub mod transforms;
