//! Marker drawings: one folder each, with a README that states the correct result in one line.

use std::path::Path;
use std::process::Command;

use crate::{Case, cases};

/// Exit status, and standard output followed by standard error.
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

/// The result that a README line requires.
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
        // The picture shows one plain shape, so reading that one is as good as a refusal.
        line if line.starts_with("WRONG") && line.contains("covered") => Right::Either,
        line if accepted_wrongly.iter().any(|words| line.contains(words)) => Right::Refused,
        _ => Right::Either,
    }
}

#[test]
#[ignore = "needs cases: CASES=DIR cargo test --test cases -- --ignored"]
fn drawings_are_read_as_they_are_drawn() {
    let mut wrong = Vec::new();
    for case in cases(&["svg-"]) {
        let (status, said) = overcam(&case.folder, &["markers", "check", "."]);
        let is_right = match (right(&case.readme), status) {
            (Right::Accepted | Right::Either, Some(0)) => true,
            (Right::Refused | Right::Either, Some(1)) => said.contains(';'),
            _ => false,
        };
        if !is_right {
            let Case { name, readme, .. } = case;
            wrong.push(format!("{name}: {readme}{status:?} {said}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
