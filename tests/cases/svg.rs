//! Marker drawings: one folder each, with a README whose line says what is right.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folders whose names begin like this, in the folder that CASES names.
pub(crate) fn cases(kind: &str) -> Vec<PathBuf> {
    let Some(folder) = std::env::var_os("CASES") else {
        return Vec::new();
    };
    let entries = fs::read_dir(folder).expect("CASES names a folder");
    let mut cases: Vec<PathBuf> = entries
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(kind)
        })
        .collect();
    cases.sort();
    cases
}

/// Exit status and standard output with standard error.
pub(crate) fn overcam(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_overcam"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts");
    let said = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8_lossy(&said).into_owned(),
    )
}

/// What a README line asks for.
#[derive(Debug, PartialEq)]
enum Right {
    Accepted,
    Refused,
    /// Either, but a refusal must say what to do.
    Either,
}

fn right(readme: &str) -> Right {
    let accepted_wrongly = ["accepted", "dropped without", "become two"];
    match readme {
        line if line.starts_with("RIGHT (refused") => Right::Refused,
        line if line.starts_with("RIGHT") => Right::Accepted,
        line if line.starts_with("WRONG (refused") => Right::Accepted,
        // The picture shows one plain shape: reading that one is as good as a refusal.
        line if line.starts_with("WRONG") && line.contains("covered") => Right::Either,
        line if accepted_wrongly.iter().any(|words| line.contains(words)) => Right::Refused,
        _ => Right::Either,
    }
}

#[test]
fn drawings_are_read_as_they_are_drawn() {
    let mut wrong = Vec::new();
    for case in cases("svg-") {
        let readme = fs::read_to_string(case.join("README")).expect("a README");
        let (status, said) = overcam(&case, &["markers", "check", "."]);
        let is_right = match (right(&readme), status) {
            (Right::Accepted | Right::Either, Some(0)) => true,
            (Right::Refused | Right::Either, Some(1)) => said.contains(';'),
            _ => false,
        };
        if !is_right {
            wrong.push(format!("{}: {readme}{status:?} {said}", case.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
