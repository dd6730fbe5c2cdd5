//! A camera that is lost while it runs, and what is done until it is back.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use crate::camera::Loss;
use crate::run::counters::Counters;
use crate::source::{Source, SourceError};

/// From one try to the next. The kernel makes a node within about half a second of the plug.
const RETRY: Duration = Duration::from_millis(100);
/// A reason why the camera cannot be used yet is said when it has lasted so long: for a moment after the plug nodes belong to nobody.
const PATIENCE: Duration = Duration::from_secs(3);

/// Whether a camera is lost, and what has been said of it.
#[derive(Debug)]
pub(super) struct Outage<'a> {
    /// To the thread that writes the status line.
    say: &'a Sender<String>,
    since: Option<Instant>,
    /// Why it cannot be used yet, since when, and whether that was said.
    refusal: Option<(String, Instant, bool)>,
}

impl<'a> Outage<'a> {
    pub(super) fn new(say: &'a Sender<String>) -> Self {
        Self {
            say,
            since: None,
            refusal: None,
        }
    }

    fn tell(&self, message: String) {
        // Nobody listens at the end of a run.
        drop(self.say.send(message));
    }

    /// The camera is lost, again perhaps before it gave a frame. Said once.
    pub(super) fn begin(&mut self, loss: &Loss, counters: &Counters) {
        if self.since.is_none() {
            self.since = Some(Instant::now());
            self.tell(format!(
                "{loss}: waiting for it to come back; until then nothing is seen"
            ));
        }
        counters.is_waiting.store(true, Ordering::Release);
    }

    /// A frame has come.
    pub(super) fn end(&mut self, sequence: u64, source: &Source, counters: &Counters) {
        let Some(since) = self.since.take() else {
            return;
        };
        self.refusal = None;
        counters.is_waiting.store(false, Ordering::Release);
        self.tell(format!(
            "the camera is back after {:.1} s; frame {sequence} is its first, and the floor is the one of before",
            since.elapsed().as_secs_f64()
        ));
        if let Some(controls) = source.info().controls {
            self.tell(format!("camera: {controls}"));
        }
    }

    /// Tries until the camera is open again (true) or `stop` is set. Whether frames come then is another matter.
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
            Some((last, since, is_said)) if *last == text => {
                if *is_said || since.elapsed() < PATIENCE {
                    return;
                }
                *is_said = true;
            }
            refusal => {
                *refusal = Some((text, Instant::now(), false));
                return;
            }
        }
        self.tell(format!("still waiting: {text}"));
    }
}
