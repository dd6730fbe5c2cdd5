//! The capture thread: opens the source and captures frames into free slots.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use crate::camera::CameraError;
use crate::cli::SourceArgs;
use crate::run::counters::Counters;
use crate::run::outage::Outage;
use crate::run::slot::{Next, Slot};
use crate::run::threads::{POLL, SLOTS, joined, spawn};
use crate::source::{Source, SourceError};

/// Opens the source on a thread of its own, because a pipe may be silent for a long time before its
/// header arrives. `None` if stopped before.
pub(crate) fn open_source(args: &SourceArgs, stop: &AtomicBool) -> anyhow::Result<Option<Source>> {
    let (to_run, opened) = sync_channel(1);
    let (device, request) = (args.device.clone(), args.request());
    let opening = spawn("open", move || {
        drop(to_run.send(Source::open(&device, &request)));
    })?;
    loop {
        match opened.recv_timeout(POLL) {
            Ok(source) => return Ok(Some(source?)),
            Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Ok(None),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return joined(opening, "open").map(|()| None),
        }
    }
}

/// What the capture thread does with the source.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Orders {
    /// Frames arrive whether or not they are consumed.
    pub(crate) live: bool,
    /// Maximum number of frames.
    pub(crate) limit: u64,
    /// Wait for a camera that is lost.
    pub(crate) waits: bool,
}

/// A source with a running capture thread.
pub(crate) struct Feed {
    /// Frames, in the order of arrival.
    pub(crate) frames: Receiver<Slot>,
    /// Returns slots to be filled again.
    pub(crate) free: SyncSender<Slot>,
    pub(crate) counters: Arc<Counters>,
    /// Ends with the source, or when the other three are dropped.
    pub(crate) thread: JoinHandle<Result<(), SourceError>>,
}

impl Feed {
    /// Starts the capture thread with all its slots. Messages for the user go to `messages`.
    pub(crate) fn start(
        source: Source,
        orders: Orders,
        stop: &Arc<AtomicBool>,
        messages: Sender<String>,
    ) -> anyhow::Result<Self> {
        let (to_process, frames) = sync_channel(SLOTS);
        let (to_capture, free) = sync_channel(SLOTS);
        (0..SLOTS).for_each(|_| drop(to_capture.try_send(Slot::empty())));
        let counters = Arc::new(Counters::default());
        let thread = spawn("capture", {
            let (counters, stop) = (Arc::clone(&counters), Arc::clone(stop));
            move || {
                capture(
                    source,
                    orders,
                    &free,
                    &to_process,
                    &stop,
                    &counters,
                    &messages,
                )
            }
        })?;
        Ok(Self {
            frames,
            free: to_capture,
            counters,
            thread,
        })
    }
}

/// The capture thread: captures frames from the source into free slots. Messages for the user go to
/// `messages`.
fn capture(
    mut source: Source,
    orders: Orders,
    free: &Receiver<Slot>,
    to_process: &SyncSender<Slot>,
    stop: &AtomicBool,
    counters: &Counters,
    messages: &Sender<String>,
) -> Result<(), SourceError> {
    // One slot is always available: a camera's frame is captured even if there is no room for it,
    // so that the driver does not stall.
    let mut slot = Slot::empty();
    let mut n_captured = 0;
    let mut outage = Outage::new(messages);
    while n_captured < orders.limit && !stop.load(Ordering::Relaxed) {
        let next = source.next(&mut slot);
        if let Some(camera) = source.camera_counters() {
            counters
                .lost_by_driver
                .store(camera.lost_by_driver, Ordering::Release);
            counters.faulty.store(camera.faulty, Ordering::Release);
        }
        let next = match next {
            Err(SourceError::Camera(CameraError::Lost { loss })) if orders.waits => {
                outage.begin(&loss, counters);
                if outage.wait(&mut source, stop) {
                    continue;
                }
                break;
            }
            next => next?,
        };
        match next {
            Next::Frame => n_captured += 1,
            Next::Nothing => continue,
            Next::End => break,
        }
        outage.end(slot.frame.sequence, &source, counters);
        let room = if orders.live {
            free.try_recv()
        } else {
            free.recv().map_err(|_| TryRecvError::Disconnected)
        };
        match room {
            Ok(room) => {
                // Counted first, so that no thread ever sees more frames than were captured.
                counters.captured.fetch_add(1, Ordering::Release);
                let full = std::mem::replace(&mut slot, room);
                if to_process.send(full).is_err() {
                    counters.captured.fetch_sub(1, Ordering::Release);
                    break;
                }
            }
            Err(TryRecvError::Empty) => {
                counters.captured.fetch_add(1, Ordering::Release);
                counters.dropped.fetch_add(1, Ordering::Release);
            }
            Err(TryRecvError::Disconnected) => break,
        }
    }
    Ok(())
}

/// The result of the capture thread. After a stop, it may be blocked on a silent pipe; it is then
/// left behind.
pub(crate) fn joined_unless_blocked(
    thread: JoinHandle<Result<(), SourceError>>,
    stop: &AtomicBool,
) -> anyhow::Result<Result<(), SourceError>> {
    let deadline = Instant::now() + 3 * POLL;
    while stop.load(Ordering::Relaxed) && !thread.is_finished() && Instant::now() < deadline {
        std::thread::sleep(POLL / 20);
    }
    if stop.load(Ordering::Relaxed) && !thread.is_finished() {
        return Ok(Ok(()));
    }
    joined(thread, "capture")
}
