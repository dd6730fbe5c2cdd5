//! `overcam watch`: prints the scenes that a planner would read from shared memory.
//!
//! On a terminal it shows a `table` of the newest scene. Elsewhere, and with `--json`, it prints
//! each scene as the same line as `--json` of a run. It waits for a service that does not exist
//! yet, stays when its publisher exits or is killed, and continues with the next one; such events
//! are reported on standard error, or in the table. If the files of the service were removed and it
//! is published again, it subscribes again.
//!
//! Deliberately absent: a way to slow the publisher down. A reader that falls behind, or whose pipe
//! does, misses scenes, and their number is reported.

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

/// Maximum wait before the stop flag is checked.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// Silence after which the publisher is checked for being dead.
const SILENCE: Duration = Duration::from_secs(1);
/// Minimum time between two reports of missing scenes.
const REPORT_PERIOD: Duration = Duration::from_secs(1);

/// Reasons why scenes cannot be watched.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The name is invalid for a service.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The publisher has another version.
    #[error(
        "service `{service}` publishes another layout of the scene ({reason}): watch it with the overcam that publishes it"
    )]
    Incompatible {
        /// The service.
        service: String,
        /// The difference.
        reason: String,
    },
    /// The maximum number of subscribers is reached.
    #[error("service `{service}` has no place for another subscriber: stop one")]
    Full {
        /// The service.
        service: String,
    },
    /// The files of the middleware cannot be opened, usually because they belong to another user.
    #[error(
        "service `{service}` cannot be opened ({reason}): run as the user who publishes it, or publish it for a group with --group"
    )]
    Denied {
        /// The service.
        service: String,
        /// The failure, in the middleware's words.
        reason: String,
    },
    /// No access to the group's place.
    #[error("--group {group}: {reason}: is this user a member of the group? see with `id`")]
    Group {
        /// The group.
        group: String,
        /// The object to which access is denied.
        reason: String,
    },
    /// Shared memory could not be opened or read for another reason.
    #[error("service `{service}` cannot be read ({reason}): start the watch again")]
    Read {
        /// The service.
        service: String,
        /// The failure, in the middleware's words.
        reason: String,
    },
    /// The lines could not be written.
    #[error("scenes cannot be printed: {0}")]
    Write(#[from] io::Error),
}

/// Prints the scenes published on `service`, by this user or for a `group`, to `out`, one JSON
/// object per line, until `frames` are printed or `stop` is set. A closed pipe behind `out` has the
/// same effect as a stop.
///
/// # Errors
///
/// See [`WatchError`]. If the service does not exist, this waits for it.
pub fn watch(
    service: &str,
    group: Option<&str>,
    frames: Option<u64>,
    stop: &AtomicBool,
    out: &mut impl Write,
) -> Result<(), WatchError> {
    show(service, group, frames, stop, Output::json(out))
}

/// Shows the newest scene published on `service` as a table on `out`, standard output on a
/// terminal, until this many scenes have arrived or `stop` is set.
///
/// # Errors
///
/// See [`WatchError`]. If the service does not exist, this waits for it.
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
            if progress.check_publisher(&connection) == Found::Nothing {
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

/// How scenes are displayed.
enum Output<'a, W> {
    /// As the lines of `--json`.
    Json { out: &'a mut W, line: Vec<u8> },
    /// As a table of the newest one.
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

/// What new subscribers would find.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    /// The current service.
    Service,
    /// Nothing, or another service of this name.
    Nothing,
}

/// Reports about a stream of scenes.
struct Progress {
    service: ServiceName,
    /// Publisher of the last scene.
    publisher: Option<UniquePublisherId>,
    next_sequence: u64,
    n_missing: u64,
    n_reported: u64,
    reported: Instant,
    heard: Instant,
    absent: bool,
    /// No messages, because they are in a table.
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

    fn report(&self, message: fmt::Arguments<'_>) {
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
                self.report(format_args!(
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

    /// Reports when there is no publisher any more. A killed publisher sends no message, so its
    /// remains are searched for.
    fn check_publisher(&mut self, connection: &Connection<'_>) -> Found {
        if self.heard.elapsed() < SILENCE {
            return Found::Service;
        }
        self.heard = Instant::now();
        if !connection.is_current() {
            self.report(format_args!(
                "service `{}` was removed from shared memory: looking for it again",
                self.service
            ));
            return Found::Nothing;
        }
        if self.absent {
            return Found::Service;
        }
        connection.service.try_cleanup_dead_nodes();
        if connection.service.dynamic_config().number_of_publishers() == 0 {
            self.report(format_args!(
                "nobody publishes on service `{}`: waiting",
                self.service
            ));
            self.absent = true;
        }
        Found::Service
    }

    fn report_missing(&mut self) {
        if self.n_missing > self.n_reported {
            self.report(format_args!(
                "{} without a scene here: passed over by overcam, or not read in time",
                counted(self.n_missing, "frame")
            ));
            self.n_reported = self.n_missing;
            self.reported = Instant::now();
        }
    }
}
