//! overcam under systemd: the unit that it prints, and its notifications.

use std::fs;
use std::io::Write;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::fixture::{PATIENCE, PLAIN, Running, folder, overcam, printed, run, y4m};

/// All words up to and including `word`.
fn words_until(socket: &UnixDatagram, word: &str) -> Vec<String> {
    socket
        .set_read_timeout(Some(Duration::from_millis(100)))
        .expect("set");
    let deadline = Instant::now() + PATIENCE;
    let mut words = Vec::new();
    let mut buffer = [0; 256];
    while Instant::now() < deadline {
        let Ok(length) = socket.recv(&mut buffer) else {
            continue;
        };
        words.push(String::from_utf8_lossy(&buffer[..length]).into_owned());
        if words.last().is_some_and(|last| last == word) {
            return words;
        }
    }
    panic!("{word} is never told: {words:?}");
}

#[test]
fn systemd_gets_heartbeats_even_without_frames() {
    let folder = folder();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).expect("bound");
    let mut running = Running::start(
        overcam(
            folder.path(),
            &[&PLAIN[..], &["--device", "-", "--learn", "15"]].concat(),
        )
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "400000")
        .stdin(Stdio::piped()),
    );
    let mut pipe = running.stdin.take().expect("standard input is piped");
    pipe.write_all(&y4m(3)).expect("it is read");
    let first = words_until(&socket, "READY=1");
    assert_eq!(first, ["READY=1"], "nothing before that");
    for _ in 0..5 {
        words_until(&socket, "WATCHDOG=1");
    }
    running.signal("TERM");
    words_until(&socket, "STOPPING=1");
    assert_eq!(running.end().status, Some(0));
    drop(pipe);
}

#[test]
fn a_run_that_cannot_start_is_never_ready() {
    let folder = folder();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).expect("bound");
    let arguments = [&PLAIN[..], &["--device", "missing.y4m"]].concat();
    let mut command = overcam(folder.path(), &arguments);
    let ended = Running::start(command.env("NOTIFY_SOCKET", &path)).end();
    assert_eq!(ended.status, Some(1));
    socket.set_nonblocking(true).expect("set");
    assert!(socket.recv(&mut [0; 64]).is_err());
}

#[test]
fn a_unit_starts_what_the_call_would() {
    let folder = folder();
    let here = folder.path().canonicalize().expect("it is there");
    let unit = printed(
        folder.path(),
        &[
            "service",
            "--device",
            "a b.y4m",
            "--record=run.mcap",
            "--frames",
            "9",
        ],
    );
    let exec = format!(
        "ExecStart={} --device \"{}/a b.y4m\" --record {}/run-${{INVOCATION_ID}}.mcap --frames 9",
        env!("CARGO_BIN_EXE_overcam"),
        here.display(),
        here.display()
    );
    assert!(unit.contains(&exec), "{exec}\n{unit:#?}");
    for line in [
        "Type=notify",
        "WatchdogSec=30",
        "Restart=on-failure",
        "RuntimeDirectory=overcam",
    ] {
        assert!(unit.iter().any(|found| found == line), "{line}: {unit:#?}");
    }
    assert!(!here.join("run.mcap").exists());
}

#[test]
fn arguments_that_are_wrong_for_a_run_are_wrong_for_a_service() {
    let folder = folder();
    for arguments in [
        &["service", "--learn", "0"][..],
        &["service", "--device", "-"],
    ] {
        let ended = run(folder.path(), arguments);
        assert_eq!(ended.status, Some(2), "{arguments:?}");
        assert!(ended.lines.is_empty());
    }
}

/// Needs `systemd-analyze`: cargo test --test process -- --ignored systemd_accepts_the_unit
#[test]
#[ignore = "needs systemd-analyze"]
fn systemd_accepts_the_unit() {
    let folder = folder();
    for arguments in [
        &["service"][..],
        &[
            "service",
            "--group",
            "video",
            "--record",
            "50% of $x/run.mcap",
            "--service",
            "a;b",
        ],
    ] {
        let unit = printed(folder.path(), arguments).join("\n") + "\n";
        // The user that the unit names is created at installation.
        let unit = unit.replace("User=overcam\n", "User=root\n");
        let file = folder.path().join("overcam-test.service");
        fs::write(&file, unit).expect("written");
        verify(&file);
    }
}

fn verify(unit: &Path) {
    let verified = Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(unit)
        .output()
        .expect("systemd-analyze runs");
    let said = String::from_utf8_lossy(&verified.stderr);
    let of_this: Vec<&str> = said
        .lines()
        .filter(|line| line.contains("overcam-test"))
        .collect();
    assert!(verified.status.success() && of_this.is_empty(), "{said}");
}
