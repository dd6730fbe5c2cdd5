//! What a person sees of a running overcam: a line that says that it lives.
//!
//! On a terminal the line is renewed every second in place; elsewhere, in a log, a new one comes every ten seconds.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use scene::Scene;

const PERIOD_TERMINAL: Duration = Duration::from_secs(1);
const PERIOD_LOG: Duration = Duration::from_secs(10);

/// The line and what it sums up.
#[derive(Debug)]
pub(crate) struct Status {
    live: bool,
    terminal: bool,
    since: Instant,
    frames: u32,
    latency: Duration,
}

impl Status {
    /// Nothing seen so far. `live` says that latencies count from the exposure.
    pub(crate) fn new(live: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self {
            live,
            terminal,
            since: Instant::now(),
            frames: 0,
            latency: Duration::ZERO,
        }
    }

    /// Counts a scene, and shows the line when it is due.
    pub(crate) fn frame(&mut self, scene: &Scene, latency: Duration) {
        self.frames += 1;
        self.latency += latency;
        let elapsed = self.since.elapsed();
        if elapsed
            >= if self.terminal {
                PERIOD_TERMINAL
            } else {
                PERIOD_LOG
            }
        {
            self.show(scene, elapsed);
            self.since = Instant::now();
            self.frames = 0;
            self.latency = Duration::ZERO;
        }
    }

    fn show(&self, scene: &Scene, elapsed: Duration) {
        let rate = f64::from(self.frames) / elapsed.as_secs_f64();
        let latency_ms = 1e3 * self.latency.as_secs_f64() / f64::from(self.frames.max(1));
        let what = if self.live {
            "after exposure"
        } else {
            "to process"
        };
        let objects = scene.objects();
        let markers = objects
            .iter()
            .filter(|object| object.kind == scene::KIND_MARKER)
            .count();
        let obstacles = objects.len() - markers;
        let line = format!(
            "frame {}: {rate:.1} frames/s, {latency_ms:.1} ms {what}, {markers} marked, {obstacles} obstacles",
            scene.sequence
        );
        let (start, end) = if self.terminal {
            ("\r\x1b[K", "")
        } else {
            ("", "\n")
        };
        // A line that cannot be shown is no reason to stop.
        let _ = write!(std::io::stderr(), "{start}overcam: {line}{end}");
    }

    /// Says something in a line of its own.
    pub(crate) fn say(&self, message: &str) {
        self.clear();
        eprintln!("overcam: {message}");
    }

    /// Takes the line off a terminal.
    pub(crate) fn clear(&self) {
        if self.terminal {
            eprint!("\r\x1b[K");
        }
    }
}
