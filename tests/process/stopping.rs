//! Runs that are stopped, killed, or run out of space.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::fixture::{
    PATIENCE, PLAIN, Running, folder, overcam, parse, printed, run, sequence_of, unique, y4m,
};

#[test]
fn an_interrupted_recording_is_complete() {
    let folder = folder();
    for signal in ["INT", "TERM", "HUP"] {
        let file = format!("{signal}.mcap");
        // The tests themselves may run under nohup.
        let mut command = Command::new("env");
        command
            .current_dir(folder.path())
            .args(["--default-signal=HUP", env!("CARGO_BIN_EXE_overcam")])
            .args([&PLAIN[..], &["--json", "--record", &file]].concat());
        let running = Running::start(&mut command);
        let mut lines: Vec<String> = (0..20).map(|_| running.next_line()).collect();
        running.signal(signal);
        let ended = running.end();
        assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
        lines.extend(ended.lines);
        let replayed = printed(
            folder.path(),
            &["--device", &file, "--json", "--no-publish"],
        );
        assert!(replayed == lines, "{} frames", replayed.len());
    }
}

/// `timeout` sends its signal to the program and to its group.
#[test]
fn a_signal_that_comes_twice_at_once_is_one() {
    let folder = folder();
    for file in ["first.mcap", "second.mcap", "third.mcap"] {
        let running = Running::start(&mut overcam(
            folder.path(),
            &[&PLAIN[..], &["--json", "--record", file]].concat(),
        ));
        let mut lines: Vec<String> = (0..5).map(|_| running.next_line()).collect();
        let id = running.id();
        let twice = format!("kill -INT {id}; sleep 0.02; kill -INT {id} 2>/dev/null; true");
        let sent = Command::new("sh").args(["-c", &twice]).status();
        assert!(sent.expect("sh runs").success());
        let ended = running.end();
        assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
        lines.extend(ended.lines);
        let replayed = printed(folder.path(), &["--device", file, "--json", "--no-publish"]);
        assert!(replayed == lines, "{} frames", replayed.len());
    }
}

/// `nohup` starts a program with the signal ignored, so that it outlives its terminal.
#[test]
fn an_ignored_hangup_does_not_end_the_run() {
    let folder = folder();
    let overcam = env!("CARGO_BIN_EXE_overcam");
    let mut nohup = Command::new("sh");
    nohup
        .current_dir(folder.path())
        .args(["-c", r#"trap "" HUP; exec "$0" "$@""#, overcam])
        .args([&PLAIN[..], &["--json"]].concat());
    let running = Running::start(&mut nohup);
    let first = sequence_of(&running.next_line());
    running.signal("HUP");
    for sequence in first + 1..first + 40 {
        assert_eq!(sequence_of(&running.next_line()), sequence);
    }
    running.signal("TERM");
    assert_eq!(running.end().status, Some(0));
}

#[test]
fn a_silent_pipe_does_not_keep_a_run_from_stopping() {
    let folder = folder();
    let stream = y4m(20);
    // Before the header, inside it, and inside a frame that never ends.
    for (n_bytes, n_lines) in [(0, 0), (9, 0), (stream.len() - 1000, 4)] {
        let mut running = Running::start(
            overcam(
                folder.path(),
                &[&PLAIN[..], &["--device", "-", "--learn", "15", "--json"]].concat(),
            )
            .stdin(Stdio::piped()),
        );
        let mut pipe = running.stdin.take().expect("standard input is piped");
        pipe.write_all(&stream[..n_bytes]).expect("it is read");
        let sequences: Vec<u64> = (0..n_lines)
            .map(|_| sequence_of(&running.next_line()))
            .collect();
        assert_eq!(sequences, (15..15 + n_lines).collect::<Vec<_>>());
        if n_lines == 0 {
            // Nothing shows when the program starts to wait. A signal that comes before it listens
            // ends it too, but with another status. A caught signal is visible in /proc.
            wait_until_it_catches_signals(running.id());
        }
        running.signal("INT");
        let ended = running.end();
        assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
        drop(pipe);
    }
}

#[test]
fn a_reader_that_stops_reading_does_not_keep_a_run_from_stopping() {
    let folder = folder();
    fs::write(folder.path().join("run.y4m"), y4m(400)).expect("it can be written");
    let service = unique("unread");
    let publisher = Running::start(&mut overcam(folder.path(), &["--service", &service]));
    let runs = [
        &[
            &PLAIN[..],
            &["--device", "run.y4m", "--learn", "15", "--json"],
        ]
        .concat()[..],
        &["--json", "--no-publish"],
        &["watch", "--service", &service],
    ];
    for arguments in runs {
        let mut child = overcam(folder.path(), arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        // A reader that takes the first line and nothing more. The pipe is full within a second or
        // two.
        let mut reader = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let mut line = String::new();
        reader.read_line(&mut line).expect("a line comes");
        assert_eq!(parse(&line)["frame"], "image");
        std::thread::sleep(Duration::from_secs(2));
        let id = child.id().to_string();
        let kill = Command::new("kill").args(["-INT", &id]).status();
        assert!(kill.expect("kill runs").success());
        let deadline = Instant::now() + PATIENCE;
        while child.try_wait().expect("it can be waited for").is_none() {
            assert!(Instant::now() < deadline, "{arguments:?} does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
        let output = child.wait_with_output().expect("it has ended");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{errors}");
        drop(reader);
    }
    publisher.signal("INT");
    assert_eq!(publisher.end().status, Some(0));
}

fn wait_until_it_catches_signals(id: u32) {
    // The last signal that the program registers: SIGINT is caught a moment before anything handles
    // it.
    const SIGUSR1_BIT: u64 = 1 << 9;
    loop {
        let status = fs::read_to_string(format!("/proc/{id}/status")).expect("it is alive");
        let caught = status
            .lines()
            .find_map(|line| line.strip_prefix("SigCgt:"))
            .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
            .expect("Linux tells the signals that are caught");
        if caught & SIGUSR1_BIT != 0 {
            return;
        }
        std::thread::yield_now();
    }
}

#[test]
fn a_killed_recording_loses_at_most_a_second_and_is_recovered() {
    let folder = folder();
    let running = Running::start(&mut overcam(
        folder.path(),
        &[&PLAIN[..], &["--json", "--record", "run.mcap"]].concat(),
    ));
    let mut lines: Vec<String> = (0..50).map(|_| running.next_line()).collect();
    lines.extend(running.kill());
    // The last line may have been cut off by the kill.
    lines.retain(|line| serde_json::from_str::<serde_json::Value>(line).is_ok());

    // As it is, it plays what it contains and says how to repair it.
    let replay = |file| run(folder.path(), &["--device", file, "--json", "--no-publish"]);
    let cut = replay("run.mcap");
    assert_eq!(cut.status, Some(1));
    let last = cut.errors.last().map_or("", String::as_str);
    assert!(
        last.contains("`overcam recover run.mcap -o NEW`"),
        "{:?}",
        cut.errors
    );

    let said = printed(folder.path(), &["recover", "run.mcap", "-o", "whole.mcap"]);
    let whole = replay("whole.mcap");
    assert_eq!(whole.status, Some(0), "{:?}", whole.errors);
    let n_frames = whole.lines.len();
    assert_eq!(cut.lines, whole.lines);
    assert!(
        said[0].starts_with(&format!("whole.mcap: {n_frames} frames")),
        "{said:?}"
    );
    // A frame may have been recorded whose line was not printed yet.
    let n_both = n_frames.min(lines.len());
    assert!(whole.lines[..n_both] == lines[..n_both]);
    let stamp_ns = |lines: &[String]| {
        let last = lines.last().expect("there are frames");
        parse(last)["stamp_ns"].as_u64().expect("a number")
    };
    let lost_ns = stamp_ns(&lines).saturating_sub(stamp_ns(&whole.lines));
    assert!(lost_ns <= 1_000_000_000, "{lost_ns} ns are lost");
}

#[test]
fn a_recording_without_space_loses_only_its_own_frames() {
    let folder = folder();
    // Files of at most 3 MB. Without the trap the first excess byte would kill the process.
    let command = "trap '' XFSZ; ulimit -f 6144; exec \"$0\" \"$@\"";
    let arguments = [&PLAIN[..], &["--frames", "30", "--json"]].concat();
    let limited = Running::start(
        Command::new("sh")
            .args(["-c", command, env!("CARGO_BIN_EXE_overcam")])
            .args(arguments)
            .args(["--record", "run.mcap"])
            .current_dir(folder.path())
            .stdin(Stdio::null()),
    )
    .end();
    assert_eq!(limited.status, Some(3), "{:?}", limited.errors);
    assert_eq!(limited.lines.len(), 30, "every frame has its result");
    let failed =
        |line: &&String| line.contains("run.mcap cannot be written any more (File too large");
    assert_eq!(limited.errors.iter().filter(failed).count(), 1);
    let last = limited.errors.last().map_or("", String::as_str);
    assert!(last.ends_with("lost from it"), "{:?}", limited.errors);

    // Its content replays to the same results.
    let replayed = run(
        folder.path(),
        &["--device", "run.mcap", "--json", "--no-publish"],
    );
    assert!(!replayed.lines.is_empty());
    assert!(limited.lines.starts_with(&replayed.lines));
    let expected = match replayed.lines.len() {
        1 => "; 1 frame (".to_owned(),
        n => format!("; {n} frames ("),
    };
    assert!(last.contains(&expected), "{last}");
}
