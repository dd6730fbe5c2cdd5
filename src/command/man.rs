//! `overcam man` and `overcam completions`: the argument definitions of clap as a manual page and
//! as shell completions.
//!
//! There is one page for the program and all its commands. Options and descriptions come from the
//! definition of the arguments, so they match `--help`; other sections, such as signals and files,
//! are written here.

use std::io::{self, Write};

use clap::{Command, CommandFactory};
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, bold, roman};

use crate::cli::Cli;

/// Name of the program.
const NAME: &str = "overcam";

/// Date of the last change to the page's own sections.
const DATE: &str = "2026-11-27";

/// A section of the page: a heading, and entries with their descriptions.
type Section = (&'static str, &'static [(&'static str, &'static str)]);

const SECTIONS: [Section; 5] = [
    (
        "EXIT STATUS",
        &[
            ("0", "Done, or stopped by a signal."),
            (
                "1",
                "Failed; the last line on standard error says why and what to do.",
            ),
            (
                "2",
                "Wrong arguments, or arguments that do not apply to this source.",
            ),
            (
                "3",
                "Finished, but frames were lost from the recording, or it could not be completed.",
            ),
        ],
    ),
    (
        "SIGNALS",
        &[
            (
                "INT, TERM, HUP",
                "End the run: captured frames are processed, the recording is completed, and the original controls of the \
                 camera are restored. A second signal ends the program immediately.",
            ),
            (
                "USR1",
                "Learn the empty floor again from the next --learn frames. The old one is used meanwhile.",
            ),
            (
                "TSTP, CONT",
                "As usual. The time between them counts neither in the rate nor in the latency of the status line.",
            ),
        ],
    ),
    (
        "ENVIRONMENT",
        &[
            (
                "TERM",
                "With \"dumb\", or where it is not set, nothing is drawn in place: standard error gets a line every ten seconds, and \
                 watch prints JSON.",
            ),
            (
                "NO_COLOR",
                "If it is set and not empty, standard error gets no escape sequences.",
            ),
        ],
    ),
    (
        "FILES",
        &[
            (
                "FILE.mcap, FILE-2.mcap, FILE-3.mcap",
                "A recording, in several files with --record-max or --record-minutes. Each is complete by itself. The numbers have no \
                 leading zeros: ls -v lists the files in the order of time. None is ever overwritten.",
            ),
            ("/dev/shm", "Shared memory, while a run publishes."),
        ],
    ),
    (
        "EXAMPLES",
        &[
            ("overcam", "The built-in demo floor: no camera is needed."),
            (
                "overcam --device /dev/video0 --record run.mcap",
                "Locate with a camera, publish in shared memory, and record every frame and result.",
            ),
            (
                "overcam --device /dev/video0 --record run.mcap --record-jpeg 90 --record-max 4",
                "The same with a tenth of the disk, in files of at most 4 gigabytes.",
            ),
            (
                "overcam --device run.mcap --json --no-publish",
                "Replay a recording: the same frames give the same results.",
            ),
            (
                "ffmpeg -v error -i any.mp4 -f yuv4mpegpipe - | overcam --device - --json",
                "Locate in any video.",
            ),
            (
                "overcam background --device /dev/video0 -o floor.png",
                "Learn the empty floor into a file for --background.",
            ),
            (
                "overcam watch",
                "See in another terminal what is published.",
            ),
            (
                "overcam man > overcam.1; man -l overcam.1",
                "Read this page.",
            ),
            (
                "overcam completions bash > ~/.local/share/bash-completion/completions/overcam",
                "Complete arguments in the next shell.",
            ),
        ],
    ),
];

/// Prints the manual page.
///
/// # Errors
///
/// If writing fails.
pub(super) fn print_man(out: &mut impl Write) -> io::Result<()> {
    out.write_all(page()?.as_bytes())
}

/// Prints the completion script for a shell.
///
/// # Errors
///
/// If writing fails.
pub(super) fn print_completions(shell: Shell, out: &mut impl Write) -> io::Result<()> {
    // Into memory first: the generator panics if writing fails.
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), NAME, &mut script);
    out.write_all(&script)
}

fn page() -> io::Result<String> {
    let mut command = Cli::command().disable_help_subcommand(true);
    command.build();
    let man = Man::new(command.clone()).date(DATE).manual("User Commands");
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    let mut page = text(page)?;
    page += ".SH COMMANDS\n";
    add_commands(&command, &mut page)?;
    for (heading, entries) in SECTIONS {
        let mut section = Roff::default();
        section.control("SH", [heading]);
        for (name, meaning) in entries {
            section.control("TP", []);
            section.text([bold(*name)]);
            section.text([roman(*meaning)]);
        }
        page += &section.to_roff();
    }
    // Each part starts with a definition that is already in the first one.
    let mut lines: Vec<&str> = page.lines().collect();
    let first = lines.iter().take_while(|line| is_preamble(line)).count();
    let rest = lines.split_off(first);
    lines.extend(rest.into_iter().filter(|line| !is_preamble(line)));
    Ok(lines.join("\n") + "\n")
}

/// Whether a line defines the rendering of an apostrophe.
fn is_preamble(line: &str) -> bool {
    line.contains(".ds Aq ")
}

/// Adds each command below `parent` with its arguments.
fn add_commands(parent: &Command, page: &mut String) -> io::Result<()> {
    for command in parent
        .get_subcommands()
        .filter(|command| !command.is_hide_set())
    {
        let man = Man::new(command.clone());
        let name = command.get_bin_name().unwrap_or_else(|| command.get_name());
        let mut heading = Roff::default();
        heading.control("SS", [name]);
        *page += &heading.to_roff();
        let mut content = Vec::new();
        man.render_synopsis_section(&mut content)?;
        man.render_description_section(&mut content)?;
        man.render_options_section(&mut content)?;
        // The sections of a page become paragraphs: the first needs no mark, and each option has
        // its own.
        let content = text(content)?;
        for line in content.lines().filter(|line| !is_preamble(line)).skip(1) {
            match line {
                ".SH OPTIONS" => {}
                // Before the possible values of an argument, where an empty line also separates
                // them.
                ".br" => {}
                _ if line.starts_with(".SH") => *page += ".PP\n",
                _ => {
                    *page += line;
                    page.push('\n');
                }
            }
        }
        add_commands(command, page)?;
    }
    Ok(())
}

fn text(page: Vec<u8>) -> io::Result<String> {
    String::from_utf8(page).map_err(io::Error::other)
}
