//! Standard output and standard error.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::process::Stdio;
use std::thread;
use std::time::Duration;

use serde_json::Value;

use crate::fixture::{PLAIN, Running, folder, overcam, parse, printed, run, unique, write_y4m};

/// Small frames of the demo, whose contents do not matter here.
const SMALL: [&str; 5] = ["--size", "160x120", "--no-publish", "--markers", "one"];

#[test]
fn the_demo_prints_a_line_per_frame_and_says_where_to_subscribe() {
    let folder = folder();
    let service = unique("lines");
    let ended = run(
        folder.path(),
        &["--frames", "6", "--json", "--service", &service],
    );
    assert_eq!(ended.status, Some(0));
    assert!(ended.said(&format!("overcam watch --service {service}")));
    let first = &ended.lines[0];
    let start = r#"{"sequence":0,"stamp_ns":0,"frame":"image","light":"steady","gain":["#;
    assert!(first.starts_with(start), "{first}");

    assert_eq!(ended.lines.len(), 6);
    for (sequence, line) in ended.lines.iter().enumerate() {
        let scene = parse(line);
        assert_eq!(scene["sequence"], sequence);
        assert!(scene["stamp_ns"].is_u64());
        let objects = scene["objects"].as_array().expect("objects are a list");
        assert_eq!(objects.len(), 11, "what the demo floor carries");
        objects.iter().for_each(assert_object);
        let markers = objects.iter().filter(|object| object["kind"] == "marker");
        assert_eq!(markers.count(), 6);
    }
}

/// Fields that every object has, fields of marked objects, and their shapes.
fn assert_object(object: &Value) {
    assert!(object["track"].is_u64(), "{object}");
    assert!(object["observed"].is_boolean(), "{object}");
    for key in ["x", "y", "size", "vx", "vy", "turn_rate", "age"] {
        assert!(object[key].is_f64(), "{key} of {object}");
    }
    let is_marker = object["kind"] == "marker";
    assert!(is_marker || object["kind"] == "obstacle", "{object}");
    assert_eq!(object["marker"].is_string(), is_marker, "{object}");
    assert_eq!(object["heading"].is_f64(), is_marker, "{object}");
    // Of x, y and heading, if there is one.
    assert_matrix(&object["covariance"], if is_marker { 3 } else { 2 });
    let outline = object["outline"].as_array().expect("an outline");
    assert!(outline.len() >= 3, "{object}");
    for point in object["forecast"].as_array().expect("a forecast") {
        for key in ["dt", "x", "y"] {
            assert!(point[key].is_f64(), "{key} of {point}");
        }
        assert_matrix(&point["covariance"], 2);
    }
}

fn assert_matrix(matrix: &Value, side: usize) {
    let rows = matrix.as_array().expect("a matrix is a list of rows");
    assert_eq!(rows.len(), side);
    for row in rows {
        let row = row.as_array().expect("a row is a list of numbers");
        assert!(row.len() == side && row.iter().all(Value::is_f64));
    }
}

#[test]
fn nothing_is_printed_or_published_unless_asked_for() {
    let folder = folder();
    let service = unique("silent");
    let watcher = Running::start(&mut overcam(
        folder.path(),
        &["watch", "--service", &service],
    ));
    watcher.hear("waiting for service");
    let silent = [&SMALL[..], &["--frames", "9", "--service", &service]].concat();
    let ended = run(folder.path(), &silent);
    assert_eq!(ended.status, Some(0));
    assert!(ended.lines.is_empty());
    assert!(!ended.said("publishing"));
    watcher.signal("INT");
    let watched = watcher.end();
    assert_eq!(watched.status, Some(0));
    assert!(watched.lines.is_empty());
}

#[test]
fn a_reader_that_disconnects_ends_the_run_successfully() {
    let folder = folder();
    let arguments = [&SMALL[..], &["--frames", "200", "--json"]].concat();
    let mut child = overcam(folder.path(), &arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    let mut reader = BufReader::new(child.stdout.take().expect("standard output is piped"));
    reader.read_line(&mut line).expect("a line comes");
    drop(reader);
    assert_eq!(parse(&line)["sequence"], 0);
    let output = child.wait_with_output().expect("it ends");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    // It does not continue to the end without a reader.
    let last = errors.lines().last().unwrap_or_default();
    assert!(!last.contains("200 frames"), "{errors}");
}

#[test]
fn a_list_whose_reader_disconnects_is_no_error() {
    let folder = folder();
    for arguments in [&["devices"][..], &["markers", "check"]] {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let output = overcam(folder.path(), arguments)
            .stdout(writer)
            .output()
            .expect("it runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), &*errors), (Some(0), ""));
    }
}

#[test]
fn output_that_cannot_be_written_is_an_error_in_one_line() {
    let folder = folder();
    let print = [&SMALL[..], &["--frames", "3", "--json"]].concat();
    for arguments in [&print[..], &["devices"]] {
        let full = File::create("/dev/full").expect("it can be opened");
        let output = overcam(folder.path(), arguments)
            .stdout(full)
            .output()
            .expect("it runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{errors}");
        let last = errors.lines().last().unwrap_or_default();
        assert!(
            last.starts_with("overcam: standard output: No space left"),
            "{errors}"
        );
    }
}

#[test]
fn standard_error_is_not_needed() {
    let folder = folder();
    let arguments = [&SMALL[..], &["--frames", "4", "--json"]].concat();
    let full = File::create("/dev/full").expect("it can be opened");
    let mut child = overcam(folder.path(), &arguments)
        .stdout(Stdio::piped())
        .stderr(full)
        .spawn()
        .expect("the program starts");
    let mut output = String::new();
    let mut stdout = child.stdout.take().expect("standard output is piped");
    stdout.read_to_string(&mut output).expect("it is text");
    assert_eq!(output.lines().count(), 4);
    assert_eq!(child.wait().expect("it ends").code(), Some(0));

    let status = overcam(folder.path(), &["--device", "nowhere"])
        .stderr(File::create("/dev/full").expect("it can be opened"))
        .status();
    assert_eq!(status.expect("it runs").code(), Some(1));
}

#[test]
fn a_slow_reader_loses_nothing_from_a_file() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 120);
    let arguments = [
        &PLAIN[..],
        &["--device", "run.y4m", "--learn", "15", "--json"],
    ]
    .concat();
    let expected = printed(folder.path(), &arguments);
    assert_eq!(expected.len(), 105);
    // More than a pipe holds, so the program has to wait.
    assert!(expected.iter().map(String::len).sum::<usize>() > 2 * 65_536);

    let mut child = overcam(folder.path(), &arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    thread::sleep(Duration::from_millis(500));
    let reader = BufReader::new(child.stdout.take().expect("standard output is piped"));
    let slowly = reader.lines().map(|line| {
        thread::sleep(Duration::from_millis(2));
        line.expect("it is text")
    });
    assert!(slowly.eq(expected), "some lines are missing or differ");
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
}

#[test]
fn a_source_too_short_to_learn_from_is_explained() {
    let folder = folder();
    write_y4m(&folder.path().join("short.y4m"), 20);
    let ended = run(
        folder.path(),
        &[&PLAIN[..], &["--device", "short.y4m", "--json"]].concat(),
    );
    assert_eq!(ended.status, Some(0));
    assert!(ended.lines.is_empty());
    assert!(ended.said("no results: all 20 frames went into learning"));
    assert!(ended.said("--learn N"));
}
