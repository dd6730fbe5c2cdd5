//! overcam.
pub mod frame;
pub mod source;
