//! Frames and scenes as Foxglove messages, and the topics that they are on.

pub(crate) mod annotate;
pub mod image_message;
pub mod topics;
