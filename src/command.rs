//! What each command does: from parsed arguments to the end of the program.

pub mod background;
mod man;
mod service;
pub mod watch;

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};

use crate::camera::devices;
use crate::cli::{Command, MarkersCommand};
use crate::command::background::{learn_background, learn_view};
use crate::config::Arguments;
use crate::geometry::calibration::{self, Calibration};
use crate::marker::{MarkerFile, built_in_files, read_folder};
use crate::marker_design::check::{check, table};
use crate::marker_design::design::design;
use crate::marker_design::sheet::{Layout, pdf, svg_pages};
use crate::marker_design::trace::trace;
use crate::output::lines::StoppableWriter;
use crate::output::mcap::recover;
use crate::run::capture::open_source;
use crate::run::setup::settings_in_force;
use crate::run::status::{can_redraw, counted};
use crate::run::{Completion, run};
use crate::settings::Settings;
use crate::source::is_recording;

/// Does what the arguments say, until it is done or a signal ends it.
///
/// # Errors
///
/// What kept it from being done, in one line.
pub fn execute(arguments: &Arguments) -> anyhow::Result<Completion> {
    let cli = &arguments.cli;
    let stop = Arc::new(AtomicBool::new(false));
    let hang_up = (!ignores(SIGHUP)).then_some(SIGHUP);
    for signal in [SIGINT, SIGTERM].into_iter().chain(hang_up) {
        // A second Ctrl-C ends the program at once, should the first one not be heard.
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .context("signals")?;
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("signals")?;
    }
    // Registered for every command, lest the signal ends one to which it says nothing.
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
        Command::Recover { file, output } => {
            let report = recover::recover(file, output)?;
            let (images, seconds) = (report.images, report.duration_ns as f64 * 1e-9);
            let damaged = report.damaged;
            writeln!(
                out,
                "{}: {}, {seconds:.2} s; {} left out",
                output.display(),
                counted(images, "frame"),
                counted(damaged, "damaged record")
            )
            .context("standard output")?;
        }
    }
    Ok(Completion::Done)
}

/// Prints the settings that a run with these arguments would have. A camera is not opened for it.
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

/// Whether the program was started with a signal ignored: `nohup` does so, and wants it to stay so.
fn ignores(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// A reader of standard output that has seen enough is no error.
fn unless_unread(result: io::Result<()>) -> anyhow::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result.context("standard output"),
    }
}

fn markers(
    command: &MarkersCommand,
    stop: &Arc<AtomicBool>,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    match command {
        MarkersCommand::Check {
            folder,
            calibration,
        } => {
            let files = marker_files(folder.as_deref())?;
            let cm_per_px = calibration.as_deref().map(centimetres_per_px).transpose()?;
            let checks = check(&files);
            out.write_all(table(&checks, cm_per_px).as_bytes())
                .context("standard output")?;
            let refused = checks.iter().filter(|c| c.quality.is_err()).count();
            if refused > 0 {
                bail!(
                    "markers: {refused} of {} cannot be used; change or remove those that the table names",
                    checks.len()
                );
            }
        }
        MarkersCommand::Design {
            count,
            output,
            beside,
            seed,
        } => {
            let others = beside.as_deref().map(read_folder).transpose()?;
            let designed = design(*count as usize, *seed, &others.unwrap_or_default())?;
            std::fs::create_dir_all(output).with_context(|| not_written(output))?;
            for file in &designed {
                let path = output.join(&file.name).with_extension("svg");
                // What is there may be somebody's own drawing.
                let mut new =
                    std::fs::File::create_new(&path).with_context(|| not_written(&path))?;
                new.write_all(file.svg.as_bytes())
                    .with_context(|| not_written(&path))?;
                writeln!(out, "{}", path.display()).context("standard output")?;
            }
            if designed.len() < *count as usize {
                bail!(
                    "markers: only {} shapes were found that can be told apart; ask for fewer, or try another --seed",
                    designed.len()
                );
            }
        }
        MarkersCommand::Learn {
            source,
            output,
            beside,
            learn,
        } => {
            let others = beside.as_deref().map(read_folder).transpose()?;
            let Some(((), view)) = learn_view(source, *learn, "a marker", stop, || Ok(()))? else {
                return Ok(());
            };
            let name = output.file_stem().unwrap_or_default().to_string_lossy();
            let traced = trace(&view.floor.picture, &name).with_context(|| view.source)?;
            let mut files = others.unwrap_or_default();
            files.push(traced);
            let checks = check(&files);
            let (Some(file), Some(new)) = (files.last(), checks.last()) else {
                bail!("markers: nothing was learned");
            };
            if let Err(error) = &new.quality {
                bail!("{error}");
            }
            // What is there may be somebody's own drawing.
            std::fs::File::create_new(output)
                .and_then(|mut new| new.write_all(file.svg.as_bytes()))
                .with_context(|| not_written(output))?;
            let quality = table(std::slice::from_ref(new), None);
            out.write_all(quality.as_bytes())
                .context("standard output")?;
        }
        MarkersCommand::Sheet {
            folder,
            output,
            plate,
            copies,
        } => {
            let files = marker_files(folder.as_deref())?;
            let layout = Layout {
                plate_mm: *plate,
                copies: *copies,
            };
            let is_pdf = output
                .extension()
                .is_some_and(|extension| extension.eq_ignore_ascii_case("pdf"));
            if is_pdf {
                std::fs::write(output, pdf(&files, &layout)?)
                    .with_context(|| not_written(output))?;
                return writeln!(out, "{}", output.display()).context("standard output");
            }
            for (page, svg) in svg_pages(&files, &layout)?.iter().enumerate() {
                let path = page_path(output, page);
                std::fs::write(&path, svg).with_context(|| not_written(&path))?;
                writeln!(out, "{}", path.display()).context("standard output")?;
            }
        }
    }
    Ok(())
}

fn not_written(path: &Path) -> String {
    format!(
        "{} cannot be written; name another, in a folder that exists",
        path.display()
    )
}

fn marker_files(folder: Option<&Path>) -> anyhow::Result<Vec<MarkerFile>> {
    Ok(match folder {
        Some(folder) => read_folder(folder)?,
        None => built_in_files(),
    })
}

fn centimetres_per_px(path: &Path) -> anyhow::Result<f64> {
    let text = calibration::read_text(path)?;
    let calibration = Calibration::from_toml(&text).with_context(|| path.display().to_string())?;
    let metres = calibration
        .metres_per_px()
        .with_context(|| format!("{}: it maps its points to infinity", path.display()))?;
    Ok(100.0 * metres)
}

/// `sheet.svg`, `sheet-2.svg` and so on.
fn page_path(output: &Path, page: usize) -> std::path::PathBuf {
    if page == 0 {
        return output.to_owned();
    }
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    let extension = output.extension().map_or(String::new(), |extension| {
        format!(".{}", extension.to_string_lossy())
    });
    output.with_file_name(format!("{stem}-{}{extension}", page + 1))
}
