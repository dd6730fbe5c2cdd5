//! What a person sees of a running overcam on standard error: a line that says that it lives, and the line of an error.
//!
//! On a terminal the line is renewed every second in place, and is never wider than the terminal; elsewhere, in a log, a new one
//! comes every ten seconds. A terminal that is called dumb, or whose user set `NO_COLOR`, gets what a log gets: no escape sequences.
//!
//! Rate and latency are those of the results since the line before. What was stopped by Ctrl-Z counts neither as time nor as latency.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use scene::Scene;
use signal_hook::consts::SIGCONT;

const PERIOD_TERMINAL: Duration = Duration::from_secs(1);
const PERIOD_LOG: Duration = Duration::from_secs(10);
/// Between two lines that tell how far learning is.
const LEARNING_PERIOD_TERMINAL: Duration = Duration::from_millis(200);
const LEARNING_PERIOD_LOG: Duration = Duration::from_secs(5);
/// Widest line, columns; also that of a terminal that does not tell its width.
const COLUMNS_MAX: usize = 60;

/// The line and what it sums up.
#[derive(Debug)]
pub(crate) struct Status {
    terminal: bool,
    meter: Meter,
    /// Set by a signal when the program goes on after Ctrl-Z.
    resumed: Arc<AtomicBool>,
    /// When it was last told how far learning is.
    learning_told: Option<Instant>,
    /// What stands on the terminal now; empty: nothing.
    shown: String,
}

impl Status {
    /// Nothing seen so far. `live` says that latencies count from the exposure.
    pub(crate) fn new(live: bool) -> Self {
        let resumed = Arc::new(AtomicBool::new(false));
        // Without the signal only the first line after Ctrl-Z is wrong.
        let _ = signal_hook::flag::register(SIGCONT, Arc::clone(&resumed));
        let terminal = can_redraw(&std::io::stderr()) && !no_color();
        Self {
            terminal,
            meter: Meter::new(
                live,
                if terminal {
                    PERIOD_TERMINAL
                } else {
                    PERIOD_LOG
                },
            ),
            resumed,
            learning_told: None,
            shown: String::new(),
        }
    }

    /// Counts a scene, and shows the line when it is due.
    pub(crate) fn frame(&mut self, scene: &Scene, latency: Duration) {
        let now = Instant::now();
        self.look_after_resumption(now);
        let Some(figures) = self.meter.add(now, latency) else {
            return;
        };
        // The floor is being learned anew, which is told more often.
        let is_learning = self
            .learning_told
            .is_some_and(|told| now - told < PERIOD_TERMINAL);
        if !(self.terminal && is_learning) {
            self.show(text(scene, figures, self.columns()));
        }
    }

    /// Tells how many frames `what` was learned from, of how many.
    pub(crate) fn learning(&mut self, what: &str, seen: u32, of: u32) {
        let now = Instant::now();
        self.look_after_resumption(now);
        let period = if self.terminal {
            LEARNING_PERIOD_TERMINAL
        } else {
            LEARNING_PERIOD_LOG
        };
        let is_due = match self.learning_told {
            Some(told) => now - told >= period,
            // In a log, learning that is soon over is not worth a line.
            None => self.terminal,
        };
        if is_due {
            let line = format!("overcam: learning {what}: {seen} of {of}");
            self.show(cut(line, self.columns()));
        }
        if is_due || self.learning_told.is_none() {
            self.learning_told = Some(now);
        }
    }

    fn look_after_resumption(&mut self, now: Instant) {
        if self.resumed.swap(false, Ordering::Relaxed) {
            self.meter.restart(now);
            // The shell has written over it.
            self.draw();
        }
    }

    fn show(&mut self, line: String) {
        if self.terminal {
            self.shown = line;
            self.draw();
        } else {
            log(format_args!("{line}"));
        }
    }

    fn draw(&self) {
        if !self.shown.is_empty() {
            put(format_args!("\r\x1b[K{}", self.shown));
        }
    }

    /// Width that a line may have.
    fn columns(&self) -> usize {
        let width = if self.terminal {
            rustix::termios::tcgetwinsize(std::io::stderr().as_fd()).map_or(0, |size| size.ws_col)
        } else {
            0
        };
        match usize::from(width) {
            0 => COLUMNS_MAX,
            // In the last column some terminals wrap already.
            width => COLUMNS_MAX.min(width - 1),
        }
    }

    /// Says something in a line of its own.
    pub(crate) fn say(&self, message: &str) {
        if self.shown.is_empty() {
            log(format_args!("overcam: {message}"));
        } else {
            put(format_args!("\r\x1b[Kovercam: {message}\n{}", self.shown));
        }
    }

    /// Takes the line off a terminal.
    pub(crate) fn clear(&mut self) {
        if !self.shown.is_empty() {
            put(format_args!("\r\x1b[K"));
            self.shown.clear();
        }
    }
}

/// Whether a stream is a terminal on which text can be drawn over other text.
pub(crate) fn can_redraw(stream: &impl IsTerminal) -> bool {
    let term = std::env::var_os("TERM").unwrap_or_default();
    stream.is_terminal() && !term.is_empty() && term != "dumb"
}

/// Whether the user wants text without colours and the like: <https://no-color.org>.
fn no_color() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty())
}

/// `1 frame`, `2 frames`.
pub(crate) fn counted(n: u64, what: &str) -> String {
    let plural = if n == 1 { "" } else { "s" };
    format!("{n} {what}{plural}")
}

/// Rate and latency of the results since the last figures.
#[derive(Debug)]
struct Meter {
    live: bool,
    period: Duration,
    /// When the time began that the next figures are about: with a result, which itself does not count.
    since: Option<Instant>,
    resumed_at: Option<Instant>,
    frames: u32,
    latency: Duration,
}

/// What a line says of a time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Figures {
    live: bool,
    rate_hz: f64,
    latency_ms: f64,
}

impl Meter {
    fn new(live: bool, period: Duration) -> Self {
        Self {
            live,
            period,
            since: None,
            resumed_at: None,
            frames: 0,
            latency: Duration::ZERO,
        }
    }

    /// The program was stopped and goes on.
    fn restart(&mut self, now: Instant) {
        *self = Self {
            resumed_at: Some(now),
            ..Self::new(self.live, self.period)
        };
    }

    /// Counts a result; figures when they are due.
    fn add(&mut self, now: Instant, latency: Duration) -> Option<Figures> {
        // Exposed before the program was stopped, or in work then.
        if self.resumed_at.is_some_and(|at| latency > now - at) {
            return None;
        }
        let Some(since) = self.since else {
            self.since = Some(now);
            return None;
        };
        self.frames += 1;
        self.latency += latency;
        let elapsed = now - since;
        if elapsed < self.period {
            return None;
        }
        let figures = Figures {
            live: self.live,
            rate_hz: f64::from(self.frames) / elapsed.as_secs_f64(),
            latency_ms: 1e3 * self.latency.as_secs_f64() / f64::from(self.frames),
        };
        *self = Self {
            since: Some(now),
            resumed_at: self.resumed_at,
            ..Self::new(self.live, self.period)
        };
        Some(figures)
    }
}

/// The line, as much of it as fits: the latency's meaning goes first, then the program's name, then the frame's number.
fn text(scene: &Scene, figures: Figures, columns: usize) -> String {
    let objects = scene.objects();
    let markers = objects
        .iter()
        .filter(|object| object.kind == scene::KIND_MARKER)
        .count();
    let obstacles = objects.len() - markers;
    let number = |value: f64| {
        if value < 9.95 {
            format!("{value:.1}")
        } else {
            format!("{value:.0}")
        }
    };
    let frame = format!("frame {}: ", scene.sequence);
    let rate = format!(
        "{}/s, {} ms",
        number(figures.rate_hz),
        number(figures.latency_ms)
    );
    let meaning = if figures.live { " old" } else { " each" };
    let found = format!(", {markers} marked, {obstacles} obstacles");
    let lines = [
        ["overcam: ", &frame, &rate, meaning, &found],
        ["overcam: ", &frame, &rate, "", &found],
        ["", &frame, &rate, "", &found],
        ["", "", &rate, "", &found],
    ]
    .map(|parts| parts.concat());
    let fitting = lines.iter().find(|line| line.len() <= columns);
    cut(fitting.unwrap_or(&lines[3]).clone(), columns)
}

/// The start of a line that fits.
fn cut(mut line: String, columns: usize) -> String {
    if let Some((at, _)) = line.char_indices().nth(columns) {
        line.truncate(at);
    }
    line
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
pub fn log(line: fmt::Arguments<'_>) {
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

    const FRAME: Duration = Duration::from_millis(40);
    const LATENCY: Duration = Duration::from_millis(12);

    #[test]
    fn an_error_names_each_cause_once() {
        let says_all = anyhow!("no such file").context("a.png cannot be read: no such file");
        assert_eq!(one_line(&says_all), "a.png cannot be read: no such file");
        let says_part = anyhow!("no such file").context("a.png cannot be read");
        assert_eq!(one_line(&says_part), "a.png cannot be read: no such file");
    }

    /// Results at 25/s from a moment on; the last figures, and the moment after.
    fn second(meter: &mut Meter, mut now: Instant) -> (Option<Figures>, Instant) {
        let mut figures = None;
        for _ in 0..26 {
            figures = meter.add(now, LATENCY).or(figures);
            now += FRAME;
        }
        (figures, now)
    }

    fn assert_25(figures: Option<Figures>) {
        let figures = figures.expect("a second is over");
        assert!((figures.rate_hz - 25.0).abs() < 1e-6, "{figures:?}");
        assert!((figures.latency_ms - 12.0).abs() < 1e-6, "{figures:?}");
    }

    #[test]
    fn the_first_rate_is_that_of_the_results_and_not_of_the_time_before_them() {
        let mut meter = Meter::new(true, PERIOD_TERMINAL);
        let start = Instant::now();
        // A minute of learning.
        let (figures, now) = second(&mut meter, start + Duration::from_secs(60));
        assert_25(figures);
        // And later ones too.
        let (figures, _) = second(&mut meter, now);
        assert_25(figures);
    }

    #[test]
    fn a_stopped_time_spoils_neither_rate_nor_latency() {
        let hour = Duration::from_secs(3600);
        let mut meter = Meter::new(true, PERIOD_TERMINAL);
        let (_, now) = second(&mut meter, Instant::now());
        let resumed = now + hour;
        meter.restart(resumed);
        // What was under way when it was stopped.
        for n in 0..5 {
            let now = resumed + n * FRAME / 10;
            assert_eq!(meter.add(now, hour - n * FRAME), None);
        }
        let (figures, _) = second(&mut meter, resumed + FRAME);
        assert_25(figures);
    }

    #[test]
    fn a_line_fits_the_terminal_and_keeps_what_matters_most() {
        let mut scene = Scene::EMPTY;
        scene.sequence = 1_234_567;
        scene.n_objects = 16;
        for object in &mut scene.objects[..4] {
            object.kind = scene::KIND_MARKER;
        }
        let figures = Figures {
            live: true,
            rate_hz: 29.97,
            latency_ms: 12.4,
        };
        let line = |columns| text(&scene, figures, columns);
        assert_eq!(
            line(80),
            "overcam: frame 1234567: 30/s, 12 ms old, 4 marked, 12 obstacles"
        );
        assert_eq!(
            line(60),
            "overcam: frame 1234567: 30/s, 12 ms, 4 marked, 12 obstacles"
        );
        assert_eq!(line(40), "30/s, 12 ms, 4 marked, 12 obstacles");
        assert_eq!(line(10), "30/s, 12 m");
        scene.sequence = u64::MAX;
        for columns in 0..100 {
            assert!(text(&scene, figures, columns).len() <= columns);
        }
        // A marker's name may have any letters.
        assert_eq!(cut("λάμδα".to_owned(), 3), "λάμ");
    }
}
