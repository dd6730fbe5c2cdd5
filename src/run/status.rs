//! Output for the user on standard error: a status line and error lines.
//!
//! On a terminal the status line is updated in place every second and never wraps; in a log, a new
//! one is written every ten seconds. A terminal of type dumb, or one whose user set `NO_COLOR`, is
//! treated like a log: no escape sequences.
//!
//! Rate and latency are those of the results since the last line. Time suspended by Ctrl-Z counts
//! neither as time nor as latency.

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
/// Interval of progress lines while learning.
const LEARNING_PERIOD_TERMINAL: Duration = Duration::from_millis(200);
const LEARNING_PERIOD_LOG: Duration = Duration::from_secs(5);
/// Maximum width of a line, in columns; also that of a terminal of unknown width.
const COLUMNS_MAX: usize = 60;

/// The status line and its statistics.
#[derive(Debug)]
pub(crate) struct Status {
    terminal: bool,
    meter: Meter,
    /// Set by a signal when the program is resumed after Ctrl-Z.
    resumed: Arc<AtomicBool>,
    /// Time of the last progress line while learning.
    learning_shown: Option<Instant>,
    /// Text currently shown on the terminal; may be empty.
    shown: String,
}

impl Status {
    /// Initially empty. With `live`, latencies count from the exposure.
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
            learning_shown: None,
            shown: String::new(),
        }
    }

    /// Counts a scene, and shows the line if it is due.
    pub(crate) fn frame(&mut self, scene: &Scene, latency: Duration) {
        let now = Instant::now();
        self.handle_resume(now);
        let Some(figures) = self.meter.add(now, latency) else {
            return;
        };
        // The floor is being learned again, with more frequent lines.
        let is_learning = self
            .learning_shown
            .is_some_and(|at| now - at < PERIOD_TERMINAL);
        if !(self.terminal && is_learning) {
            self.show(text(scene, figures, self.columns()));
        }
    }

    /// Shows the progress of learning `what`.
    pub(crate) fn learning(&mut self, what: &str, seen: u32, of: u32) {
        let now = Instant::now();
        self.handle_resume(now);
        let period = if self.terminal {
            LEARNING_PERIOD_TERMINAL
        } else {
            LEARNING_PERIOD_LOG
        };
        let is_due = match self.learning_shown {
            Some(at) => now - at >= period,
            // A log gets no line if learning ends soon.
            None => self.terminal,
        };
        if is_due {
            let line = format!("overcam: learning {what}: {seen} of {of}");
            self.show(cut(line, self.columns()));
        }
        if is_due || self.learning_shown.is_none() {
            self.learning_shown = Some(now);
        }
    }

    fn handle_resume(&mut self, now: Instant) {
        if self.resumed.swap(false, Ordering::Relaxed) {
            self.meter.restart(now);
            // The shell has overwritten it.
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

    /// Maximum width of a line.
    fn columns(&self) -> usize {
        let width = if self.terminal {
            rustix::termios::tcgetwinsize(std::io::stderr().as_fd()).map_or(0, |size| size.ws_col)
        } else {
            0
        };
        match usize::from(width) {
            0 => COLUMNS_MAX,
            // Some terminals wrap already in the last column.
            width => COLUMNS_MAX.min(width - 1),
        }
    }

    /// Writes a message on a line of its own.
    pub(crate) fn report(&self, message: &str) {
        if self.shown.is_empty() {
            log(format_args!("overcam: {message}"));
        } else {
            put(format_args!("\r\x1b[Kovercam: {message}\n{}", self.shown));
        }
    }

    /// Removes the line from a terminal.
    pub(crate) fn clear(&mut self) {
        if !self.shown.is_empty() {
            put(format_args!("\r\x1b[K"));
            self.shown.clear();
        }
    }
}

/// Whether a stream is a terminal that supports redrawing.
pub(crate) fn can_redraw(stream: &impl IsTerminal) -> bool {
    let term = std::env::var_os("TERM").unwrap_or_default();
    stream.is_terminal() && !term.is_empty() && term != "dumb"
}

/// Whether the user disabled colours and the like: <https://no-color.org>.
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
    /// Start of the current interval: the time of a result, which itself does not count.
    since: Option<Instant>,
    resumed_at: Option<Instant>,
    frames: u32,
    latency: Duration,
}

/// Figures for one interval.
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

    /// The program was suspended and resumed.
    fn restart(&mut self, now: Instant) {
        *self = Self {
            resumed_at: Some(now),
            ..Self::new(self.live, self.period)
        };
    }

    /// Counts a result; returns figures if they are due.
    fn add(&mut self, now: Instant, latency: Duration) -> Option<Figures> {
        // Exposed or in processing before the program was suspended.
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

/// The line, shortened to fit: first without the explanation of the latency, then without the
/// program's name, then without the frame number.
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

/// Truncates a line to fit.
fn cut(mut line: String, columns: usize) -> String {
    if let Some((at, _)) = line.char_indices().nth(columns) {
        line.truncate(at);
    }
    line
}

/// An error with its causes, in one line. Most errors already include their cause in the message;
/// it is not repeated then.
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

/// Whether the reader of standard output has closed it, which is not an error.
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

/// Errors are ignored: text that cannot be written, because its reader has gone or the disk of a
/// log is full, is no reason to stop, while `eprint!` would panic.
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
        let complete = anyhow!("no such file").context("a.png cannot be read: no such file");
        assert_eq!(one_line(&complete), "a.png cannot be read: no such file");
        let partial = anyhow!("no such file").context("a.png cannot be read");
        assert_eq!(one_line(&partial), "a.png cannot be read: no such file");
    }

    /// Results at 25/s from a point in time; returns the last figures, and the time after.
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
        // Also for later ones.
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
        // Results in processing when it was suspended.
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
        // A marker's name may contain any letters.
        assert_eq!(cut("λάμδα".to_owned(), 3), "λάμ");
    }
}
