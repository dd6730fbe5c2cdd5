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

pub mod background;
mod capture;
mod process;
mod record;

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;

use crate::cli::RunArgs;
use crate::publish::Publisher;
use crate::recording::record::Recorder;
use crate::run::capture::{Counters, capture, joined_unless_blocked, open_source};
use crate::run::process::{Damage, ProcessStage, Sink};
use crate::run::record::{Recording, record};
use crate::setup::Setup;
use crate::slot::{Slot, SourceInfo};
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

/// Says what became of a camera's controls when it was started.
fn tell_controls(info: &SourceInfo) {
    if let (true, Some(controls)) = (info.live, &info.controls) {
        tell(format_args!("overcam: camera: {controls}"));
    }
}

/// Locates until the source ends, `stop` is set, or as many frames as asked for are done. When `relearn` is set, it is taken back and
/// the empty floor is learned anew. Scenes go to `out` as JSON, if
/// asked for; all else that a person reads goes to standard error.
///
/// # Errors
///
/// What kept the run from starting, or the source from going on, in one line. Frames taken before are processed and
/// recorded.
pub fn run(
    args: &RunArgs,
    stop: &Arc<AtomicBool>,
    relearn: &AtomicBool,
    out: &mut impl Write,
) -> anyhow::Result<Completion> {
    let Some(mut source) = open_source(&args.source, stop)? else {
        return Ok(Completion::Done);
    };
    let setup = Setup::new(args, &source)?;
    let publisher = if args.no_publish {
        None
    } else {
        Some(Publisher::open(&args.service)?)
    };
    // After all that takes time, lest the first frames are old.
    source.start(stop)?;
    if stop.load(Ordering::Relaxed) {
        return Ok(Completion::Done);
    }
    let info = source.info();
    // Last, so that a run that cannot start leaves no file behind.
    let recorder = args
        .record
        .as_ref()
        .map(|path| Recorder::create(path, &info, &setup.provenance, args.image_mode()))
        .transpose()?;
    setup.announce(args, &info);
    tell_controls(&info);

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
        relearn,
        relearning: false,
        out,
        line: Vec::new(),
        n_scenes: 0,
        books: Books::default(),
        light: scene::LIGHT_STEADY,
        damage: Damage::default(),
    };
    let processed = stage.run(&frames, stop);
    if processed.is_ok() && stage.n_scenes == 0 && stage.books.processed > 0 {
        stage.explain_silence();
    }
    let (mut books, n_damaged) = (stage.books, stage.damage.count);
    // The recorder ends with the last slot that is sent to it, and capture when nobody takes its frames.
    drop((frames, stage));
    let recorded = recording
        .map(|thread| joined(thread, "record"))
        .transpose()?;
    let captured = if info.live {
        // A camera blocks nobody for long, and its controls are put back at the end.
        joined(capture, "capture")?
    } else {
        joined_unless_blocked(capture, stop)?
    };
    books.captured = counters.captured.load(Ordering::Acquire);
    books.dropped = counters.dropped.load(Ordering::Acquire);
    counters.faulty.fetch_add(n_damaged, Ordering::AcqRel);
    finish(
        books,
        &counters,
        recorded,
        args,
        processed.and(captured.map_err(Into::into)),
    )
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
    let camera = match (lost, faulty) {
        (0, 0) => String::new(),
        (0, faulty) => format!(", {faulty} faulty"),
        (lost, faulty) => format!(", {lost} lost by the driver, {faulty} faulty"),
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
}
