//! Scenes as a table on a terminal: one row per object, updated in place.
//!
//! The screen content is a pure function of the newest scene and the terminal's size ([`table`]).
//! It is drawn over the previous table in one write, several times a second, with the cursor left
//! below it: a program that is stopped or killed leaves nothing to restore.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use scene::{FRAME_FLOOR, KIND_MARKER, LIGHT_CHANGED, LIGHT_DARK, Object, SOURCE_WAITING, Scene};
use signal_hook::consts::SIGCONT;

use crate::clock::monotonic_ns;
use crate::run::status::counted;

const DRAW_PERIOD: Duration = Duration::from_millis(200);
/// Interval over which the rate is measured.
const RATE_PERIOD: Duration = Duration::from_secs(1);
/// A scene of this age is outdated.
const STALE_NS: u64 = 1_000_000_000;
/// Assumed if the terminal does not state its size.
const SIZE: ScreenSize = ScreenSize {
    columns: 80,
    rows: 24,
};

/// Columns and rows of a terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ScreenSize {
    columns: usize,
    rows: usize,
}

/// Data in the table besides the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facts<'a> {
    /// The service's name.
    service: &'a str,
    /// Scenes per second, when known.
    rate_hz: Option<f64>,
    /// Age of the scene.
    age_ns: u64,
    /// Number of frames whose scene was missed.
    n_missing: u64,
}

/// A table on the terminal behind `out`, which is standard output.
#[derive(Debug)]
pub(super) struct Screen<'a, W> {
    out: &'a mut W,
    service: String,
    newest: Box<Scene>,
    n_missing: u64,
    rate_hz: Option<f64>,
    /// Start of the current rate interval, and number of scenes since.
    since: Option<(Instant, u32)>,
    drawn: Option<Instant>,
    /// Number of lines of the current table, and the size of the terminal when it was drawn.
    standing: (usize, ScreenSize),
    /// Set by a signal when the program is resumed after Ctrl-Z.
    resumed: Arc<AtomicBool>,
}

impl<'a, W: Write> Screen<'a, W> {
    /// Nothing is drawn before the first scene.
    pub(super) fn new(out: &'a mut W) -> Self {
        let resumed = Arc::new(AtomicBool::new(false));
        // Without the signal the output of the shell is overwritten.
        let _ = signal_hook::flag::register(SIGCONT, Arc::clone(&resumed));
        Self {
            out,
            service: String::new(),
            newest: Box::new(Scene::EMPTY),
            n_missing: 0,
            rate_hz: None,
            since: None,
            drawn: None,
            standing: (0, SIZE),
            resumed,
        }
    }

    /// Adds a scene, and draws if due.
    ///
    /// # Errors
    ///
    /// If the terminal is gone.
    pub(super) fn take(&mut self, scene: &Scene, service: &str, n_missing: u64) -> io::Result<()> {
        let now = Instant::now();
        if self.service != service {
            service.clone_into(&mut self.service);
        }
        *self.newest = *scene;
        self.n_missing = n_missing;
        match &mut self.since {
            None => self.since = Some((now, 0)),
            Some((since, n)) => {
                *n += 1;
                let elapsed = now - *since;
                if elapsed >= RATE_PERIOD {
                    self.rate_hz = Some(f64::from(*n) / elapsed.as_secs_f64());
                    self.since = Some((now, 0));
                }
            }
        }
        self.draw_when_due()
    }

    /// Draws if due, because a scene without a successor grows old.
    ///
    /// # Errors
    ///
    /// If the terminal is gone.
    pub(super) fn draw_when_due(&mut self) -> io::Result<()> {
        let is_due = self
            .drawn
            .is_none_or(|drawn| drawn.elapsed() >= DRAW_PERIOD);
        if is_due && self.since.is_some() {
            self.draw()?;
        }
        Ok(())
    }

    /// Draws the last scene and leaves the table on the screen.
    ///
    /// # Errors
    ///
    /// If the terminal is gone.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        if self.since.is_none() {
            return Ok(());
        }
        self.draw()?;
        self.out.write_all(b"\n")?;
        self.out.flush()
    }

    fn draw(&mut self) -> io::Result<()> {
        if self.resumed.swap(false, Ordering::Relaxed) {
            // The shell has written below the table: start a new table and a new rate interval.
            self.standing.0 = 0;
            (self.since, self.rate_hz) = (Some((Instant::now(), 0)), None);
        }
        let size = screen_size();
        let age_ns = self.newest.age_ns(monotonic_ns());
        let facts = Facts {
            service: &self.service,
            rate_hz: self.rate_hz.filter(|_| age_ns < STALE_NS),
            age_ns,
            n_missing: self.n_missing,
        };
        let lines = table(&self.newest, facts, size);
        let text = over(self.standing, &lines, size);
        self.standing = (lines.len(), size);
        self.drawn = Some(Instant::now());
        self.out.write_all(text.as_bytes())?;
        self.out.flush()
    }
}

fn screen_size() -> ScreenSize {
    let size = rustix::termios::tcgetwinsize(io::stdout().as_fd());
    match size.map(|size| (usize::from(size.ws_col), usize::from(size.ws_row))) {
        Ok((columns @ 1.., rows @ 1..)) => ScreenSize { columns, rows },
        _ => SIZE,
    }
}

/// The text that draws `lines` over the current table, given the size of the terminal when that was
/// drawn.
fn over((n_standing, then): (usize, ScreenSize), lines: &[String], now: ScreenSize) -> String {
    // Hide the cursor, so that it does not visibly move over the table.
    let mut text = "\x1b[?25l".to_owned();
    if n_standing > 0 && then != now {
        // The terminal may have wrapped lines anew, at unknown places.
        text += "\x1b[H\x1b[2J";
    } else {
        text.push('\r');
        if n_standing > 1 {
            let _ = write!(text, "\x1b[{}A", n_standing - 1);
        }
    }
    for (n, line) in lines.iter().enumerate() {
        let end = if n == 0 { "" } else { "\n\r" };
        let _ = write!(text, "{end}{line}\x1b[K");
    }
    text + "\x1b[J\x1b[?25h"
}

/// The lines of a table that fits the screen.
fn table(scene: &Scene, facts: Facts, size: ScreenSize) -> Vec<String> {
    let objects = scene.objects();
    let (unit, decimals) = match scene.frame {
        FRAME_FLOOR => ("m", 3),
        _ => ("px", 1),
    };
    let mut lines = header(scene, facts);
    lines.push(format!(
        "{:>5}  {:<14} {:>9} {:>9} {:>8} {:>8} {:>7}  state",
        "track",
        "object",
        format!("x {unit}"),
        format!("y {unit}"),
        "head deg",
        format!("{unit}/s"),
        "age s"
    ));
    // The cursor stays in the last line, where the shell continues.
    let room = size.rows.saturating_sub(1 + lines.len());
    let shown = if objects.len() > room {
        room.saturating_sub(1)
    } else {
        objects.len()
    };
    lines.extend(objects[..shown].iter().map(|object| row(object, decimals)));
    if shown < objects.len() {
        lines.push(format!("     and {} more", objects.len() - shown));
    }
    lines.truncate(size.rows.saturating_sub(1).max(1));
    for line in &mut lines {
        // Some terminals wrap already in the last column.
        cut(line, size.columns.saturating_sub(1));
    }
    lines
}

/// Header lines about the scene as a whole.
fn header(scene: &Scene, facts: Facts) -> Vec<String> {
    let age_s = facts.age_ns as f64 * 1e-9;
    let age = if facts.age_ns < STALE_NS {
        format!("{:.0} ms old", 1e3 * age_s)
    } else {
        format!("NO NEWS FOR {age_s:.0} s")
    };
    let rate = facts
        .rate_hz
        .map_or(String::new(), |rate_hz| format!("{rate_hz:.1}/s, "));
    let light = match scene.light {
        LIGHT_DARK => "dark",
        LIGHT_CHANGED => "just changed",
        _ => "steady",
    };
    let first = if scene.source == SOURCE_WAITING {
        format!(
            "{}: NO FRAME FROM THE CAMERA for {:.0} s, the last was {}",
            facts.service, scene.frame_age_s, scene.sequence
        )
    } else {
        format!(
            "{}: frame {}, {rate}{age}, light {light}",
            facts.service, scene.sequence
        )
    };
    let objects = scene.objects();
    let n =
        |is: &dyn Fn(&Object) -> bool| objects.iter().filter(|object| is(object)).count() as u64;
    let marked = n(&|object| object.kind == KIND_MARKER);
    let mut second = format!(
        "{marked} marked, {}; {} not seen, forecast",
        counted(objects.len() as u64 - marked, "obstacle"),
        n(&|object| !object.observed())
    );
    if scene.n_overflow > 0 {
        let _ = write!(second, ", {} left out", scene.n_overflow);
    }
    if facts.n_missing > 0 {
        let _ = write!(
            second,
            "; {} without a scene here",
            counted(facts.n_missing, "frame")
        );
    }
    vec![first, second]
}

fn row(object: &Object, decimals: usize) -> String {
    let name = object.marker_name().map(printable);
    let heading = object.heading().map_or(String::new(), |rad| {
        // Adding 0 removes the sign of a zero.
        format!("{:.1}", (10.0 * rad.to_degrees()).round() / 10.0 + 0.0)
    });
    format!(
        "{:>5}  {} {:>9.decimals$} {:>9.decimals$} {heading:>8} {:>8.decimals$} {:>7.1}  {}",
        object.track,
        fill(name.as_deref().unwrap_or("obstacle"), 14),
        object.x,
        object.y,
        object.vx.hypot(object.vy),
        object.age_s,
        if object.observed() {
            "seen"
        } else {
            "forecast"
        }
    )
}

/// A name without characters that would move the cursor.
fn printable(name: &str) -> String {
    let seen = |c: char| if c.is_control() { '?' } else { c };
    name.chars().map(seen).collect()
}

/// Columns of a character: two from the first wide script on.
fn width(letter: char) -> usize {
    if letter < '\u{1100}' { 1 } else { 2 }
}

/// A text padded or truncated to exactly this many columns.
fn fill(text: &str, columns: usize) -> String {
    let mut text = text.to_owned();
    cut(&mut text, columns);
    let used: usize = text.chars().map(width).sum();
    text.extend(std::iter::repeat_n(' ', columns.saturating_sub(used)));
    text
}

/// Truncates a text to this many columns.
fn cut(text: &mut String, columns: usize) {
    let mut used = 0;
    let end = text.char_indices().find_map(|(at, letter)| {
        used += width(letter);
        (used > columns).then_some(at)
    });
    if let Some(end) = end {
        text.truncate(end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{HAS_HEADING, MAX_OBJECTS, OBSERVED};

    const FACTS: Facts = Facts {
        service: "overcam/scene",
        rate_hz: Some(29.97),
        age_ns: 12_400_000,
        n_missing: 0,
    };

    fn screen(columns: usize, rows: usize) -> ScreenSize {
        ScreenSize { columns, rows }
    }

    /// A visible robot and invisible obstacles.
    fn scene(n_objects: u32) -> Scene {
        let mut scene = Scene::EMPTY;
        (scene.sequence, scene.n_objects) = (1234, n_objects);
        for (track, object) in (3..).zip(&mut scene.objects[..n_objects as usize]) {
            (object.track, object.x, object.y) = (track, 320.04, 7.26);
            (object.vx, object.vy, object.age_s) = (3.0, -4.0, 61.04);
        }
        let robot = &mut scene.objects[0];
        robot.kind = KIND_MARKER;
        robot.marker[..5].copy_from_slice(b"arrow");
        robot.flags = OBSERVED | HAS_HEADING;
        robot.heading_rad = -std::f64::consts::FRAC_PI_2;
        scene
    }

    #[test]
    fn every_object_has_a_row_under_a_header() {
        let lines = table(&scene(2), FACTS, screen(100, 24));
        assert_eq!(
            lines,
            [
                "overcam/scene: frame 1234, 30.0/s, 12 ms old, light steady",
                "1 marked, 1 obstacle; 1 not seen, forecast",
                "track  object              x px      y px head deg     px/s   age s  state",
                "    3  arrow              320.0       7.3    -90.0      5.0    61.0  seen",
                "    4  obstacle           320.0       7.3               5.0    61.0  forecast",
            ]
        );
    }

    #[test]
    fn a_camera_without_frames_is_reported_first() {
        let mut scene = scene(0);
        (scene.source, scene.frame_age_s) = (SOURCE_WAITING, 12.4);
        assert_eq!(
            table(&scene, FACTS, screen(100, 24))[0],
            "overcam/scene: NO FRAME FROM THE CAMERA for 12 s, the last was 1234"
        );
    }

    #[test]
    fn metres_old_scenes_darkness_and_missing_scenes_are_shown() {
        let mut scene = scene(1);
        scene.frame = FRAME_FLOOR;
        scene.light = LIGHT_DARK;
        scene.n_overflow = 2;
        let facts = Facts {
            rate_hz: None,
            age_ns: 75 * STALE_NS,
            n_missing: 1,
            ..FACTS
        };
        let lines = table(&scene, facts, screen(100, 24));
        assert_eq!(
            lines[0],
            "overcam/scene: frame 1234, NO NEWS FOR 75 s, light dark"
        );
        assert_eq!(
            lines[1],
            "1 marked, 0 obstacles; 0 not seen, forecast, 2 left out; 1 frame without a scene here"
        );
        assert!(lines[2].contains("x m") && lines[2].contains("m/s"));
        assert!(lines[3].contains(" 320.040     7.260 "), "{}", lines[3]);
    }

    #[test]
    fn a_table_fits_any_screen() {
        let mut full = scene(MAX_OBJECTS as u32);
        full.sequence = u64::MAX;
        for (n, object) in full.objects.iter_mut().enumerate() {
            object.kind = KIND_MARKER;
            let name = ["tour Eiffel", "λάμδα", "ロボット", "\x1b[2J\r\n", ""][n % 5];
            object.marker[..name.len()].copy_from_slice(name.as_bytes());
            object.track = u64::MAX - n as u64;
            (object.x, object.y) = (-1e9, f64::NAN);
        }
        for columns in [1, 2, 20, 60, 80, 200] {
            for rows in [1, 2, 4, 5, 24, 100] {
                let lines = table(&full, FACTS, screen(columns, rows));
                assert!(lines.len() <= (rows - 1).max(1), "{columns} x {rows}");
                for line in &lines {
                    assert!(line.chars().map(width).sum::<usize>() < columns.max(2));
                    assert!(!line.chars().any(char::is_control), "{line:?}");
                }
            }
        }
        let lines = table(&full, FACTS, screen(80, 12));
        assert_eq!(lines.len(), 11);
        assert_eq!(lines[10], format!("     and {} more", MAX_OBJECTS - 7));
        // Nothing is hidden if all fit.
        let lines = table(&full, FACTS, screen(80, MAX_OBJECTS + 4));
        assert_eq!(lines.len(), MAX_OBJECTS + 3);
        assert!(lines.iter().all(|line| !line.contains("more")));
    }

    #[test]
    fn a_table_is_drawn_over_the_one_before() {
        let lines = ["one".to_owned(), "two".to_owned()];
        let size = screen(80, 24);
        let first = over((0, size), &lines, size);
        assert_eq!(first, "\x1b[?25l\rone\x1b[K\n\rtwo\x1b[K\x1b[J\x1b[?25h");
        let next = over((3, size), &lines, size);
        assert!(next.starts_with("\x1b[?25l\r\x1b[2Aone"), "{next:?}");
        let resized = over((3, size), &lines, screen(40, 24));
        assert!(
            resized.starts_with("\x1b[?25l\x1b[H\x1b[2Jone"),
            "{resized:?}"
        );
    }
}
