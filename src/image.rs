//! Pictures: the bytes of a frame, what they decode to, and how picture files are read and written.

pub mod frame;
pub mod jpeg;
pub mod limits;
pub mod picture_file;
pub(crate) mod png;
