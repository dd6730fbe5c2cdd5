//! Design and evaluation of marker drawings. Not needed for recognition.
//!
//! [`check`] evaluates drawings, with the bound from `bound`; [`design`] creates new ones,
//! [`trace`] makes one from an image, and [`sheet`] prints them.

mod bound;
pub mod check;
pub mod design;
pub mod sheet;
pub mod trace;
