//! The process thread, which is the main thread: frames through the pipeline, scenes to planners
//! and to standard output.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError};
use std::time::{Duration, Instant};

use anyhow::Context;

use crate::clock::monotonic_ns;
use crate::image::frame::DecodeError;
use crate::output::json;
use crate::output::lines::Lines;
use crate::output::shared_memory::Publisher;
use crate::pipeline::Outcome;
use crate::run::counters::Counters;
use crate::run::frame_counts::FrameCounts;
use crate::run::heartbeat::Heartbeat;
use crate::run::notify::Notify;
use crate::run::pace::{Pace, Totals};
use crate::run::record::FloorRequest;
use crate::run::setup::Setup;
use crate::run::slot::Slot;
use crate::run::status::{Status, counted, is_broken_pipe};
use crate::run::threads::POLL;

/// State of the process thread.
pub(super) struct ProcessStage<'a> {
    pub(super) live: bool,
    pub(super) setup: Setup,
    pub(super) publisher: Option<Publisher>,
    pub(super) sink: Sink,
    pub(super) status: Status,
    /// Messages of other threads.
    pub(super) messages: &'a Receiver<String>,
    pub(super) notify: Notify,
    /// Set from outside to request that the floor is learned again.
    pub(super) relearn: &'a AtomicBool,
    /// The floor is being learned again.
    pub(super) relearning: bool,
    /// The writer to standard output, with `--json`.
    pub(super) lines: Option<Lines>,
    pub(super) n_scenes: u64,
    pub(super) counts: FrameCounts,
    /// Illumination of the previous scene.
    pub(super) light: u32,
    /// Scenes published while a camera delivers no frames.
    pub(super) heartbeat: Heartbeat,
    /// Checks whether a camera's frames are processed fast enough.
    pub(super) pace: Pace,
    pub(super) counters: Arc<Counters>,
    /// Every frame from capture has been received. Otherwise capture is blocked on a silent pipe.
    pub(super) capture_ended: bool,
    pub(super) damage: Damage,
}

/// Frames that could not be decoded.
#[derive(Debug, Default)]
pub(super) struct Damage {
    pub(super) count: u64,
    /// The error of the first one.
    first: Option<anyhow::Error>,
}

/// Maximum number of such frames reported individually.
const REPORTED_MAX: u64 = 10;

/// After this many polls without a frame since the stop, capture is considered blocked on a silent
/// pipe.
const SILENT_POLLS: u32 = 3;

impl ProcessStage<'_> {
    /// Processes frames until there are no more. Frames left after an error are skipped, so that
    /// the counts balance.
    ///
    /// A stop ends capture, which ends this: until then a frame may be on its way. Only a pipe can
    /// block capture forever; then this does not wait, and later frames are not part of the run.
    pub(super) fn run(&mut self, frames: &Receiver<Slot>, stop: &AtomicBool) -> anyhow::Result<()> {
        let mut result = Ok(());
        let mut silent_polls = 0;
        self.notify.started();
        loop {
            let counts = &self.counts;
            let status = || format!("{} frames processed", counts.processed);
            self.notify.alive(status);
            let slot = match frames.recv_timeout(POLL) {
                Ok(slot) => slot,
                Err(RecvTimeoutError::Disconnected) => {
                    self.capture_ended = true;
                    break;
                }
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => {
                    silent_polls += 1;
                    if !self.live && silent_polls == SILENT_POLLS {
                        break;
                    }
                    continue;
                }
                Err(RecvTimeoutError::Timeout) => {
                    if result.is_ok() {
                        result = self.while_waiting(stop);
                    }
                    if result.is_err() {
                        stop.store(true, Ordering::Relaxed);
                    }
                    continue;
                }
            };
            silent_polls = 0;
            if result.is_err() {
                self.skip(slot);
                continue;
            }
            let slot = self.newest(slot, frames);
            result = self.process(slot, stop);
            if result.is_err() {
                stop.store(true, Ordering::Relaxed);
            }
        }
        self.notify.stopping();
        let printed = self.finish_lines(stop);
        self.pass_on();
        self.status.clear();
        if result.is_ok()
            && self.counts.processed == 0
            && let (false, Some(error)) = (self.live, self.damage.first.take())
        {
            result = Err(error);
        }
        match result.and(printed) {
            // The reader of the lines has closed the pipe, which is not an error.
            Err(error) if is_broken_pipe(&error) => Ok(()),
            result => result,
        }
    }

    /// From a camera, the newest available frame; older ones are skipped.
    fn newest(&mut self, mut slot: Slot, frames: &Receiver<Slot>) -> Slot {
        while self.live
            && let Ok(newer) = frames.try_recv()
        {
            self.skip(slot);
            slot = newer;
        }
        slot
    }

    fn skip(&mut self, mut slot: Slot) {
        slot.skipped = true;
        slot.floor_in_use = None;
        self.counts.skipped += 1;
        self.sink.take(slot, &mut self.counts);
    }

    fn process(&mut self, mut slot: Slot, stop: &AtomicBool) -> anyhow::Result<()> {
        if slot.skipped {
            self.skip(slot);
            return Ok(());
        }
        let started = Instant::now();
        self.heartbeat
            .frame(slot.frame.sequence, slot.frame.stamp_ns, started);
        self.pass_on();
        self.setup.choose_background(&mut slot);
        slot.floor_in_use = if self.sink.wants_floor(&self.counts) {
            self.setup.pipeline.floor()
        } else {
            None
        };
        let outcome = match self.setup.pipeline.process(&mut slot) {
            Ok(outcome) => outcome,
            Err(error) => {
                self.skip_damaged(slot, error);
                return Ok(());
            }
        };
        self.counts.processed += 1;
        if let Some((seen, of)) = self.setup.pipeline.learning_progress() {
            self.status.learning("the empty floor", seen, of);
        }
        self.update_relearning(slot.frame.sequence);
        let mut result = Ok(());
        if outcome == Outcome::Scene {
            self.n_scenes += 1;
            self.report_light(&slot.scene);
            self.heartbeat.light(&slot.scene);
            result = self.deliver(&mut slot, stop);
            let since_exposure = monotonic_ns().saturating_sub(slot.frame.stamp_ns);
            let latency = if self.live {
                Duration::from_nanos(since_exposure)
            } else {
                started.elapsed()
            };
            self.status.frame(&slot.scene, latency);
        }
        self.sink.take(slot, &mut self.counts);
        self.report_pace(started);
        result
    }

    /// Reports that a camera is faster than the processing, while it is.
    fn report_pace(&mut self, started: Instant) {
        let now = Instant::now();
        self.pace.processed(now - started);
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let totals = Totals {
            captured: count(&self.counters.captured),
            skipped: self.counts.skipped + count(&self.counters.dropped),
            lost_by_driver: count(&self.counters.lost_by_driver),
            processed: self.counts.processed,
        };
        if self.live
            && let Some(message) = self.pace.look(totals, now)
        {
            self.status.report(&message);
        }
    }

    fn skip_damaged(&mut self, slot: Slot, error: DecodeError) {
        let sequence = slot.frame.sequence;
        self.damage.count += 1;
        if self.damage.count <= REPORTED_MAX {
            self.status
                .report(&format!("frame {sequence} is passed over: {error}"));
        }
        if self.damage.count == REPORTED_MAX {
            self.status
                .report("further such frames are counted at the end only");
        }
        if self.damage.first.is_none() {
            let source = &self.setup.provenance.source;
            let error = anyhow::Error::new(error);
            self.damage.first = Some(error.context(format!("{source}: frame {sequence}")));
        }
        self.skip(slot);
    }

    /// Reports changes of illumination, darkness and its end.
    fn report_light(&mut self, scene: &scene::Scene) {
        let before = std::mem::replace(&mut self.light, scene.light);
        let message = match (before, scene.light) {
            (scene::LIGHT_DARK, scene::LIGHT_DARK) => return,
            (_, scene::LIGHT_DARK) => "it is too dark to see anything",
            (scene::LIGHT_DARK, _) => "it is light again",
            (scene::LIGHT_STEADY, scene::LIGHT_CHANGED) => {
                "the light has changed; new objects are withheld for a moment"
            }
            _ => return,
        };
        self.status
            .report(&format!("frame {}: {message}", scene.sequence));
    }

    /// Starts to learn the floor again if requested, and reports when it is in use.
    fn update_relearning(&mut self, sequence: u64) {
        let pipeline = &mut self.setup.pipeline;
        if self.relearning && !pipeline.is_learning() {
            self.relearning = false;
            self.status.report(&format!(
                "the empty floor was learned again; it is used from frame {sequence} on"
            ));
        }
        if !self.relearn.swap(false, Ordering::Relaxed) {
            return;
        }
        if pipeline.is_learning() {
            self.status
                .report("the empty floor is already being learned; learning continues");
            return;
        }
        pipeline.relearn();
        self.relearning = true;
        self.status.report(&format!(
            "learning the empty floor again from the {} after frame {sequence}; the old one is used meanwhile",
            counted(u64::from(self.setup.settings.learn), "frame")
        ));
    }

    /// Publishes the scene to planners and prints it.
    fn deliver(&mut self, slot: &mut Slot, stop: &AtomicBool) -> anyhow::Result<()> {
        slot.scene.clock = if self.live {
            scene::CLOCK_MONOTONIC
        } else {
            scene::CLOCK_SOURCE
        };
        self.publish(&slot.scene, stop)
    }

    fn publish(&mut self, scene: &scene::Scene, stop: &AtomicBool) -> anyhow::Result<()> {
        if let Some(publisher) = &mut self.publisher
            && let Err(error) = publisher.send(scene)
        {
            self.status.report(&error.to_string());
        }
        if let Some(lines) = &mut self.lines {
            lines
                .print(stop, |line| json::write_line(scene, line))
                .context("standard output")?;
            if let Some(message) = lines.report() {
                self.status.report(&message);
            }
        }
        Ok(())
    }

    /// Waits for the reader of standard output, if it still reads, and reports what it missed.
    fn finish_lines(&mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        let Some(mut lines) = self.lines.take() else {
            return Ok(());
        };
        let n_missing = lines.finish(stop).context("standard output")?;
        if n_missing > 0 {
            self.status.report(&format!(
                "standard output was not read in time: {n_missing} lines are missing"
            ));
        }
        Ok(())
    }

    /// Reported if there were frames and no results.
    pub(super) fn explain_silence(&self) {
        self.status.report(&format!(
            "no results: all {} went into learning the empty floor; learn from fewer with --learn N, \
             or give a picture of it with --background FILE",
            counted(self.counts.processed, "frame")
        ));
    }

    /// Reports the messages of other threads.
    fn pass_on(&self) {
        self.messages
            .try_iter()
            .for_each(|message| self.status.report(&message));
    }

    /// Called while no frame arrives.
    fn while_waiting(&mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        self.pass_on();
        if let Some(publisher) = &mut self.publisher
            && let Err(error) = publisher.serve_late_joiners()
        {
            self.status.report(&error.to_string());
        }
        let is_lost = self.counters.is_waiting.load(Ordering::Acquire);
        if self.live
            && let Some(scene) = self.heartbeat.due(is_lost, Instant::now(), monotonic_ns())
        {
            let scene = *scene;
            self.publish(&scene, stop)?;
        }
        Ok(())
    }
}

/// Destination of slots after processing.
#[derive(Debug)]
pub(super) enum Sink {
    /// Back to capture.
    Free(SyncSender<Slot>),
    /// To the recorder, which returns them; waits for it only if the source is not a camera.
    Recorder {
        to_record: SyncSender<Slot>,
        to_capture: SyncSender<Slot>,
        wait: bool,
        request: Arc<FloorRequest>,
    },
}

impl Sink {
    /// Whether the next slot must contain the current background.
    fn wants_floor(&self, counts: &FrameCounts) -> bool {
        match self {
            Self::Free(_) => false,
            Self::Recorder { request, .. } => request.holds(counts.recorded),
        }
    }

    /// Passes a slot on and counts it.
    fn take(&self, slot: Slot, counts: &mut FrameCounts) {
        let (rejected, to_capture) = match self {
            Self::Free(to_capture) => {
                counts.recorded += 1;
                (Some(slot), to_capture)
            }
            Self::Recorder {
                to_record,
                to_capture,
                wait,
                ..
            } => {
                let sent = if *wait {
                    to_record.send(slot).map_err(|rejected| rejected.0)
                } else {
                    to_record.try_send(slot).map_err(|error| match error {
                        TrySendError::Full(slot) | TrySendError::Disconnected(slot) => slot,
                    })
                };
                match sent {
                    Ok(()) => counts.recorded += 1,
                    Err(_) => counts.unrecorded += 1,
                }
                (sent.err(), to_capture)
            }
        };
        if let Some(slot) = rejected {
            // The channel has room for all slots; capture may already have ended.
            drop(to_capture.try_send(slot));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use crate::run::threads::SLOTS;
    use crate::source::Source;
    use clap::Parser;
    use std::sync::mpsc::sync_channel;

    /// Result of a stopped stage for a frame that arrives `late` polls after the stop, optionally
    /// followed by the end of capture: whether it saw capture end, and its counts.
    fn stopped_stage(live: bool, late: u32, capture_ends: bool) -> (bool, FrameCounts) {
        let Cli { run: args, .. } = Cli::parse_from(["overcam"]);
        let source = Source::open(&args.source.device, &args.source.request()).expect("the demo");
        let (to_capture, _free) = sync_channel(SLOTS);
        let (_sender, messages) = std::sync::mpsc::channel();
        let (relearn, stop) = (AtomicBool::new(false), AtomicBool::new(true));
        let mut stage = ProcessStage {
            live,
            setup: Setup::new(&args, &source).expect("the defaults are right"),
            publisher: None,
            sink: Sink::Free(to_capture),
            status: Status::new(live),
            messages: &messages,
            notify: Notify::from_environment(),
            relearn: &relearn,
            relearning: false,
            lines: None,
            n_scenes: 0,
            counts: FrameCounts::default(),
            light: scene::LIGHT_STEADY,
            heartbeat: Heartbeat::new(None, scene::FRAME_IMAGE),
            pace: Pace::new(source.info().size, Instant::now()),
            counters: Arc::default(),
            damage: Damage::default(),
            capture_ended: false,
        };
        let (to_process, frames) = sync_channel(SLOTS);
        let (to_test, kept) = sync_channel(1);
        let capture = std::thread::spawn(move || {
            std::thread::sleep(late * POLL + POLL / 2);
            let mut slot = Slot::empty();
            slot.skipped = true;
            drop(to_process.send(slot));
            if !capture_ends {
                drop(to_test.send(to_process));
            }
        });
        stage.run(&frames, &stop).expect("no frame is processed");
        let result = (stage.capture_ended, stage.counts);
        drop(frames);
        capture.join().expect("it ends");
        drop(kept);
        result
    }

    #[test]
    fn a_frame_that_comes_after_the_stop_is_counted() {
        for live in [true, false] {
            for late in [0, 1, 2] {
                let (capture_ended, counts) = stopped_stage(live, late, true);
                assert!(capture_ended);
                assert_eq!((counts.skipped, counts.recorded), (1, 1), "{live}, {late}");
            }
        }
    }

    #[test]
    fn a_camera_is_waited_for_and_a_silent_pipe_is_not() {
        let (capture_ended, counts) = stopped_stage(true, 6, true);
        assert!(capture_ended);
        assert_eq!(counts.skipped, 1);
        let (capture_ended, counts) = stopped_stage(false, 6, false);
        assert!(!capture_ended);
        assert_eq!(counts, FrameCounts::default());
    }

    #[test]
    fn a_full_recorder_costs_a_frame_of_the_recording_and_no_slot() {
        let (to_record, queue) = sync_channel(1);
        let (to_capture, free) = sync_channel(SLOTS);
        let sink = Sink::Recorder {
            to_record,
            to_capture,
            wait: false,
            request: Arc::new(FloorRequest::none()),
        };
        let mut counts = FrameCounts::default();
        (0..3).for_each(|_| sink.take(Slot::empty(), &mut counts));
        assert_eq!((counts.recorded, counts.unrecorded), (1, 2));
        assert_eq!((queue.try_iter().count(), free.try_iter().count()), (1, 2));
    }
}
