//! MobileSAMv2 (Zhang et al. 2023): the objects of a photo, and a mask for each.
//!
//! Facts are from ChaoningZhang/MobileSAM at 34bbbfd, folder `MobileSAMv2`; tensor names are those of its
//! checkpoints, after what a file puts before them.

pub mod decoder;
