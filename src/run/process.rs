//! The process thread, which is the main one: frames through the pipeline, scenes to planners and to standard output.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError};
use std::time::{Duration, Instant};

use anyhow::Context;

use crate::frame::DecodeError;
use crate::json;
use crate::pipeline::Outcome;
use crate::publish::{Publisher, monotonic_ns};
use crate::run::{Books, POLL};
use crate::setup::Setup;
use crate::slot::Slot;
use crate::status::Status;

/// What the process thread works with.
pub(super) struct ProcessStage<'a, W> {
    pub(super) live: bool,
    pub(super) json: bool,
    pub(super) setup: Setup,
    pub(super) publisher: Option<Publisher>,
    pub(super) sink: Sink,
    pub(super) status: Status,
    /// Set from outside when the floor is to be learned anew.
    pub(super) relearn: &'a AtomicBool,
    /// The floor is being learned anew.
    pub(super) relearning: bool,
    pub(super) out: &'a mut W,
    pub(super) line: Vec<u8>,
    pub(super) n_scenes: u64,
    pub(super) books: Books,
    /// Of the scene before.
    pub(super) light: u32,
    pub(super) damage: Damage,
}

/// Frames that no picture could be made of.
#[derive(Debug, Default)]
pub(super) struct Damage {
    pub(super) count: u64,
    /// Why that was so of the first one.
    first: Option<anyhow::Error>,
}

/// Most such frames that are told one by one.
const TOLD_MAX: u64 = 10;

impl<W: Write> ProcessStage<'_, W> {
    /// Processes frames until no more come. Frames that are left after an error are passed over, so that the books balance.
    pub(super) fn run(&mut self, frames: &Receiver<Slot>, stop: &AtomicBool) -> anyhow::Result<()> {
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
        if result.is_ok()
            && self.books.processed == 0
            && let (false, Some(error)) = (self.live, self.damage.first.take())
        {
            result = Err(error);
        }
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
            Err(error) => {
                self.pass_over_damaged(slot, error);
                return Ok(());
            }
        };
        self.books.processed += 1;
        self.look_after_relearning(slot.frame.sequence);
        let mut result = Ok(());
        if outcome == Outcome::Scene {
            self.n_scenes += 1;
            self.tell_light(&slot.scene);
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

    fn pass_over_damaged(&mut self, slot: Slot, error: DecodeError) {
        let sequence = slot.frame.sequence;
        self.damage.count += 1;
        if self.damage.count <= TOLD_MAX {
            self.status
                .say(&format!("frame {sequence} is passed over: {error}"));
        }
        if self.damage.count == TOLD_MAX {
            self.status
                .say("further such frames are counted at the end only");
        }
        if self.damage.first.is_none() {
            let source = &self.setup.provenance.source;
            let error = anyhow::Error::new(error);
            self.damage.first = Some(error.context(format!("{source}: frame {sequence}")));
        }
        self.pass_over(slot);
    }

    /// Says when the light changes, goes out or comes back.
    fn tell_light(&mut self, scene: &scene::Scene) {
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
            .say(&format!("frame {}: {message}", scene.sequence));
    }

    /// Starts to learn the floor anew if that was asked for, and says when it is in use.
    fn look_after_relearning(&mut self, sequence: u64) {
        let pipeline = &mut self.setup.pipeline;
        if self.relearning && !pipeline.is_learning() {
            self.relearning = false;
            self.status.say(&format!(
                "the empty floor was learned anew; it is used from frame {sequence} on"
            ));
        }
        if !self.relearn.swap(false, Ordering::Relaxed) {
            return;
        }
        if pipeline.is_learning() {
            self.status
                .say("the empty floor is being learned already; that goes on");
            return;
        }
        pipeline.relearn();
        self.relearning = true;
        self.status.say(&format!(
            "learning the empty floor anew from the {} frames after frame {sequence}; the old one is used meanwhile",
            self.setup.settings.learn
        ));
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
    pub(super) fn explain_silence(&self) {
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

/// Where slots go after processing.
#[derive(Debug)]
pub(super) enum Sink {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::SLOTS;
    use std::sync::mpsc::sync_channel;

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
