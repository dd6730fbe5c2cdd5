//! What a person sees of a running overcam on standard error: a line that says that it lives, and the line of an error.
//!
//! On a terminal the line is renewed every second in place; elsewhere, in a log, a new one comes every ten seconds.

use std::fmt;
use std::io::{self, IsTerminal, Write};
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
        put(format_args!("{start}overcam: {line}{end}"));
    }

    /// Says something in a line of its own.
    pub(crate) fn say(&self, message: &str) {
        self.clear();
        tell(format_args!("overcam: {message}"));
    }

    /// Takes the line off a terminal.
    pub(crate) fn clear(&self) {
        if self.terminal {
            put(format_args!("\r\x1b[K"));
        }
    }
}

/// An error with its causes, in one line. Most errors name their cause in their own words; it is not repeated then.
#[must_use]
pub fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if line.is_empty() {
            line = cause;
        } else if !line.contains(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line
}

/// Whether the reader of standard output has gone: it has seen enough, and nothing failed.
#[must_use]
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error
        .chain()
        .find_map(|cause| cause.downcast_ref::<io::Error>());
    io.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// Writes a line to standard error.
pub fn tell(line: fmt::Arguments<'_>) {
    put(format_args!("{line}\n"));
}

/// A text that cannot be shown, because its reader has gone or the disk of a log is full, is no reason to stop: `eprint!` would
/// panic.
fn put(text: fmt::Arguments<'_>) {
    let _ = std::io::stderr().write_fmt(text);
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn an_error_names_each_cause_once() {
        let says_all = anyhow!("no such file").context("a.png cannot be read: no such file");
        assert_eq!(one_line(&says_all), "a.png cannot be read: no such file");
        let says_part = anyhow!("no such file").context("a.png cannot be read");
        assert_eq!(one_line(&says_part), "a.png cannot be read: no such file");
    }
}
