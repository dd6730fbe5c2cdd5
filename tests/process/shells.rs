//! The manual page and the completions.

use std::fs;
use std::process::{Command, Stdio};

use clap::CommandFactory;
use overcam::cli::Cli;

use crate::fixture::{folder, overcam, printed};

/// All flags of the program and its commands, as written, and the names of the commands.
fn flags_and_commands(command: &clap::Command, found: &mut Vec<String>) {
    for argument in command.get_arguments() {
        found.extend(argument.get_long().map(|long| format!("--{long}")));
        found.extend(argument.get_short().map(|short| format!("-{short}")));
    }
    for command in command.get_subcommands() {
        found.push(command.get_name().to_owned());
        flags_and_commands(command, found);
    }
}

fn everything() -> Vec<String> {
    let mut command = Cli::command().disable_help_subcommand(true);
    command.build();
    let mut found = Vec::new();
    flags_and_commands(&command, &mut found);
    assert!(found.len() > 40, "{found:?}");
    found
}

#[test]
fn the_manual_page_is_complete_and_man_shows_it_without_a_warning() {
    let folder = folder();
    let page = printed(folder.path(), &["man"]).join("\n") + "\n";
    let plain = page
        .replace("\\-", "-")
        .replace("\\fB", "")
        .replace("\\fR", "");
    for name in everything() {
        assert!(plain.contains(&name), "{name} is not in the page");
    }
    for heading in [
        "NAME",
        "SYNOPSIS",
        "OPTIONS",
        "COMMANDS",
        "EXIT STATUS",
        "SIGNALS",
        "ENVIRONMENT",
        "EXAMPLES",
    ] {
        let line = |line: &str| {
            line.trim_matches('"') == format!(".SH {heading}")
                || line == format!(".SH \"{heading}\"")
        };
        assert_eq!(page.lines().filter(|&l| line(l)).count(), 1, "{heading}");
    }
    let path = folder.path().join("overcam.1");
    fs::write(&path, &page).expect("it can be written");
    let mut checks = [
        (
            Command::new("man"),
            &["--warnings", "-E", "UTF-8", "-l"][..],
        ),
        (Command::new("mandoc"), &["-T", "lint", "-W", "warning"][..]),
    ];
    for (command, arguments) in &mut checks {
        let shown = command
            .args(*arguments)
            .arg(&path)
            .env("MANWIDTH", "80")
            .stdin(Stdio::null())
            .output();
        let Ok(shown) = shown else {
            eprintln!("not shown: there is no {command:?}");
            continue;
        };
        let complaints = String::from_utf8_lossy(&shown.stderr);
        assert!(
            shown.status.success() && complaints.is_empty(),
            "{complaints}"
        );
    }
}

#[test]
fn completions_know_every_flag_and_bash_completes_with_them() {
    let folder = folder();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = printed(folder.path(), &["completions", shell]).join("\n");
        for name in everything() {
            // Fish lists them without dashes.
            let name = name.trim_start_matches('-');
            assert!(script.contains(name), "{name} is not in that of {shell}");
        }
    }
    let completes = |words: &str, expected: &[&str]| {
        let line = format!(
            "eval \"$($0 completions bash)\"; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); \
             _overcam overcam \"${{COMP_WORDS[COMP_CWORD]}}\" \"${{COMP_WORDS[COMP_CWORD - 1]}}\"; \
             printf '%s\\n' \"${{COMPREPLY[@]}}\""
        );
        let output = Command::new("bash")
            .args(["--norc", "-c", &line, env!("CARGO_BIN_EXE_overcam")])
            .output();
        let Ok(output) = output else {
            eprintln!("not completed: there is no bash");
            return;
        };
        let completed = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(errors.is_empty(), "{errors}");
        let completed: Vec<&str> = completed.lines().collect();
        assert_eq!(completed, expected, "{words}");
    };
    completes(
        "overcam --record-",
        &["--record-jpeg", "--record-max", "--record-minutes"],
    );
    completes("overcam mark", &["markers"]);
    completes("overcam markers sh", &["sheet"]);
    completes("overcam markers sheet --cop", &["--copies"]);
    completes("overcam completions el", &["elvish"]);
}

#[test]
fn a_reader_that_disconnects_is_no_error() {
    let folder = folder();
    for arguments in [&["man"][..], &["completions", "bash"]] {
        let mut child = overcam(folder.path(), arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("it ends");
        assert_eq!(output.status.code(), Some(0));
        assert!(output.stderr.is_empty());
    }
}
