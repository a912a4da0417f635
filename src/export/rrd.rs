//! Recordings of Rerun: with the feature `rerun`, else refused with advice.

#[cfg(feature = "rerun")]
mod entities;

#[cfg(feature = "rerun")]
pub(super) use entities::write;

#[cfg(not(feature = "rerun"))]
pub(super) fn write(
    _scene: &crate::scene::Scene,
    path: &std::path::Path,
    _params: &super::ExportParams,
) -> crate::Result<String> {
    Err(crate::Error::file(
        path,
        "would be a recording of Rerun, which this build of tid3r cannot write",
        "build tid3r with `--features rerun`, or write a .glb or .ply, which Rerun opens, too",
    ))
}
