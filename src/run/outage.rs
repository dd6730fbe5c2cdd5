//! Loss of a running camera, and waiting for its return.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use crate::camera::Loss;
use crate::run::counters::Counters;
use crate::source::{Source, SourceError};

/// Time between two attempts. The kernel creates the device node within about half a second after
/// plugging in.
const RETRY: Duration = Duration::from_millis(100);
/// Delay before reporting why the camera cannot be used yet: right after plugging in, the ownership
/// of the node is not yet set.
const REPORT_DELAY: Duration = Duration::from_secs(3);

/// Whether a camera is lost, and what has been reported.
#[derive(Debug)]
pub(super) struct Outage<'a> {
    /// To the thread that writes the status line.
    messages: &'a Sender<String>,
    since: Option<Instant>,
    /// Why it cannot be used yet, since when, and whether that was reported.
    refusal: Option<(String, Instant, bool)>,
}

impl<'a> Outage<'a> {
    pub(super) fn new(messages: &'a Sender<String>) -> Self {
        Self {
            messages,
            since: None,
            refusal: None,
        }
    }

    fn report(&self, message: String) {
        // At the end of a run the receiver may be gone.
        drop(self.messages.send(message));
    }

    /// The camera is lost, possibly again before it delivered a frame. Reported once.
    pub(super) fn begin(&mut self, loss: &Loss, counters: &Counters) {
        if self.since.is_none() {
            self.since = Some(Instant::now());
            self.report(format!(
                "{loss}: waiting for it to come back; until then nothing is seen"
            ));
        }
        counters.is_waiting.store(true, Ordering::Release);
    }

    /// A frame has arrived.
    pub(super) fn end(&mut self, sequence: u64, source: &Source, counters: &Counters) {
        let Some(since) = self.since.take() else {
            return;
        };
        self.refusal = None;
        counters.is_waiting.store(false, Ordering::Release);
        self.report(format!(
            "the camera is back after {:.1} s; frame {sequence} is its first, and the floor is the one of before",
            since.elapsed().as_secs_f64()
        ));
        if let Some(controls) = source.info().controls {
            self.report(format!("camera: {controls}"));
        }
    }

    /// Retries until the camera is open again (true) or `stop` is set. It may still deliver no
    /// frames.
    pub(super) fn wait(&mut self, source: &mut Source, stop: &AtomicBool) -> bool {
        while !stop.load(Ordering::Relaxed) {
            match source.resume() {
                Ok(()) => return true,
                Err(error) => self.refused(&error),
            }
            std::thread::sleep(RETRY);
        }
        false
    }

    fn refused(&mut self, error: &SourceError) {
        if error.is_missing_camera() {
            self.refusal = None;
            return;
        }
        let text = error.to_string();
        match &mut self.refusal {
            Some((last, since, is_reported)) if *last == text => {
                if *is_reported || since.elapsed() < REPORT_DELAY {
                    return;
                }
                *is_reported = true;
            }
            refusal => {
                *refusal = Some((text, Instant::now(), false));
                return;
            }
        }
        self.report(format!("still waiting: {text}"));
    }
}
