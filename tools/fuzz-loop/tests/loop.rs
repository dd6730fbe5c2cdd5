//! The loop itself: that its files are good, that a failure would be told, and that nothing fails
//! at once.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use fuzz_loop::{FORMATS, mutation};

fn fuzz_loop(args: &[&str]) -> Output {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    Command::new(env!("CARGO_BIN_EXE_fuzz-loop"))
        .args(args)
        .current_dir(folder.path())
        .output()
        .expect("the program starts")
}

#[test]
fn every_seed_is_read_to_its_end() {
    for format in &FORMATS {
        for (i, file) in (format.seeds)().iter().enumerate() {
            assert!((format.read)(file), "{} {i} is refused", format.name);
        }
    }
}

#[test]
fn an_input_depends_on_its_seed_and_number_alone() {
    for format in &FORMATS {
        let files = (format.seeds)();
        assert_eq!(files, (format.seeds)(), "{}", format.name);
        let input = |seed, number| mutation::input(format, &files, seed, number);
        assert_eq!(input(1, 1000), input(1, 1000));
        assert_ne!(
            (input(1, 1000), input(1, 1001)),
            (input(2, 1000), input(2, 1001))
        );
    }
}

#[test]
fn all_formats_are_read_for_a_moment() {
    let output = fuzz_loop(&["--seconds", "0"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}");
    for format in &FORMATS {
        assert!(text.contains(&format!("{}: ", format.name)), "{text}");
    }
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    [&[opcode][..], &length, content].concat()
}

/// An MCAP file with a header and a record is refused or read in order.
fn ends_in_order(record_bytes: &[u8]) {
    let header = record(mcap::records::op::HEADER, &[0; 8]);
    let file = [mcap::MAGIC, &header, record_bytes].concat();
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("found.mcap");
    fs::write(&path, file).expect("a file can be written there");
    let path = path.to_str().expect("a path in UTF-8");
    let output = fuzz_loop(&["--input", "mcap", path]);
    assert!(output.status.success(), "{output:?}");
}

/// Found by fuzzing: memory was taken for the 2 GiB that a text of a short file claims.
#[test]
fn a_text_that_claims_to_be_endless_costs_no_memory() {
    let schema = [&[1, 0][..], &0x7fff_ffff_u32.to_le_bytes(), b"name"].concat();
    ends_in_order(&record(mcap::records::op::SCHEMA, &schema));
}

/// Found by fuzzing: a panic.
#[test]
fn a_record_that_reaches_out_of_its_chunk_is_no_fault_of_the_program() {
    let inside = record(mcap::records::op::MESSAGE, &[0; 30]);
    let n_inside = (inside.len() as u64 - 10).to_le_bytes();
    // Two times, the size, no check sum, no compression, and the size again.
    let head = [&[0; 16][..], &n_inside, &[0; 8], &n_inside].concat();
    let length = (head.len() as u64 + inside.len() as u64 - 10).to_le_bytes();
    ends_in_order(&[&[mcap::records::op::CHUNK][..], &length, &head, &inside].concat());
}

#[test]
fn what_is_not_known_is_refused() {
    for args in [&["gif"][..], &["--seed"], &["--input", "png", "/none"]] {
        assert_eq!(fuzz_loop(args).status.code(), Some(2), "{args:?}");
    }
}

#[test]
fn libfuzzer_has_a_target_for_every_format() {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    let manifest = fs::read_to_string(fuzz.join("Cargo.toml")).expect("fuzz is there");
    for format in &FORMATS {
        let path = format!("fuzz_targets/{}.rs", format.name);
        assert!(manifest.contains(&path), "{path}");
        let target = fs::read_to_string(fuzz.join(&path)).expect("the target is there");
        let call = format!("fuzz_loop::readers::{}(", format.name);
        assert!(target.contains(&call), "{path}");
    }
}
