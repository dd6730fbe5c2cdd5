//! The `overcam` program: parse, run, exit status.

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::Parser;
use overcam::cli::{Cli, Command};
use overcam::recording::recover;
use overcam::run::background::learn_background;
use overcam::run::{Completion, run};
use overcam::source::{SourceError, devices};
use overcam::status::{one_line, tell};
use overcam::watch;
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

/// The arguments contradict each other; those that cannot be read end the program with the same.
const WRONG_ARGUMENTS: u8 = 2;
/// Finished, but frames were lost from the recording.
const FRAMES_LOST: u8 = 3;

fn main() -> ExitCode {
    match execute(&Cli::parse()) {
        Ok(Completion::Done) => ExitCode::SUCCESS,
        Ok(Completion::FramesLost) => ExitCode::from(FRAMES_LOST),
        Err(error) => {
            tell(format_args!("overcam: {}", one_line(&error)));
            match error.downcast_ref() {
                Some(SourceError::Argument { .. }) => ExitCode::from(WRONG_ARGUMENTS),
                _ => ExitCode::FAILURE,
            }
        }
    }
}

fn execute(cli: &Cli) -> anyhow::Result<Completion> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // A second Ctrl-C ends the program at once, should the first one not be heard.
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .context("signals")?;
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("signals")?;
    }
    // Registered for every command, lest the signal ends one to which it says nothing.
    let relearn = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGUSR1, Arc::clone(&relearn)).context("signals")?;
    let mut out = std::io::stdout().lock();
    match &cli.command {
        None => return run(&cli.run, &stop, &relearn, &mut out),
        Some(Command::Devices) => devices::list(&mut out).context("standard output")?,
        Some(Command::Background(args)) => learn_background(args, &stop, &mut out)?,
        Some(Command::Watch { service, frames }) => {
            watch::watch(service, *frames, &stop, &mut out)?
        }
        Some(Command::Recover { file, output }) => {
            let report = recover::recover(file, output)?;
            let (images, seconds) = (report.images, report.duration_ns as f64 * 1e-9);
            let damaged = report.damaged;
            writeln!(
                out,
                "{}: {images} frames, {seconds:.2} s; {damaged} damaged records left out",
                output.display()
            )
            .context("standard output")?;
        }
    }
    Ok(Completion::Done)
}
