//! The main job: three threads and the slots that travel between them.
//!
//! ```text
//!            free slots (16)
//!      ┌────────────────────────────────────────────┐
//!      ▼                                            │
//!   capture ──frames──▶ process ──frames, scenes──▶ record
//!   (thread)            (main)    at most 8 wait    (thread)
//!                         │
//!                         ├──▶ shared memory
//!                         └──▶ standard output
//! ```
//!
//! A slot is owned by one thread at a time and moves by value; nothing is shared but counters. From a live camera, process takes the
//! newest frame and passes the others over, capture drops a frame for which no slot is free, and neither waits for the
//! recorder: a frame that finds its queue full is lost from the recording. From a file or the demo nobody is in a hurry: every frame
//! is processed and, where asked for, recorded.
//!
//! A shortage is counted where it happens, and the [books](Books) are checked at the end.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel,
};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;

use crate::cli::RunArgs;
use crate::json;
use crate::pipeline::Outcome;
use crate::publish::{Publisher, monotonic_ns};
use crate::recording::record::{RecordError, Recorder, Summary};
use crate::setup::Setup;
use crate::slot::{Next, Slot};
use crate::source::{Source, SourceError};
use crate::status::{Status, tell};

/// Slots in all. With 8, a slow process stage and a stalled recorder together lost frames; with 16 they lost none.
const SLOTS: usize = 16;

/// Frames that may wait for the recorder.
const RECORD_QUEUE: usize = 8;

/// Longest wait before the stop flag and late subscribers are looked after.
const POLL: Duration = Duration::from_millis(100);

/// How a run ended, apart from errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completion {
    /// Everything that was asked for is done.
    Done,
    /// Done, but frames are missing from the recording.
    FramesLost,
}

/// What became of the frames of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Books {
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

impl Books {
    /// Whether every frame is accounted for exactly once.
    #[must_use]
    pub fn balance(&self) -> bool {
        self.captured == self.dropped + self.processed + self.skipped
            && self.processed + self.skipped == self.recorded + self.unrecorded
    }
}

/// Locates until the source ends, `stop` is set, or as many frames as asked for are done. Scenes go to `out` as JSON, if
/// asked for; all else that a person reads goes to standard error.
///
/// # Errors
///
/// What kept the run from starting, or the source from going on, in one line. Frames taken before are processed and
/// recorded.
pub fn run(
    args: &RunArgs,
    stop: &Arc<AtomicBool>,
    out: &mut impl Write,
) -> anyhow::Result<Completion> {
    let Some(mut source) = open_source(args, stop)? else {
        return Ok(Completion::Done);
    };
    let info = source.info();
    let setup = Setup::new(args, &source)?;
    let publisher = if args.no_publish {
        None
    } else {
        Some(Publisher::open(&args.service)?)
    };
    // After all that takes time, lest the first frames are old.
    source.start()?;
    // Last, so that a run that cannot start leaves no file behind.
    let recorder = args
        .record
        .as_ref()
        .map(|path| Recorder::create(path, &info, &setup.provenance, args.image_mode()))
        .transpose()?;
    setup.announce(args, &info);

    let (to_process, frames) = sync_channel(SLOTS);
    let (to_capture, free) = sync_channel(SLOTS);
    (0..SLOTS).for_each(|_| drop(to_capture.try_send(Slot::empty())));
    let counters = Arc::new(Counters::default());
    let capture = spawn("capture", {
        let (counters, stop, limit) = (
            Arc::clone(&counters),
            Arc::clone(stop),
            args.frames.unwrap_or(u64::MAX),
        );
        move || {
            capture(
                source,
                info.live,
                limit,
                &free,
                &to_process,
                &stop,
                &counters,
            )
        }
    })?;
    let (sink, recording) = match recorder {
        None => (Sink::Free(to_capture), None),
        Some(recorder) => {
            let (to_record, queue) = sync_channel(RECORD_QUEUE);
            let back = to_capture.clone();
            let thread = spawn("record", move || record(recorder, &queue, &back))?;
            (
                Sink::Recorder {
                    to_record,
                    to_capture,
                    wait: !info.live,
                },
                Some(thread),
            )
        }
    };
    let mut stage = ProcessStage {
        live: info.live,
        json: args.json,
        setup,
        publisher,
        sink,
        status: Status::new(info.live),
        out,
        line: Vec::new(),
        n_scenes: 0,
        books: Books::default(),
    };
    let processed = stage.run(&frames, stop);
    if processed.is_ok() && stage.n_scenes == 0 && stage.books.processed > 0 {
        stage.explain_silence();
    }
    let mut books = stage.books;
    // The recorder ends with the last slot that is sent to it, and capture when nobody takes its frames.
    drop((frames, stage));
    let recorded = recording
        .map(|thread| joined(thread, "record"))
        .transpose()?;
    let captured = joined_unless_blocked(capture, stop)?;
    books.captured = counters.captured.load(Ordering::Acquire);
    books.dropped = counters.dropped.load(Ordering::Acquire);
    finish(
        books,
        &counters,
        recorded,
        args,
        processed.and(captured.map_err(Into::into)),
    )
}

/// Opens the source on a thread of its own, as a pipe may be silent for long before its header comes. `None`: stopped before.
fn open_source(args: &RunArgs, stop: &AtomicBool) -> anyhow::Result<Option<Source>> {
    let (to_run, opened) = sync_channel(1);
    let (device, wish) = (args.device.clone(), args.wish());
    let opening = spawn("open", move || {
        drop(to_run.send(Source::open(&device, &wish)));
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

/// Counters of the capture thread, which may outlive the run: reading from a pipe cannot be interrupted.
#[derive(Debug, Default)]
struct Counters {
    captured: AtomicU64,
    dropped: AtomicU64,
    lost_by_driver: AtomicU64,
    faulty: AtomicU64,
}

/// The capture thread: takes frames from the source into free slots.
fn capture(
    mut source: Source,
    live: bool,
    limit: u64,
    free: &Receiver<Slot>,
    to_process: &SyncSender<Slot>,
    stop: &AtomicBool,
    counters: &Counters,
) -> Result<(), SourceError> {
    // One slot is always at hand: a camera's frame is taken even when there is no room for it, lest the driver stalls.
    let mut slot = Slot::empty();
    let mut taken = 0;
    while taken < limit && !stop.load(Ordering::Relaxed) {
        let next = source.next(&mut slot);
        if let Some(camera) = source.camera_counters() {
            counters
                .lost_by_driver
                .store(camera.lost_by_driver, Ordering::Release);
            counters.faulty.store(camera.faulty, Ordering::Release);
        }
        match next? {
            Next::Frame => taken += 1,
            Next::Nothing => continue,
            Next::End => break,
        }
        let room = if live {
            free.try_recv()
        } else {
            free.recv().map_err(|_| TryRecvError::Disconnected)
        };
        match room {
            Ok(room) => {
                // Counted first, so that no one ever sees more frames than were captured.
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

/// Where slots go after processing.
#[derive(Debug)]
enum Sink {
    /// Back to capture.
    Free(SyncSender<Slot>),
    /// To the recorder, which gives them back; waiting for it only where no camera goes on meanwhile.
    Recorder {
        to_record: SyncSender<Slot>,
        to_capture: SyncSender<Slot>,
        wait: bool,
    },
}

impl Sink {
    /// Passes a slot on and enters it in the books.
    fn take(&self, slot: Slot, books: &mut Books) {
        let (rejected, to_capture) = match self {
            Self::Free(to_capture) => {
                books.recorded += 1;
                (Some(slot), to_capture)
            }
            Self::Recorder {
                to_record,
                to_capture,
                wait,
            } => {
                let sent = if *wait {
                    to_record.send(slot).map_err(|rejected| rejected.0)
                } else {
                    to_record.try_send(slot).map_err(|error| match error {
                        TrySendError::Full(slot) | TrySendError::Disconnected(slot) => slot,
                    })
                };
                match sent {
                    Ok(()) => books.recorded += 1,
                    Err(_) => books.unrecorded += 1,
                }
                (sent.err(), to_capture)
            }
        };
        if let Some(slot) = rejected {
            // There is room for all slots; capture may have ended and wants none.
            drop(to_capture.try_send(slot));
        }
    }
}

/// What the process thread works with.
struct ProcessStage<'a, W> {
    live: bool,
    json: bool,
    setup: Setup,
    publisher: Option<Publisher>,
    sink: Sink,
    status: Status,
    out: &'a mut W,
    line: Vec<u8>,
    n_scenes: u64,
    books: Books,
}

impl<W: Write> ProcessStage<'_, W> {
    /// Processes frames until no more come. Frames that are left after an error are passed over, so that the books balance.
    fn run(&mut self, frames: &Receiver<Slot>, stop: &AtomicBool) -> anyhow::Result<()> {
        let mut result = Ok(());
        loop {
            let slot = match frames.recv_timeout(POLL) {
                Ok(slot) => slot,
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => break,
                Err(RecvTimeoutError::Timeout) => {
                    self.while_waiting();
                    continue;
                }
            };
            if result.is_err() {
                self.pass_over(slot);
                continue;
            }
            let slot = self.newest(slot, frames);
            result = self.process(slot);
            if result.is_err() {
                stop.store(true, Ordering::Relaxed);
            }
        }
        self.status.clear();
        match result {
            // Whoever read our lines has seen enough.
            Err(error) if is_broken_pipe(&error) => Ok(()),
            result => result,
        }
    }

    /// From a camera, the newest frame there is; those before it are passed over.
    fn newest(&mut self, mut slot: Slot, frames: &Receiver<Slot>) -> Slot {
        while self.live
            && let Ok(newer) = frames.try_recv()
        {
            self.pass_over(slot);
            slot = newer;
        }
        slot
    }

    fn pass_over(&mut self, mut slot: Slot) {
        slot.passed_over = true;
        self.books.skipped += 1;
        self.sink.take(slot, &mut self.books);
    }

    fn process(&mut self, mut slot: Slot) -> anyhow::Result<()> {
        if slot.passed_over {
            self.pass_over(slot);
            return Ok(());
        }
        let started = Instant::now();
        self.setup.choose_background(&mut slot);
        let outcome = match self.setup.pipeline.process(&mut slot) {
            Ok(outcome) => outcome,
            Err(error) if self.live => {
                self.status.say(&format!(
                    "frame {} is passed over: {error}",
                    slot.frame.sequence
                ));
                self.pass_over(slot);
                return Ok(());
            }
            Err(error) => {
                let sequence = slot.frame.sequence;
                self.pass_over(slot);
                let source = &self.setup.provenance.source;
                return Err(error).with_context(|| format!("{source}: frame {sequence}"));
            }
        };
        self.books.processed += 1;
        let mut result = Ok(());
        if outcome == Outcome::Scene {
            self.n_scenes += 1;
            result = self.deliver(&mut slot);
            let since_exposure = monotonic_ns().saturating_sub(slot.frame.stamp_ns);
            let latency = if self.live {
                Duration::from_nanos(since_exposure)
            } else {
                started.elapsed()
            };
            self.status.frame(&slot.scene, latency);
        }
        self.sink.take(slot, &mut self.books);
        result
    }

    /// Hands the scene to planners and prints it.
    fn deliver(&mut self, slot: &mut Slot) -> anyhow::Result<()> {
        slot.scene.clock = if self.live {
            scene::CLOCK_MONOTONIC
        } else {
            scene::CLOCK_SOURCE
        };
        if let Some(publisher) = &mut self.publisher
            && let Err(error) = publisher.send(&slot.scene)
        {
            self.status.say(&error.to_string());
        }
        if self.json {
            self.line.clear();
            json::write_line(&slot.scene, &mut self.line)?;
            self.out
                .write_all(&self.line)
                .and_then(|()| self.out.flush())
                .context("standard output")?;
        }
        Ok(())
    }

    /// To be said when there were frames and no results.
    fn explain_silence(&self) {
        self.status.say(&format!(
            "no results: all {} frames went into learning the empty floor; learn from fewer with --learn N, \
             or give a picture of it with --background FILE",
            self.books.processed
        ));
    }

    /// What is to be done when no frame comes.
    fn while_waiting(&mut self) {
        if let Some(publisher) = &self.publisher
            && let Err(error) = publisher.serve_late_joiners()
        {
            self.status.say(&error.to_string());
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error
        .chain()
        .find_map(|cause| cause.downcast_ref::<io::Error>());
    io.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// What the record thread leaves.
struct Recording {
    /// What the file holds.
    summary: Summary,
    /// The first error, if there was one.
    error: Option<RecordError>,
}

/// The record thread: writes slots as long as the file takes them, and gives all of them back.
fn record(
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

fn spawn<T: Send + 'static>(
    name: &str,
    body: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<JoinHandle<T>> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(body)
        .with_context(|| format!("the {name} thread cannot start"))
}

fn joined<T>(thread: JoinHandle<T>, name: &str) -> anyhow::Result<T> {
    thread.join().map_err(|_| {
        anyhow::anyhow!("the {name} thread ended by a fault of the program; please report it")
    })
}

/// The result of the capture thread. If the run was stopped, it may be waiting for a pipe that stays silent; it is left behind then.
fn joined_unless_blocked(
    thread: JoinHandle<Result<(), SourceError>>,
    stop: &AtomicBool,
) -> anyhow::Result<Result<(), SourceError>> {
    let patience = Instant::now() + 3 * POLL;
    while stop.load(Ordering::Relaxed) && !thread.is_finished() && Instant::now() < patience {
        std::thread::sleep(POLL / 20);
    }
    if stop.load(Ordering::Relaxed) && !thread.is_finished() {
        return Ok(Ok(()));
    }
    joined(thread, "capture")
}

/// Checks the books, says what they hold, and decides how the run ended.
fn finish(
    mut books: Books,
    counters: &Counters,
    recording: Option<Recording>,
    args: &RunArgs,
    result: anyhow::Result<()>,
) -> anyhow::Result<Completion> {
    let mut report = String::new();
    if let Some(recording) = &recording {
        // Frames handed to the recorder that did not get into the file.
        let lost = books.recorded.saturating_sub(recording.summary.frames);
        books.recorded -= lost;
        books.unrecorded += lost;
        let megabytes = recording.summary.bytes as f64 / 1e6;
        let path = args
            .record
            .as_ref()
            .map(|path| path.display().to_string())
            .unwrap_or_default();
        report = format!("; {} frames ({megabytes:.1} MB) in {path}", books.recorded);
        if books.unrecorded > 0 {
            report += &format!(", {} lost from it", books.unrecorded);
        }
    }
    assert!(books.balance(), "frames are unaccounted for: {books:?}");
    let Books {
        captured,
        dropped,
        processed,
        skipped,
        ..
    } = books;
    let (lost, faulty) = (
        counters.lost_by_driver.load(Ordering::Acquire),
        counters.faulty.load(Ordering::Acquire),
    );
    let camera = if lost + faulty > 0 {
        format!(", {lost} lost by the driver, {faulty} faulty")
    } else {
        String::new()
    };
    tell(format_args!(
        "overcam: {captured} frames: {processed} processed, {skipped} passed over, {dropped} dropped{camera}{report}"
    ));
    result?;
    let lost_from_recording =
        books.unrecorded > 0 || recording.is_some_and(|recording| recording.error.is_some());
    Ok(if lost_from_recording {
        Completion::FramesLost
    } else {
        Completion::Done
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn books_balance_only_when_every_frame_is_somewhere() {
        let books = Books {
            captured: 10,
            dropped: 1,
            processed: 7,
            skipped: 2,
            recorded: 8,
            unrecorded: 1,
        };
        assert!(books.balance());
        assert!(
            !Books {
                captured: 11,
                ..books
            }
            .balance()
        );
        assert!(
            !Books {
                recorded: 7,
                ..books
            }
            .balance()
        );
    }

    #[test]
    fn a_full_recorder_costs_a_frame_of_the_recording_and_no_slot() {
        let (to_record, queue) = sync_channel(1);
        let (to_capture, free) = sync_channel(SLOTS);
        let sink = Sink::Recorder {
            to_record,
            to_capture,
            wait: false,
        };
        let mut books = Books::default();
        (0..3).for_each(|_| sink.take(Slot::empty(), &mut books));
        assert_eq!((books.recorded, books.unrecorded), (1, 2));
        assert_eq!((queue.try_iter().count(), free.try_iter().count()), (1, 2));
    }
}
