//! Frames and scenes as Foxglove messages, and their topics.

pub(crate) mod annotate;
pub mod image_message;
pub mod topics;
