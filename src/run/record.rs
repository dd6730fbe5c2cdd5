//! The record thread: slots into the recording, and back to capture.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender};

use crate::output::mcap::record::{RecordError, Summary};
use crate::output::mcap::series::{NextFile, Series};
use crate::run::slot::Slot;
use crate::run::status::counted;
use crate::run::threads::SLOTS;

/// Frames' time after which it is said how large the recording grows.
const MEASURED_NS: u64 = 10_000_000_000;

/// What the record thread leaves.
pub(super) struct Recording {
    /// What the files hold.
    pub(super) summary: Summary,
    /// Where they are, for people to read.
    pub(super) files: String,
    /// The first error, if there was one.
    pub(super) error: Option<RecordError>,
}

/// What the recorder wants of the process thread to begin a new file: the floor that is in use.
#[derive(Debug)]
pub(super) struct FloorRequest {
    /// Counted from the first slot that went to the recorder: the first that is to bring it.
    from_slot: AtomicU64,
}

impl FloorRequest {
    pub(super) fn none() -> Self {
        Self {
            from_slot: AtomicU64::new(u64::MAX),
        }
    }

    /// Whether the next slot, after so many, is to bring the floor.
    pub(super) fn holds(&self, n_slots: u64) -> bool {
        n_slots >= self.from_slot.load(Ordering::Relaxed)
    }

    /// Wishes for it, or not any more, when slot number `slot` has come.
    fn set(&self, slot: u64, is_due: bool) {
        let wished = self.from_slot.load(Ordering::Relaxed) != u64::MAX;
        if is_due != wished {
            // So late that no slot on its way is meant: then the same frame brings it each time the same input comes.
            let from_slot = if is_due {
                slot + SLOTS as u64 + 1
            } else {
                u64::MAX
            };
            self.from_slot.store(from_slot, Ordering::Relaxed);
        }
    }
}

/// The record thread: writes slots as long as the files take them, and gives all of them back. What is to be said goes to `say`, as the
/// process thread has the terminal.
pub(super) fn record(
    mut series: Series,
    queue: &Receiver<Slot>,
    to_capture: &SyncSender<Slot>,
    request: &FloorRequest,
    say: &Sender<String>,
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
                    let said = next_file.as_ref().map(next_file_text);
                    for message in said.into_iter().chain(grown) {
                        drop(say.send(message));
                    }
                }
                // Said at once: whoever is there can make room, and the positions go on meanwhile.
                Err(error) => {
                    drop(say.send(error.to_string()));
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
                drop(say.send(error.to_string()));
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

/// How fast a recording grows.
#[derive(Debug)]
struct Growth {
    bytes_at_start: u64,
    first_stamp_ns: Option<u64>,
    told: bool,
}

impl Growth {
    fn new(start: Summary) -> Self {
        Self {
            bytes_at_start: start.bytes,
            first_stamp_ns: None,
            told: false,
        }
    }

    /// What is to be said of it, once.
    fn look(&mut self, written: &Summary, stamp_ns: u64) -> Option<String> {
        let since_ns = stamp_ns.saturating_sub(*self.first_stamp_ns.get_or_insert(stamp_ns));
        if self.told || since_ns < MEASURED_NS {
            return None;
        }
        self.told = true;
        let bytes = written.bytes.saturating_sub(self.bytes_at_start) as f64;
        let megabytes = bytes / 1e6 * 60e9 / since_ns as f64;
        Some(format!("the recording takes {megabytes:.0} MB a minute"))
    }
}
