//! Frame counts of a run, by the fate of each frame.

use std::sync::atomic::Ordering;

use crate::run::counters::Counters;

/// Number of frames of a run, by fate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Received from the source.
    pub captured: u64,
    /// Dropped because no slot was free.
    pub dropped: u64,
    /// Processed by the pipeline.
    pub processed: u64,
    /// Skipped for a newer one, or undecodable.
    pub skipped: u64,
    /// Written to the recording; without one, all frames that reached this point.
    pub recorded: u64,
    /// Lost from the recording.
    pub unrecorded: u64,
}

impl FrameCounts {
    /// Whether every frame is accounted for exactly once.
    #[must_use]
    pub fn balance(&self) -> bool {
        self.captured == self.dropped + self.processed + self.skipped
            && self.processed + self.skipped == self.recorded + self.unrecorded
    }

    /// Adds the counts of the capture thread. If it was left behind, it may still count; then the
    /// number of frames received from it is used.
    pub(super) fn with_capture(self, counters: &Counters, capture_ended: bool) -> Self {
        let dropped = counters.dropped.load(Ordering::Acquire);
        let captured = if capture_ended {
            counters.captured.load(Ordering::Acquire)
        } else {
            dropped + self.processed + self.skipped
        };
        Self {
            captured,
            dropped,
            ..self
        }
    }
}
