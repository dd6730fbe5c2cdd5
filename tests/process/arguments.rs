//! Invalid arguments: status 2, and a message with the valid values.

use std::fs;

use crate::fixture::{PLAIN, folder, printed, run, write_y4m};

#[test]
fn every_number_has_a_range_that_is_reported() {
    let folder = folder();
    let cases: [(&[&str], &[&str], &str); 19] = [
        (
            &["--threshold"],
            &["nan", "inf", "-inf", "0", "-5", "0.09", "1e9", ""],
            "from 0.1 to 1000",
        ),
        (
            &["--area-min"],
            &["0", "-1", "1.5", "nan", "100000001"],
            "from 1 to 100000000",
        ),
        (
            &["--learn"],
            &["0", "-1", "108001", "99999999999"],
            "from 1 to 108000",
        ),
        (&["--frames"], &["0", "-1", "many"], "0 is not in 1.."),
        (
            &["--plate"],
            &["0", "nan", "inf", "-60", "10001"],
            "from 1 to 10000",
        ),
        (
            &["--rate"],
            &["0", "nan", "inf", "-30", "1e6"],
            "from 0.001 to 1000",
        ),
        (
            &["--exposure"],
            &["0", "-1", "nan", "60000001"],
            "from 1 to 60000000",
        ),
        (
            &["--white-balance"],
            &["0", "999", "40001"],
            "from 1000 to 40000",
        ),
        (&["--gain"], &["nan", "99999999999"], "--gain"),
        (&["--focus"], &["inf", "99999999999"], "--focus"),
        (
            &["--size"],
            &["0x0", "15x480", "640x16385", "-640x480", "nanxinf"],
            "from 16 to 16384",
        ),
        (
            &["--record", "run.mcap", "--record-jpeg"],
            &["0", "101", "nan"],
            "--record-jpeg",
        ),
        (
            &["background", "-o", "a.png", "--learn"],
            &["0", "108001"],
            "from 1 to 108000",
        ),
        (
            &["markers", "learn", "-o", "a.svg", "--learn"],
            &["0", "108001"],
            "from 1 to 108000",
        ),
        (
            &["markers", "sheet", "-o", "a.svg", "--plate"],
            &["0", "5", "181", "nan"],
            "--plate",
        ),
        (
            &["markers", "sheet", "-o", "a.svg", "--copies"],
            &["0", "101"],
            "--copies",
        ),
        (
            &["markers", "design", "-o", "new", "--count"],
            &["0", "101"],
            "--count",
        ),
        (
            &["markers", "design", "-o", "new", "--seed"],
            &["-1", "nan"],
            "--seed",
        ),
        (&["watch", "--frames"], &["0"], "0 is not in 1.."),
    ];
    for (arguments, values, range) in cases {
        for value in values {
            // With `=`, so that a minus sign is not taken for a flag.
            let (flag, before) = arguments.split_last().expect("a flag");
            let argument = format!("{flag}={value}");
            let ended = run(folder.path(), &[before, &[&argument]].concat());
            assert_eq!(ended.status, Some(2), "{argument}: {:?}", ended.errors);
            let told = ended.said(range) || range.starts_with("0 is") && *value != "0";
            assert!(told && ended.said(flag), "{argument}: {:?}", ended.errors);
            assert!(ended.lines.is_empty());
        }
    }
    // No file was created.
    let made = fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(made, 1, "only the markers of the fixture");
}

#[test]
fn services_that_cannot_be_named_are_refused() {
    let folder = folder();
    let long = "n".repeat(300);
    for (service, reason) in [
        ("two words", "contains ' '"),
        ("", "is empty"),
        ("caf\u{e9}", "contains"),
        (&long, "300 characters"),
    ] {
        for command in [&[][..], &["watch"]] {
            let ended = run(folder.path(), &[command, &["--service", service]].concat());
            assert_eq!(ended.status, Some(2), "{service}: {:?}", ended.errors);
            assert!(
                ended.said(reason) && ended.said("--service"),
                "{:?}",
                ended.errors
            );
        }
    }
}

#[test]
fn files_are_written_only_under_names_that_say_what_they_are() {
    let folder = folder();
    let cases: [(&[&str], &[&str], &str); 5] = [
        (
            &["background", "-o"],
            &["floor.jpg", "floor", "png", ".png"],
            ".png",
        ),
        (
            &["markers", "sheet", "-o"],
            &["sheet.png", "sheet", "sheet.pdf.zip"],
            ".pdf or .svg",
        ),
        (&["markers", "learn", "-o"], &["heart.png", "heart"], ".svg"),
        (&["recover", "run.mcap", "-o"], &["new.bag", "new"], ".mcap"),
        (
            &["--record"],
            &["run.bag", "run", "/dev/full", "run.mcap.gz"],
            ".mcap",
        ),
    ];
    for (arguments, files, ending) in cases {
        for file in files {
            let ended = run(folder.path(), &[arguments, &[file]].concat());
            assert_eq!(ended.status, Some(2), "{file}: {:?}", ended.errors);
            let told = format!("must end in {ending}");
            assert!(ended.said(&told), "{file}: {:?}", ended.errors);
        }
    }
    let made = fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(made, 1, "only the markers of the fixture");
    let sheet = ["markers", "sheet", "one", "-o", "SHEET.PDF"];
    assert_eq!(printed(folder.path(), &sheet), ["SHEET.PDF"]);
    let pdf = fs::read(folder.path().join("SHEET.PDF")).expect("it was written");
    assert!(pdf.starts_with(b"%PDF"));
}

#[test]
fn a_plate_needs_a_floor() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 3);
    for source in ["demo", "run.y4m"] {
        let ended = run(
            folder.path(),
            &[
                "--device",
                source,
                "--frames",
                "1",
                "--no-publish",
                "--plate",
                "60",
            ],
        );
        assert_eq!(ended.status, Some(2), "{:?}", ended.errors);
        assert!(
            ended.said("--plate: ") && ended.said("--calibration"),
            "{:?}",
            ended.errors
        );
        assert_eq!(ended.errors.len(), 1);
    }
}

/// The settings of a recording have the ranges of the arguments.
#[test]
fn settings_of_a_recording_are_checked() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 20);
    let record = [
        "--device", "run.y4m", "--learn", "15", "--record", "run.mcap",
    ];
    printed(folder.path(), &[&PLAIN[..], &record].concat());
    let recording = fs::read(folder.path().join("run.mcap")).expect("it was recorded");
    let replace = |from: &[u8], to: &[u8]| {
        assert_eq!(from.len(), to.len());
        let mut changed = recording.clone();
        let at = changed.windows(from.len()).position(|part| part == from);
        let at = at.expect("the settings are there as text");
        changed[at..at + to.len()].copy_from_slice(to);
        fs::write(folder.path().join("changed.mcap"), changed).expect("it can be written");
    };
    let replay = ["--device", "changed.mcap", "--no-publish"];
    replace(b"threshold = 5.0", b"threshold = 6.0");
    printed(folder.path(), &replay);
    for value in [b"threshold = nan", b"threshold = 0.0"] {
        replace(b"threshold = 5.0", value);
        let ended = run(folder.path(), &replay);
        assert_eq!(ended.status, Some(1), "{:?}", ended.errors);
        assert!(
            ended.said("changed.mcap: its settings: the setting threshold is")
                && ended.said("from 0.1 to 1000"),
            "{:?}",
            ended.errors
        );
    }
}
