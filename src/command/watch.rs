//! `overcam watch`: prints what a planner would read from shared memory.
//!
//! On a terminal that is a `table` of the newest scene. Elsewhere, and with `--json`, each scene becomes the line that `--json` prints for
//! it. The watcher waits for a service that does not exist yet, stays
//! when its publisher goes or is killed, and goes on with the next one; what happens is said on standard error, or stands in the
//! table. When the service's files were removed and it is published anew, it subscribes anew.
//!
//! Deliberately absent: a way to slow the publisher down. A reader that falls behind, or whose pipe does, misses scenes, and
//! is told how many.

mod connection;
mod table;

use std::fmt;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use iceoryx2::identifiers::UniquePublisherId;
use iceoryx2::prelude::{LogLevel, PortFactory, ServiceName, set_log_level};

use scene::Scene;

use crate::command::watch::connection::{Connection, Wanted};
use crate::command::watch::table::Screen;
use crate::output::json;
use crate::output::shared_memory::{NameError, service_name};
use crate::run::status::{counted, log};

/// Longest wait before the stop flag is looked at.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// Silence after which the publisher may be dead.
const SILENCE: Duration = Duration::from_secs(1);
/// Shortest time between two reports of missing scenes.
const REPORT_PERIOD: Duration = Duration::from_secs(1);

/// Why scenes cannot be watched.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The name cannot name a service.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The publisher is another version of the program.
    #[error(
        "service `{service}` publishes another layout of the scene ({reason}): watch it with the overcam that publishes it"
    )]
    Incompatible {
        /// The service.
        service: String,
        /// What differs.
        reason: String,
    },
    /// All places for subscribers are taken.
    #[error("service `{service}` has no place for another subscriber: stop one")]
    Full {
        /// The service.
        service: String,
    },
    /// The files of the middleware cannot be opened, as a rule because they belong to another user.
    #[error(
        "service `{service}` cannot be opened ({reason}): run as the user who publishes it, or publish it for a group with --group"
    )]
    Denied {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// The group's place cannot be entered.
    #[error("--group {group}: {reason}: is this user a member of the group? see with `id`")]
    Group {
        /// The group.
        group: String,
        /// What is denied.
        reason: String,
    },
    /// Shared memory could not be opened or read for another reason.
    #[error("service `{service}` cannot be read ({reason}): start the watch again")]
    Read {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// The lines could not be written.
    #[error("scenes cannot be printed: {0}")]
    Write(#[from] io::Error),
}

/// Prints the scenes published on `service`, by this user or for a `group`, to `out`, one JSON object a line, until `frames` are
/// printed or `stop` is set. A closed pipe behind `out` ends it like a stop.
///
/// # Errors
///
/// See [`WatchError`]. A service that does not exist is not an error but waited for.
pub fn watch(
    service: &str,
    group: Option<&str>,
    frames: Option<u64>,
    stop: &AtomicBool,
    out: &mut impl Write,
) -> Result<(), WatchError> {
    show(service, group, frames, stop, Output::json(out))
}

/// Shows the newest of the scenes published on `service` as a table on `out`, standard output and a terminal, until so many have come
/// or `stop` is set.
///
/// # Errors
///
/// See [`WatchError`]. A service that does not exist is not an error but waited for.
pub fn watch_table(
    service: &str,
    group: Option<&str>,
    frames: Option<u64>,
    stop: &AtomicBool,
    out: &mut impl Write,
) -> Result<(), WatchError> {
    show(
        service,
        group,
        frames,
        stop,
        Output::Table(Screen::new(out)),
    )
}

fn show<W: Write>(
    service: &str,
    group: Option<&str>,
    frames: Option<u64>,
    stop: &AtomicBool,
    mut output: Output<'_, W>,
) -> Result<(), WatchError> {
    let name = service_name(service)?;
    set_log_level(LogLevel::Fatal);
    let wanted = Wanted { name, group };
    let Some(connection) = Connection::wait_for(wanted, stop)? else {
        return Ok(());
    };
    let mut progress = Progress::new(name);
    progress.quiet = matches!(output, Output::Table(_));
    let result = show_scenes(connection, frames, stop, &mut progress, &mut output);
    progress.report_missing();
    match result {
        Err(WatchError::Write(error)) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

fn show_scenes<W: Write>(
    mut connection: Connection<'_>,
    frames: Option<u64>,
    stop: &AtomicBool,
    progress: &mut Progress,
    output: &mut Output<'_, W>,
) -> Result<(), WatchError> {
    let mut remaining = frames.unwrap_or(u64::MAX);
    while remaining > 0 && !stop.load(Ordering::Relaxed) {
        let Some(sample) = connection.receive()? else {
            output.while_waiting()?;
            connection.wait()?;
            if progress.look_after_publisher(&connection) == Found::Nothing {
                let Some(next) = connection.again(stop)? else {
                    break;
                };
                connection = next;
            }
            continue;
        };
        progress.received(sample.header().publisher_id(), sample.sequence);
        output.show(&sample, progress)?;
        remaining -= 1;
    }
    output.finish()?;
    Ok(())
}

/// How scenes are shown.
enum Output<'a, W> {
    /// As the lines of `--json`.
    Json { out: &'a mut W, line: Vec<u8> },
    /// The newest one in a table.
    Table(Screen<'a, W>),
}

impl<'a, W: Write> Output<'a, W> {
    fn json(out: &'a mut W) -> Self {
        let line = Vec::new();
        Self::Json { out, line }
    }

    fn show(&mut self, scene: &Scene, progress: &Progress) -> io::Result<()> {
        match self {
            Self::Json { out, line } => {
                line.clear();
                json::write_line(scene, line)?;
                out.write_all(line)
            }
            Self::Table(screen) => {
                screen.take(scene, progress.service.as_str(), progress.n_missing)
            }
        }
    }

    fn while_waiting(&mut self) -> io::Result<()> {
        match self {
            Self::Json { out, .. } => out.flush(),
            Self::Table(screen) => screen.draw_when_due(),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        match self {
            Self::Json { out, .. } => out.flush(),
            Self::Table(screen) => screen.finish(),
        }
    }
}

/// What newcomers find.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    /// The service that is being watched.
    Service,
    /// Nothing, or another one of its name.
    Nothing,
}

/// What is told about a stream of scenes, besides the scenes.
struct Progress {
    service: ServiceName,
    /// Who sent the last scene.
    publisher: Option<UniquePublisherId>,
    next_sequence: u64,
    n_missing: u64,
    n_reported: u64,
    reported: Instant,
    heard: Instant,
    absent: bool,
    /// A table says it instead.
    quiet: bool,
}

impl Progress {
    fn new(service: ServiceName) -> Self {
        let now = Instant::now();
        Self {
            service,
            publisher: None,
            next_sequence: 0,
            n_missing: 0,
            n_reported: 0,
            reported: now,
            heard: now,
            absent: false,
            quiet: false,
        }
    }

    fn tell(&self, message: fmt::Arguments<'_>) {
        if !self.quiet {
            log(format_args!("watch: {message}"));
        }
    }

    fn received(&mut self, publisher: UniquePublisherId, sequence: u64) {
        self.heard = Instant::now();
        if self.publisher == Some(publisher) {
            self.n_missing += sequence.saturating_sub(self.next_sequence);
        } else {
            if self.publisher.is_some() || self.absent {
                self.tell(format_args!(
                    "service `{}` has a new publisher",
                    self.service
                ));
            }
            self.publisher = Some(publisher);
            self.absent = false;
        }
        self.next_sequence = sequence.saturating_add(1);
        if self.reported.elapsed() > REPORT_PERIOD {
            self.report_missing();
        }
    }

    /// Says so when nobody publishes any more. A killed publisher leaves no word: its remains have to be looked for.
    fn look_after_publisher(&mut self, connection: &Connection<'_>) -> Found {
        if self.heard.elapsed() < SILENCE {
            return Found::Service;
        }
        self.heard = Instant::now();
        if !connection.is_current() {
            self.tell(format_args!(
                "service `{}` was removed from shared memory: looking for it anew",
                self.service
            ));
            return Found::Nothing;
        }
        if self.absent {
            return Found::Service;
        }
        connection.service.try_cleanup_dead_nodes();
        if connection.service.dynamic_config().number_of_publishers() == 0 {
            self.tell(format_args!(
                "nobody publishes on service `{}`: waiting",
                self.service
            ));
            self.absent = true;
        }
        Found::Service
    }

    fn report_missing(&mut self) {
        if self.n_missing > self.n_reported {
            self.tell(format_args!(
                "{} without a scene here: passed over by overcam, or not read in time",
                counted(self.n_missing, "frame")
            ));
            self.n_reported = self.n_missing;
            self.reported = Instant::now();
        }
    }
}
