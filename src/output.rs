//! Outputs: JSON lines ([`json`], written by `lines`), shared memory ([`shared_memory`]), and MCAP
//! files ([`mcap`]) of Foxglove messages ([`foxglove`]).

pub mod foxglove;
pub mod json;
pub(crate) mod lines;
pub mod mcap;
pub mod shared_memory;
