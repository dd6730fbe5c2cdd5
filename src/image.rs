//! Pictures: the bytes of a frame, what they decode to, and how JPEG data are read.

pub mod frame;
pub mod jpeg;
