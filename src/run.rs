//! The main command: three threads and the slots passed between them.
//!
//! ```text
//!            free slots (16)
//!      ┌────────────────────────────────────────────┐
//!      ▼                                            │
//!   capture ──frames──▶ process ──frames, scenes──▶ record
//!   (thread)            (main)    at most 8 wait    (thread)
//!                         │
//!                         ├──▶ shared memory
//!                         └──lines──▶ standard output
//!                                     (thread, with --json)
//! ```
//!
//! A slot is owned by one thread at a time and moves by value; only counters are shared. With a
//! live camera, process takes the newest frame and skips the others, capture drops a frame if no
//! slot is free, and neither waits for the recorder: if its queue is full, a frame is lost from the
//! recording. With a file or the demo, every frame is processed and, on request, recorded.
//!
//! With a camera, a reader of standard output that stops reading does not block the run: lines are
//! dropped, counted and reported. With all other sources the run waits for the reader, until a
//! stop.
//!
//! Losses are counted where they occur, and the [counts](FrameCounts) are checked at the end.

pub(crate) mod capture;
pub(crate) mod counters;
mod frame_counts;
mod heartbeat;
pub(crate) mod notify;
mod outage;
mod pace;
mod process;
mod record;
pub(crate) mod setup;
pub mod slot;
pub mod status;
pub(crate) mod threads;

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use anyhow::Context;

use crate::cli::RunArgs;
use crate::output::lines::Lines;
use crate::output::mcap::series::Series;
use crate::output::shared_memory::Publisher;
use crate::run::capture::{Feed, Orders, open_source};
use crate::run::counters::Counters;
pub use crate::run::frame_counts::FrameCounts;
use crate::run::heartbeat::Heartbeat;
use crate::run::notify::Notify;
use crate::run::pace::Pace;
use crate::run::process::{Damage, ProcessStage, Sink};
use crate::run::record::{FloorRequest, Recording, record};
use crate::run::setup::Setup;
use crate::run::slot::Slot;
use crate::run::status::{Status, counted, log};
use crate::run::threads::{SLOTS, joined, spawn};
use crate::source::Source;

/// Maximum number of frames waiting for the recorder. All that a camera sent while one frame took
/// long come at once; a quarter of the slots remains for those that follow.
const RECORD_QUEUE: usize = SLOTS - SLOTS / 4;

/// How a run ended, apart from errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completion {
    /// Everything requested is done.
    Done,
    /// Done, but frames are missing from the recording.
    FramesLost,
}

/// Logs how a camera's mode differs from the requested one, and the state of its controls after the
/// start.
pub(crate) fn log_camera(source: &Source) {
    for note in source.notes() {
        log(format_args!("overcam: camera: {note}"));
    }
    let info = source.info();
    if let (true, Some(controls)) = (info.live, &info.controls) {
        log(format_args!("overcam: camera: {controls}"));
    }
}

/// Runs until the source ends, `stop` is set, or the requested number of frames is done. If
/// `relearn` is set, it is cleared and the empty floor is learned again. Scenes go to `out` as
/// JSON, on request; all messages for the user go to standard error.
///
/// # Errors
///
/// The reason in one line why the run could not start or the source failed. Frames captured before
/// are processed and recorded.
pub fn run(
    args: &RunArgs,
    stop: &Arc<AtomicBool>,
    relearn: &AtomicBool,
    out: impl Write + Send + 'static,
) -> anyhow::Result<Completion> {
    let Some(mut source) = open_source(&args.source, stop)? else {
        return Ok(Completion::Done);
    };
    let setup = Setup::new(args, &source)?;
    let publisher = if args.no_publish {
        None
    } else {
        Some(Publisher::open_for(&args.service, args.group.as_deref())?)
    };
    // After everything that takes time, so that the first frames are recent.
    source.start(stop)?;
    if stop.load(Ordering::Relaxed) {
        return Ok(Completion::Done);
    }
    let info = source.info();
    // Last, so that a run that cannot start leaves no file behind.
    let recorder = args
        .record
        .as_ref()
        .map(|path| {
            let (mode, limits) = (args.image_mode(), args.record_limits());
            Series::create(path, &info, &setup.provenance, mode, limits)
        })
        .transpose()?;
    setup.announce(args, &info);
    if let Some(remark) = publisher.as_ref().and_then(Publisher::remark) {
        log(format_args!("overcam: {remark}"));
    }
    log_camera(&source);

    let (message_sender, messages) = channel();
    let orders = Orders {
        live: info.live,
        limit: args.frames.unwrap_or(u64::MAX),
        waits: !args.no_wait,
    };
    let Feed {
        frames,
        free: to_capture,
        counters,
        thread: capture,
    } = Feed::start(source, orders, stop, message_sender.clone())?;
    let (sink, recording) = sink(recorder, to_capture, info.live, message_sender)?;
    let frame = setup.frame();
    let lines = args.json.then(|| Lines::start(out, !info.live));
    let mut stage = ProcessStage {
        live: info.live,
        setup,
        publisher,
        sink,
        status: Status::new(info.live),
        messages: &messages,
        notify: Notify::from_environment(),
        relearn,
        relearning: false,
        lines: lines
            .transpose()
            .context("the thread for standard output cannot start")?,
        n_scenes: 0,
        counts: FrameCounts::default(),
        light: scene::LIGHT_STEADY,
        heartbeat: Heartbeat::new(info.rate_hz, frame),
        pace: Pace::new(info.size, Instant::now()),
        counters: Arc::clone(&counters),
        capture_ended: false,
        damage: Damage::default(),
    };
    let processed = stage.run(&frames, stop);
    if processed.is_ok() && stage.n_scenes == 0 && stage.counts.processed > 0 {
        stage.explain_silence();
    }
    let (counts, capture_ended) = (stage.counts, stage.capture_ended);
    let n_damaged = stage.damage.count;
    // The recorder ends after the last slot sent to it.
    drop((frames, stage));
    let recorded = recording
        .map(|thread| joined(thread, "record"))
        .transpose()?;
    for message in messages.try_iter() {
        log(format_args!("overcam: {message}"));
    }
    let captured = if capture_ended {
        joined(capture, "capture")?
    } else {
        // It is left behind with the pipe that it reads.
        Ok(())
    };
    let counts = counts.with_capture(&counters, capture_ended);
    counters.faulty.fetch_add(n_damaged, Ordering::AcqRel);
    finish(
        counts,
        &counters,
        recorded,
        processed.and(captured.map_err(Into::into)),
    )
}

/// Destination of processed slots: the record thread, which is started here, or back to capture.
fn sink(
    recorder: Option<Series>,
    to_capture: SyncSender<Slot>,
    live: bool,
    messages: Sender<String>,
) -> anyhow::Result<(Sink, Option<JoinHandle<Recording>>)> {
    let Some(recorder) = recorder else {
        return Ok((Sink::Free(to_capture), None));
    };
    let (to_record, queue) = sync_channel(RECORD_QUEUE);
    let request = Arc::new(FloorRequest::none());
    let thread = spawn("record", {
        let (back, request) = (to_capture.clone(), Arc::clone(&request));
        move || record(recorder, &queue, &back, &request, &messages)
    })?;
    let sink = Sink::Recorder {
        to_record,
        to_capture,
        wait: !live,
        request,
    };
    Ok((sink, Some(thread)))
}

/// Checks and reports the counts, and determines how the run ended.
fn finish(
    mut counts: FrameCounts,
    counters: &Counters,
    recording: Option<Recording>,
    result: anyhow::Result<()>,
) -> anyhow::Result<Completion> {
    let mut report = String::new();
    if let Some(recording) = &recording {
        // Frames passed to the recorder that did not get into the file.
        let lost = counts.recorded.saturating_sub(recording.summary.frames);
        counts.recorded -= lost;
        counts.unrecorded += lost;
        let megabytes = recording.summary.bytes as f64 / 1e6;
        report = format!(
            "; {} ({megabytes:.1} MB) in {}",
            counted(counts.recorded, "frame"),
            recording.files
        );
        if counts.unrecorded > 0 {
            report += &format!(", {} lost from it", counts.unrecorded);
        }
    }
    assert!(counts.balance(), "frames are unaccounted for: {counts:?}");
    let FrameCounts {
        captured,
        dropped,
        processed,
        skipped,
        ..
    } = counts;
    let (lost, faulty) = (
        counters.lost_by_driver.load(Ordering::Acquire),
        counters.faulty.load(Ordering::Acquire),
    );
    let camera = match (lost, faulty) {
        (0, 0) => String::new(),
        (0, faulty) => format!(", {faulty} faulty"),
        (lost, faulty) => format!(", {lost} lost by the driver, {faulty} faulty"),
    };
    log(format_args!(
        "overcam: {}: {processed} processed, {skipped} passed over, {dropped} dropped{camera}{report}",
        counted(captured, "frame")
    ));
    result?;
    let lost_from_recording =
        counts.unrecorded > 0 || recording.is_some_and(|recording| recording.error.is_some());
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
    fn counts_balance_only_when_every_frame_is_somewhere() {
        let counts = FrameCounts {
            captured: 10,
            dropped: 1,
            processed: 7,
            skipped: 2,
            recorded: 8,
            unrecorded: 1,
        };
        assert!(counts.balance());
        assert!(
            !FrameCounts {
                captured: 11,
                ..counts
            }
            .balance()
        );
        assert!(
            !FrameCounts {
                recorded: 7,
                ..counts
            }
            .balance()
        );
    }

    #[test]
    fn a_capture_thread_that_is_left_behind_does_not_upset_the_counts() {
        let counters = Counters::default();
        // The thread has just captured a frame that is never received.
        counters.captured.store(8, Ordering::Release);
        let counts = FrameCounts {
            processed: 5,
            skipped: 2,
            recorded: 7,
            ..FrameCounts::default()
        };
        let left_behind = counts.with_capture(&counters, false);
        assert!(left_behind.balance() && left_behind.captured == 7);
        assert!(!counts.with_capture(&counters, true).balance());
    }
}
