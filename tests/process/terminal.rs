//! Output on a terminal: in a pseudo-terminal made by `script` of util-linux.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::fixture::{Running, folder, overcam, parse, unique, write_y4m};

const ESCAPE: char = '\u{1b}';

/// A demo of small frames, nearly three seconds long.
const DEMO: &str = "--size 160x120 --no-publish --markers one --frames 80";

/// Runs the program in a terminal with this many columns and returns everything written to it.
/// `None` if there is no `script`.
fn in_terminal(folder: &Path, columns: u32, environment: &str, arguments: &str) -> Option<String> {
    if Command::new("script").arg("--version").output().is_err() {
        eprintln!("not tested: there is no `script`");
        return None;
    }
    let program = env!("CARGO_BIN_EXE_overcam");
    let line = format!(
        "stty cols {columns} rows 24; export TERM=xterm; env -u NO_COLOR {environment} {program} {arguments}"
    );
    let output = Command::new("script")
        .args(["-qec", &line, "/dev/null"])
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .expect("script runs");
    let written = String::from_utf8(output.stdout).expect("it is text");
    assert!(output.status.success(), "{written}");
    Some(written)
}

/// Lines that were drawn over one another: none of them ends with a line feed.
fn drawn(written: &str) -> Vec<&str> {
    let lines = written.split("\r\u{1b}[K").skip(1);
    lines
        .filter(|line| !line.is_empty() && !line.contains('\n'))
        .collect()
}

#[test]
fn the_line_on_a_terminal_is_drawn_in_place_and_fits() {
    let folder = folder();
    for columns in [200, 61, 40, 24] {
        let Some(written) = in_terminal(folder.path(), columns, "", DEMO) else {
            return;
        };
        let lines = drawn(&written);
        assert!(!lines.is_empty(), "{written}");
        for line in lines {
            assert!(
                line.len() <= 60.min(columns as usize - 1),
                "{columns}: {line}"
            );
            assert!(line.contains("/s, ") && !line.contains(ESCAPE), "{line}");
        }
        // It is gone at the end.
        let last = written.lines().last().unwrap_or_default();
        assert!(last.contains("\r\u{1b}[Kovercam: 80 frames"), "{last:?}");
    }
}

#[test]
fn a_plain_terminal_gets_no_escape_sequences() {
    let folder = folder();
    for environment in ["TERM=dumb", "TERM=", "-u TERM", "NO_COLOR=1"] {
        let Some(written) = in_terminal(folder.path(), 80, environment, DEMO) else {
            return;
        };
        assert!(!written.contains(ESCAPE), "{environment}: {written}");
        assert!(written.contains("80 frames"), "{environment}: {written}");
    }
}

#[test]
fn learning_shows_its_progress() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 40);
    let learned = [
        (
            "learning the empty floor: 1 of 30",
            "--device run.y4m --no-publish --markers one",
        ),
        (
            "learning the empty floor: 1 of 25",
            "background --device run.y4m --learn 25 -o floor.png",
        ),
    ];
    for (expected, arguments) in learned {
        let Some(written) = in_terminal(folder.path(), 80, "", arguments) else {
            return;
        };
        let lines = drawn(&written);
        assert!(
            lines.iter().any(|line| line.contains(expected)),
            "{written}"
        );
    }
}

#[test]
fn the_line_is_redrawn_after_ctrl_z() {
    let folder = folder();
    // Long after the first line, which takes a busy machine three seconds.
    let stop_and_go = "& sleep 6; kill -STOP $!; kill -CONT $!; wait";
    let longer = DEMO.replace("80", "240");
    let arguments = format!("{longer} {stop_and_go}");
    let Some(written) = in_terminal(folder.path(), 80, "", &arguments) else {
        return;
    };
    // Lines that are due never repeat a frame.
    let lines = drawn(&written);
    assert!(lines.windows(2).any(|pair| pair[0] == pair[1]), "{written}");
}

#[test]
fn watching_on_a_terminal_shows_a_table_and_elsewhere_lines() {
    let folder = folder();
    let service = unique("table");
    let publisher = Running::start(&mut overcam(folder.path(), &["--service", &service]));
    publisher.hear("publishing on");
    let watch = format!("watch --service {service} --frames 20");
    let Some(written) = in_terminal(folder.path(), 80, "", &watch) else {
        return;
    };
    let header = format!("{service}/scene: frame ");
    assert!(written.matches(&header).count() >= 2, "{written}");
    assert!(written.contains("6 marked, 5 obstacles"), "{written}");
    // Robots with their directions and obstacles without, each only once.
    let last = written.rsplit(&header).next().unwrap_or_default();
    let rows: Vec<&str> = last
        .lines()
        .filter(|row| row.contains(" seen") && !row.contains("marked"))
        .collect();
    assert_eq!(rows.len(), 11, "{last:?}");
    assert!(rows.iter().any(|row| row.contains("obstacle")), "{last}");
    // The cursor is shown again, below the table.
    assert!(written.trim_end_matches("\r\n").ends_with("\u{1b}[?25h"));
    assert!(!written.contains("watch:"), "{written}");

    // Plain lines for a terminal that cannot draw, and if lines are requested.
    for (environment, flag) in [("TERM=dumb", ""), ("", "--json")] {
        let arguments = format!("{watch} {flag}");
        let written = in_terminal(folder.path(), 80, environment, &arguments).unwrap_or_default();
        let lines: Vec<&str> = written
            .lines()
            .filter(|line| line.starts_with('{'))
            .collect();
        assert_eq!(lines.len(), 20, "{written}");
        lines.iter().for_each(|line| drop(parse(line)));
    }
    publisher.signal("INT");
    assert_eq!(publisher.end().status, Some(0));
}
