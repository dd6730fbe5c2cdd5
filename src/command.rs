//! Executes each command: from parsed arguments to the end of the program.

pub mod background;
mod man;
mod markers;
mod service;
mod signals;
pub mod watch;

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use signal_hook::consts::SIGUSR1;

use crate::camera::devices;
use crate::cli::Command;
use crate::command::background::learn_background;
use crate::command::markers::markers;
use crate::config::Arguments;
use crate::output::lines::StoppableWriter;
use crate::output::mcap::recover;
use crate::run::capture::open_source;
use crate::run::setup::settings_in_force;
use crate::run::status::{can_redraw, counted};
use crate::run::{Completion, run};
use crate::settings::Settings;
use crate::source::is_recording;

/// Executes the command given by the arguments, until it is done or a signal ends it.
///
/// # Errors
///
/// The reason for the failure, in one line.
pub fn execute(arguments: &Arguments) -> anyhow::Result<Completion> {
    let cli = &arguments.cli;
    let stop = signals::stop_flag().context("signals")?;
    // Registered for every command, so that the signal does not end those that do not use it.
    let relearn = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGUSR1, Arc::clone(&relearn)).context("signals")?;
    let Some(command) = &cli.command else {
        if cli.run.print_config {
            return print_config(arguments, &stop).map(|()| Completion::Done);
        }
        return run(&cli.run, &stop, &relearn, std::io::stdout());
    };
    let mut out = std::io::stdout().lock();
    match command {
        Command::Devices => devices::list(&mut out).context("standard output")?,
        Command::Background(args) => learn_background(args, &stop, &mut out)?,
        Command::Markers(command) => markers(command, &stop, &mut out)?,
        Command::Watch {
            service,
            group,
            frames,
            json,
        } => {
            // The lines are written by another thread.
            drop(out);
            let mut out = std::io::stdout();
            if !json && can_redraw(&out) {
                watch::watch_table(service, group.as_deref(), *frames, &stop, &mut out)?;
            } else {
                let mut out = StoppableWriter::start(out, &stop).context("standard output")?;
                watch::watch(service, group.as_deref(), *frames, &stop, &mut out)?;
                unless_unread(out.finish())?;
            }
        }
        Command::Man => unless_unread(man::print_man(&mut out))?,
        Command::Completions { shell } => {
            unless_unread(man::print_completions(*shell, &mut out))?;
        }
        Command::Service(args) => service::print(args, arguments, &mut out)?,
        Command::Recover { file, output } => recover_file(file, output, &mut out)?,
    }
    Ok(Completion::Done)
}

/// Prints the settings that a run with these arguments would use. A camera is not opened for this.
fn print_config(arguments: &Arguments, stop: &Arc<AtomicBool>) -> anyhow::Result<()> {
    let args = &arguments.cli.run;
    let settings = if is_recording(&args.source.device) {
        let Some(source) = open_source(&args.source, stop)? else {
            return Ok(());
        };
        settings_in_force(args, &source)?
    } else {
        args.settings(Settings::default())
    };
    unless_unread(arguments.print(&settings, &mut std::io::stdout().lock()))
}

fn recover_file(file: &Path, output: &Path, out: &mut impl Write) -> anyhow::Result<()> {
    let report = recover::recover(file, output)?;
    writeln!(
        out,
        "{}: {}, {:.2} s; {} left out",
        output.display(),
        counted(report.images, "frame"),
        report.duration_ns as f64 * 1e-9,
        counted(report.damaged, "damaged record")
    )
    .context("standard output")
}

/// A closed pipe on standard output is not an error.
fn unless_unread(result: io::Result<()>) -> anyhow::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result.context("standard output"),
    }
}
