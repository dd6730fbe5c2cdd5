//! Making and judging marker drawings: none of it is needed to read markers in a frame.
//!
//! [`check`] says how good drawings are, with the bound of `bound`; [`design`] makes new ones, [`trace`] makes one from a view,
//! and [`sheet`] prints them.

mod bound;
pub mod check;
pub mod design;
pub mod sheet;
pub mod trace;
