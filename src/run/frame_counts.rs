//! The books of a run: what became of every frame.

use std::sync::atomic::Ordering;

use crate::run::counters::Counters;

/// What became of the frames of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Taken from the source.
    pub captured: u64,
    /// Thrown away because no slot was free.
    pub dropped: u64,
    /// Went through the pipeline.
    pub processed: u64,
    /// Passed over for a newer one, or no readable picture.
    pub skipped: u64,
    /// Written to the recording; all of those that came by, when there is none.
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

    /// Enters what capture counted. One that was left behind may still count: the run ends with the frames that came from it.
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
