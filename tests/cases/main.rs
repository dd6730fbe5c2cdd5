//! Cases from the field: folders with a README that states in one line the correct result, and
//! which files it needs.
//!
//! The folders are not part of the project. `CASES=DIR cargo test --test cases -- --ignored` runs
//! the program in each folder of DIR and checks the statement of its README. A folder with an
//! unknown name but of a known kind (the word before the first `-`) is run as its README says and
//! must not make the program panic or hang.

mod calibration;
mod pictures;
mod svg;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

/// A process that takes longer counts as hung.
const PATIENCE: Duration = Duration::from_secs(120);

/// A folder of CASES.
#[derive(Debug)]
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    pub(crate) readme: String,
}

/// Output and exit status of a run of the program.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) status: Option<i32>,
    /// JSON objects on standard output.
    pub(crate) scenes: Vec<Value>,
    /// Standard error.
    pub(crate) said: String,
}

/// The cases whose names start with one of these kinds, in order of their names.
pub(crate) fn cases(kinds: &[&str]) -> Vec<Case> {
    let folder = std::env::var_os("CASES").expect("CASES names the folder of the cases");
    // The program runs in the folder of the case.
    let folder = fs::canonicalize(folder).expect("the folder of CASES is there");
    let entries = fs::read_dir(folder).expect("the folder of CASES can be listed");
    let mut cases: Vec<Case> = entries
        .map(|entry| entry.expect("the folder of CASES can be listed").path())
        .filter(|path| path.is_dir())
        .map(|folder| Case {
            name: folder
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            readme: fs::read_to_string(folder.join("README")).unwrap_or_default(),
            folder,
        })
        .filter(|case| kinds.iter().any(|kind| case.name.starts_with(kind)))
        .collect();
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    cases
}

impl Case {
    pub(crate) fn has(&self, file: &str) -> bool {
        self.folder.join(file).exists()
    }

    /// Runs the program in the case's folder, without shared memory.
    pub(crate) fn run(&self, arguments: &[&str]) -> Ended {
        let ended = run_in(&self.folder, &[arguments, &["--no-publish"]].concat());
        assert!(
            !ended.said.contains("panicked"),
            "{}: {arguments:?}: {}",
            self.name,
            ended.said
        );
        let status = ended.status.expect("it ends by itself");
        assert!(
            (0..=3).contains(&status),
            "{}: status {status}: {}",
            self.name,
            ended.said
        );
        ended
    }

    /// Runs the program, which must succeed.
    pub(crate) fn succeed(&self, arguments: &[&str]) -> Ended {
        let ended = self.run(arguments);
        assert_eq!(ended.status, Some(0), "{}: {}", self.name, ended.said);
        ended
    }

    /// Runs the program as the README says, as far as it does, and only checks that it ends
    /// properly.
    pub(crate) fn run_as_documented(&self) {
        let commands = self
            .readme
            .match_indices("overcam --")
            .map(|(at, _)| &self.readme[at + 8..]);
        let mut n_run = 0;
        for command in commands {
            let command = command.lines().next().unwrap_or_default();
            let words = command.split_whitespace();
            let mut arguments: Vec<&str> = words
                .take_while(|word| !word.starts_with(['(', '|', '#', '>']))
                .collect();
            arguments.retain(|&word| word != "--no-publish");
            if !arguments.contains(&"--device") && !arguments.contains(&"--frames") {
                arguments.extend(["--frames", "5"]);
            }
            self.run(&arguments);
            n_run += 1;
        }
        eprintln!(
            "{}: not known; {n_run} commands of its README were run",
            self.name
        );
    }
}

pub(crate) fn run_in(folder: &Path, arguments: &[&str]) -> Ended {
    let mut child = Command::new(env!("CARGO_BIN_EXE_overcam"))
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let read = |stream: Option<Box<dyn Read + Send>>| {
        let mut stream = stream.expect("the stream is piped");
        thread::spawn(move || {
            let mut bytes = Vec::new();
            stream.read_to_end(&mut bytes).expect("it can be read");
            String::from_utf8_lossy(&bytes).into_owned()
        })
    };
    let printed = read(child.stdout.take().map(|stream| Box::new(stream) as _));
    let said = read(child.stderr.take().map(|stream| Box::new(stream) as _));
    let deadline = Instant::now() + PATIENCE;
    let status = loop {
        if let Some(status) = child.try_wait().expect("it can be waited for") {
            break status;
        }
        if Instant::now() > deadline {
            let _ = child.kill();
            let _ = child.wait();
            panic!("{arguments:?} in {} does not end", folder.display());
        }
        thread::sleep(Duration::from_millis(5));
    };
    let printed = printed.join().expect("standard output is read");
    Ended {
        status: status.code(),
        scenes: printed
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect(),
        said: said.join().expect("standard error is read"),
    }
}

/// Objects of a scene that were observed in its frame.
pub(crate) fn observed(scene: &Value) -> Vec<&Value> {
    let objects = scene["objects"].as_array().expect("objects are a list");
    objects
        .iter()
        .filter(|object| object["observed"] == true)
        .collect()
}
