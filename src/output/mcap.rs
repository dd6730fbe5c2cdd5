//! MCAP files: [`record`] writes one, [`series`] several in sequence, [`recover`] repairs a
//! truncated one. [`provenance`] describes how a recording was made.
//! [`replay`](crate::source::replay) reads recordings.

pub(crate) mod channels;
pub mod provenance;
pub mod record;
pub(crate) mod records;
pub mod recover;
pub mod series;

use std::fs::File;
use std::io::BufWriter;

use ::mcap::write::NoSeek;

/// A file being written.
pub(crate) type Mcap = ::mcap::Writer<NoSeek<BufWriter<File>>>;
