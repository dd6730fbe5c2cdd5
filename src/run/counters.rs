//! Counters of the capture thread, read by all threads.

use std::sync::atomic::{AtomicBool, AtomicU64};

/// Counters of the capture thread, which may outlive the run: reading from a pipe cannot be
/// interrupted.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) captured: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) lost_by_driver: AtomicU64,
    pub(crate) faulty: AtomicU64,
    /// The camera is lost, and the run waits for it.
    pub(crate) is_waiting: AtomicBool,
}
