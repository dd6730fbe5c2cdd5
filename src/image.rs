//! Images: the bytes of a frame, their decoding, and reading and writing of image files.

pub mod frame;
pub mod jpeg;
pub mod limits;
pub mod picture_file;
pub(crate) mod png;
