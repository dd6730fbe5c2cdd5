//! The program as a process, and files for it to read.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

/// A process that takes longer to do something counts as hung.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// For runs in which neither markers nor shared memory matter: learning the built-in markers would
/// take most of the time.
pub(crate) const PLAIN: [&str; 3] = ["--no-publish", "--markers", "one"];

/// A folder for one test. It holds the marker of [`PLAIN`].
pub(crate) fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder can be made");
    write_markers(&folder.path().join("one"), &["arrow"]);
    folder
}

/// The built program in a folder, with empty standard input.
pub(crate) fn overcam(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_overcam"));
    command
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null());
    command
}

/// Runs the program to its end.
pub(crate) fn run(folder: &Path, arguments: &[&str]) -> Ended {
    Running::start(&mut overcam(folder, arguments)).end()
}

/// Runs the program to its end, which must be successful, and returns its standard output.
pub(crate) fn printed(folder: &Path, arguments: &[&str]) -> Vec<String> {
    let ended = run(folder, arguments);
    assert_eq!(ended.status, Some(0), "{arguments:?}: {:?}", ended.errors);
    ended.lines
}

/// A name that no other test or run uses.
pub(crate) fn unique(name: &str) -> String {
    format!("overcam-test-{}-{name}", std::process::id())
}

pub(crate) fn parse(line: &str) -> Value {
    serde_json::from_str(line).expect("a line is a JSON object")
}

pub(crate) fn sequence_of(line: &str) -> u64 {
    parse(line)["sequence"].as_u64().expect("a number")
}

/// How a process ended, and its remaining output.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) status: Option<i32>,
    /// Lines on standard output.
    pub(crate) lines: Vec<String>,
    /// Lines on standard error.
    pub(crate) errors: Vec<String>,
}

impl Ended {
    /// Whether any line on standard error contains `text`.
    pub(crate) fn said(&self, text: &str) -> bool {
        self.errors.iter().any(|line| line.contains(text))
    }
}

/// A process whose lines arrive one by one. It is killed when dropped.
pub(crate) struct Running {
    child: Child,
    /// Kept open if it is a pipe.
    pub(crate) stdin: Option<ChildStdin>,
    lines: Receiver<String>,
    errors: Receiver<String>,
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let lines = lines_of(child.stdout.take().expect("standard output is piped"));
        let errors = lines_of(child.stderr.take().expect("standard error is piped"));
        Self {
            stdin: child.stdin.take(),
            child,
            lines,
            errors,
        }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// The next line on standard output.
    pub(crate) fn next_line(&self) -> String {
        let line = self.lines.recv_timeout(PATIENCE);
        line.expect("a line comes on standard output")
    }

    /// Waits for a line on standard error that contains `text`.
    pub(crate) fn hear(&self, text: &str) {
        loop {
            let line = self.errors.recv_timeout(PATIENCE);
            let line = line.unwrap_or_else(|_| panic!("`{text}` is never said"));
            if line.contains(text) {
                return;
            }
        }
    }

    pub(crate) fn signal(&self, name: &str) {
        let command = format!("kill -{name} {}", self.id());
        let status = Command::new("sh").args(["-c", &command]).status();
        assert!(status.expect("sh runs").success());
    }

    /// Kills it like `kill -9`. Returns what it had printed.
    pub(crate) fn kill(mut self) -> Vec<String> {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it can be waited for");
        self.lines.iter().collect()
    }

    /// Waits until it ends by itself.
    pub(crate) fn end(mut self) -> Ended {
        let deadline = Instant::now() + PATIENCE;
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("it can be waited for") {
                break status;
            }
            assert!(Instant::now() < deadline, "it does not end");
            thread::sleep(Duration::from_millis(2));
        };
        Ended {
            status: status.code(),
            lines: self.lines.iter().collect(),
            errors: self.errors.iter().collect(),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn lines_of(stream: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

/// Size of the frames that [`y4m`] draws.
pub(crate) const WIDTH: usize = 160;
pub(crate) const HEIGHT: usize = 120;

/// A Y4M stream, 4:2:0 at 30 frames per second: a bright and a red rectangle cross a grey floor. No
/// pixel is covered for more than 6 frames, so the floor can be learned from 13 or more.
pub(crate) fn y4m(n_frames: usize) -> Vec<u8> {
    let mut stream = format!("YUV4MPEG2 W{WIDTH} H{HEIGHT} F30:1 Ip C420jpeg\n").into_bytes();
    for n in 0..n_frames {
        stream.extend_from_slice(b"FRAME\n");
        let shifted = 3 * n % (WIDTH - 20);
        let bright = Rectangle {
            left: shifted,
            top: 20,
        };
        let red = Rectangle {
            left: WIDTH - 20 - shifted,
            top: 80,
        };
        plane(&mut stream, 1, 110, &[(bright, 220), (red, 90)]);
        plane(&mut stream, 2, 128, &[(red, 110)]);
        plane(&mut stream, 2, 128, &[(red, 200)]);
    }
    stream
}

pub(crate) fn write_y4m(path: &Path, n_frames: usize) {
    fs::write(path, y4m(n_frames)).expect("the file can be written");
}

/// A rectangle of 18 x 14 pixels.
#[derive(Clone, Copy)]
struct Rectangle {
    left: usize,
    top: usize,
}

/// Adds a plane in which each sample covers `step` x `step` pixels.
fn plane(stream: &mut Vec<u8>, step: usize, floor: u8, rectangles: &[(Rectangle, u8)]) {
    for y in (0..HEIGHT).step_by(step) {
        for x in (0..WIDTH).step_by(step) {
            let inside = |r: &Rectangle| {
                (r.left..r.left + 18).contains(&x) && (r.top..r.top + 14).contains(&y)
            };
            let found = rectangles.iter().find(|(rectangle, _)| inside(rectangle));
            stream.push(found.map_or(floor, |(_, value)| *value));
        }
    }
}

/// Writes the built-in drawings of these markers into a new folder.
pub(crate) fn write_markers(folder: &Path, names: &[&str]) {
    fs::create_dir(folder).expect("the folder can be made");
    let built_in = Path::new(env!("CARGO_MANIFEST_DIR")).join("markers");
    for name in names {
        let file = format!("{name}.svg");
        fs::copy(built_in.join(&file), folder.join(&file)).expect("the drawing can be copied");
    }
}

/// Point pairs of a calibration file: pixels and metres.
pub(crate) type Pairs<'a> = &'a [([f64; 2], [f64; 2])];

/// A camera straight above the demo floor, at 100 pixels per metre.
pub(crate) const STRAIGHT: Pairs = &[
    ([0.0, 0.0], [0.0, 4.8]),
    ([640.0, 0.0], [6.4, 4.8]),
    ([640.0, 480.0], [6.4, 0.0]),
    ([0.0, 480.0], [0.0, 0.0]),
];

pub(crate) fn write_calibration(path: &Path, pairs: Pairs) {
    let mut text = String::new();
    for (pixel, floor) in pairs {
        writeln!(text, "[[points]]\npixel = {pixel:?}\nfloor = {floor:?}").expect("a string grows");
    }
    let mut file = File::create_new(path).expect("the file can be created");
    file.write_all(text.as_bytes()).expect("it can be written");
}
