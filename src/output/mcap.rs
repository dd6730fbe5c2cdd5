//! MCAP files: [`record`] writes one, [`series`] several after each other, [`recover`] mends one that was cut off. What a recording says of
//! its making is [`provenance`]. [`replay`](crate::source::replay) reads them.

pub(crate) mod channels;
pub mod provenance;
pub mod record;
pub(crate) mod records;
pub mod recover;
pub mod series;

use std::fs::File;
use std::io::BufWriter;

use ::mcap::write::NoSeek;

/// A file that is being written.
pub(crate) type Mcap = ::mcap::Writer<NoSeek<BufWriter<File>>>;
