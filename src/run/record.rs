//! The record thread: slots into the recording, and back to capture.

use std::sync::mpsc::{Receiver, SyncSender};

use crate::recording::record::{RecordError, Recorder, Summary};
use crate::slot::Slot;
use crate::status::tell;

/// What the record thread leaves.
pub(super) struct Recording {
    /// What the file holds.
    pub(super) summary: Summary,
    /// The first error, if there was one.
    pub(super) error: Option<RecordError>,
}

/// The record thread: writes slots as long as the file takes them, and gives all of them back.
pub(super) fn record(
    mut recorder: Recorder,
    queue: &Receiver<Slot>,
    to_capture: &SyncSender<Slot>,
) -> Recording {
    let mut first_error = None;
    let mut stopped = false;
    for slot in queue {
        if !stopped && let Err(error) = recorder.write(&slot) {
            // Said at once: whoever is there can make room, and the positions go on meanwhile.
            tell(format_args!("overcam: {error}"));
            stopped = error.is_final();
            first_error.get_or_insert(error);
        }
        drop(to_capture.try_send(slot));
    }
    let written = recorder.written();
    match recorder.finish() {
        Ok(summary) => Recording {
            summary,
            error: first_error,
        },
        Err(error) => {
            if !stopped {
                tell(format_args!("overcam: {error}"));
            }
            Recording {
                summary: written,
                error: first_error.or(Some(error)),
            }
        }
    }
}
