//! The record thread: writes slots to the recording and returns them to capture.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender};

use crate::output::mcap::record::{RecordError, Summary};
use crate::output::mcap::series::{NextFile, Series};
use crate::run::slot::Slot;
use crate::run::status::counted;
use crate::run::threads::SLOTS;

/// Recorded time after which the growth rate of the recording is reported.
const MEASURED_NS: u64 = 10_000_000_000;

/// Result of the record thread.
pub(super) struct Recording {
    /// Content of the files.
    pub(super) summary: Summary,
    /// Their paths, for messages.
    pub(super) files: String,
    /// The first error, if any.
    pub(super) error: Option<RecordError>,
}

/// Request of the recorder to the process thread for the current background, to start a new file.
#[derive(Debug)]
pub(super) struct FloorRequest {
    /// Index of the first slot that must contain it, counted from the first slot sent to the
    /// recorder.
    from_slot: AtomicU64,
}

impl FloorRequest {
    pub(super) fn none() -> Self {
        Self {
            from_slot: AtomicU64::new(u64::MAX),
        }
    }

    /// Whether the slot after `n_slots` must contain the background.
    pub(super) fn holds(&self, n_slots: u64) -> bool {
        n_slots >= self.from_slot.load(Ordering::Relaxed)
    }

    /// Sets or clears the request after slot number `slot` has arrived.
    fn set(&self, slot: u64, is_due: bool) {
        let is_requested = self.from_slot.load(Ordering::Relaxed) != u64::MAX;
        if is_due != is_requested {
            // Later than all slots on their way, so that for the same input always the same frame
            // contains it.
            let from_slot = if is_due {
                slot + SLOTS as u64 + 1
            } else {
                u64::MAX
            };
            self.from_slot.store(from_slot, Ordering::Relaxed);
        }
    }
}

/// The record thread: writes slots as long as the files accept them, and returns all of them.
/// Messages go to `messages`, since the process thread owns the terminal.
pub(super) fn record(
    mut series: Series,
    queue: &Receiver<Slot>,
    to_capture: &SyncSender<Slot>,
    request: &FloorRequest,
    messages: &Sender<String>,
) -> Recording {
    let mut first_error = None;
    let mut stopped = false;
    let mut growth = Growth::new(series.written());
    for (number, mut slot) in (0..).zip(queue) {
        if !stopped {
            request.set(number, series.is_due(&slot));
            match series.write(&mut slot) {
                Ok(next_file) => {
                    let grown = growth.look(&series.written(), slot.frame.stamp_ns);
                    let new_file = next_file.as_ref().map(next_file_text);
                    for message in new_file.into_iter().chain(grown) {
                        drop(messages.send(message));
                    }
                }
                // Reported immediately, so that the user can free space; positions continue
                // meanwhile.
                Err(error) => {
                    drop(messages.send(error.to_string()));
                    stopped = error.is_final();
                    first_error.get_or_insert(error);
                }
            }
        }
        drop(to_capture.try_send(slot));
    }
    let written = series.written();
    let files = match series.n_files() {
        1 => series.newest().display().to_string(),
        n => format!("{n} files, the last {}", series.newest().display()),
    };
    let (summary, error) = match series.finish() {
        Ok(summary) => (summary, first_error),
        Err(error) => {
            if !stopped {
                drop(messages.send(error.to_string()));
            }
            (written, first_error.or(Some(error)))
        }
    };
    Recording {
        summary,
        files,
        error,
    }
}

fn next_file_text(next: &NextFile) -> String {
    format!(
        "recording goes on in {}; {} is complete: {}, {:.1} MB",
        next.path.display(),
        next.finished.display(),
        counted(next.summary.frames, "frame"),
        next.summary.bytes as f64 / 1e6
    )
}

/// Growth rate of a recording.
#[derive(Debug)]
struct Growth {
    bytes_at_start: u64,
    first_stamp_ns: Option<u64>,
    is_reported: bool,
}

impl Growth {
    fn new(start: Summary) -> Self {
        Self {
            bytes_at_start: start.bytes,
            first_stamp_ns: None,
            is_reported: false,
        }
    }

    /// The message about it, once.
    fn look(&mut self, written: &Summary, stamp_ns: u64) -> Option<String> {
        let since_ns = stamp_ns.saturating_sub(*self.first_stamp_ns.get_or_insert(stamp_ns));
        if self.is_reported || since_ns < MEASURED_NS {
            return None;
        }
        self.is_reported = true;
        let bytes = written.bytes.saturating_sub(self.bytes_at_start) as f64;
        let megabytes = bytes / 1e6 * 60e9 / since_ns as f64;
        Some(format!("the recording takes {megabytes:.0} MB a minute"))
    }
}
