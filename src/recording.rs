//! Recordings: frames, results and their making in an MCAP file.
//!
//! [`record`] writes one, [`series`] in several files, [`replay`] reads it back as a source of frames, and [`recover`] completes one that was cut off.
//! [`topics`] lists what is in it: frames are stored by [`image_message`], results are drawn by `annotate`, and [`provenance`] is what
//! a replay must know to give the same results. `records` reads the file's raw records, `foreign` makes sense of files of other
//! programs.

mod annotate;
mod foreign;
pub mod image_message;
pub mod provenance;
pub mod record;
mod records;
pub mod recover;
pub mod replay;
pub mod series;
pub mod topics;
