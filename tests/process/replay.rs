//! A recording replays to the same results without any other file.

use std::fs;
use std::path::Path;
use std::process::Command;

use imgproc::Size;
use overcam::image::frame::Picture;
use overcam::image::picture_file::write_png;

use crate::fixture::{
    HEIGHT, STRAIGHT, WIDTH, folder, parse, printed, run, sequence_of, write_calibration,
    write_markers, write_y4m,
};

/// Records with these arguments, replays the recording, and replays the recording of the replay.
/// Returns the lines that all three print.
fn record_and_replay(folder: &Path, arguments: &[&str]) -> Vec<String> {
    let live = [
        arguments,
        &["--record", "run.mcap", "--json", "--no-publish"],
    ];
    let lines = printed(folder, &live.concat());
    // The recording must be enough.
    for name in ["markers", "one", "floor.toml", "empty.png", "run.y4m"] {
        let path = folder.join(name);
        if path.is_dir() {
            fs::remove_dir_all(path).expect("the folder can be removed");
        } else if path.exists() {
            fs::remove_file(path).expect("the file can be removed");
        }
    }
    let replay = ["--device", "run.mcap", "--json", "--no-publish"];
    let again = [&replay[..], &["--record", "again.mcap"]].concat();
    assert_same(&lines, &printed(folder, &again));
    let third = ["--device", "again.mcap", "--json", "--no-publish"];
    assert_same(&lines, &printed(folder, &third));
    lines
}

fn assert_same(expected: &[String], lines: &[String]) {
    for (expected, line) in expected.iter().zip(lines) {
        assert_eq!(expected, line);
    }
    assert_eq!(expected.len(), lines.len());
}

#[test]
fn the_demo_replays() {
    let folder = folder();
    let lines = record_and_replay(folder.path(), &["--frames", "25"]);
    assert_eq!(lines.len(), 25);
}

#[test]
#[ignore = "needs python3 with mcap and mcap-protobuf-support: cargo test --test process -- --ignored python"]
fn a_reader_in_python_reads_the_demos_recording() {
    let folder = folder();
    record_and_replay(folder.path(), &["--frames", "25"]);
    for recording in ["run.mcap", "again.mcap"] {
        let output = Command::new("python3")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_mcap.py"))
            .arg(folder.path().join(recording))
            .output()
            .expect("python3 can be run");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            text.contains("attachment background.png image/png"),
            "{text}"
        );
        assert!(text.contains("attachment markers/arrow.svg"), "{text}");
        for topic in [
            "/camera/image foxglove.RawImage 25",
            "/overcam/poses foxglove.PosesInFrame 25",
            "/tf foxglove.FrameTransform 1",
        ] {
            assert!(text.contains(topic), "{topic} in {text}");
        }
    }
}

#[test]
fn a_calibration_is_part_of_the_recording() {
    let folder = folder();
    write_calibration(&folder.path().join("floor.toml"), STRAIGHT);
    let lines = record_and_replay(
        folder.path(),
        &["--frames", "8", "--calibration", "floor.toml"],
    );
    let scene = parse(&lines[7]);
    assert_eq!(scene["frame"], "floor");
    // The parked triangle: 585, 420 px at 100 px per metre, y up from the lower edge; rotated by
    // 0.7 in the picture.
    let objects = scene["objects"].as_array().expect("objects are a list");
    let parked = objects
        .iter()
        .find(|object| object["marker"] == "triangle")
        .expect("the triangle is seen");
    for (key, expected, tolerance) in [
        ("x", 5.85, 0.003),
        ("y", 0.6, 0.003),
        ("heading", -0.7, 0.03),
    ] {
        let value = parked[key].as_f64().expect("a number");
        assert!((value - expected).abs() < tolerance, "{key} {value}");
    }
}

#[test]
fn markers_and_settings_are_part_of_the_recording() {
    let folder = folder();
    write_markers(&folder.path().join("markers"), &["arrow", "cup"]);
    let arguments = ["--frames", "8", "--markers", "markers", "--area-min", "900"];
    let lines = record_and_replay(folder.path(), &arguments);
    let scene = parse(&lines[7]);
    let objects = scene["objects"].as_array().expect("objects are a list");
    let names: Vec<&str> = objects
        .iter()
        .filter_map(|object| object["marker"].as_str())
        .collect();
    assert!(names.len() == 2 && names.contains(&"arrow") && names.contains(&"cup"));
    // Of the demo's eleven objects, one covers 707 square pixels.
    assert!(objects.len() < 11, "{} objects", objects.len());
}

#[test]
fn a_learned_floor_is_part_of_the_recording() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 40);
    let lines = record_and_replay(
        folder.path(),
        &["--device", "run.y4m", "--learn", "15", "--markers", "one"],
    );
    assert_eq!(lines.len(), 25);
    assert_eq!(parse(&lines[0])["sequence"], 15);
    for line in &lines {
        assert_rectangles(line);
    }
}

#[test]
fn a_picture_of_the_floor_is_part_of_the_recording() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 20);
    let size = Size {
        width: WIDTH,
        height: HEIGHT,
    };
    let plane = vec![110; size.area()];
    let empty = Picture {
        size,
        red: plane.clone(),
        green: plane.clone(),
        blue: plane,
    };
    fs::write(folder.path().join("empty.png"), write_png(&empty)).expect("it can be written");
    let arguments = [
        "--device",
        "run.y4m",
        "--background",
        "empty.png",
        "--markers",
        "one",
    ];
    let lines = record_and_replay(folder.path(), &arguments);
    assert_eq!(lines.len(), 20);
    for line in &lines {
        assert_rectangles(line);
    }
}

/// The two obstacles of the stream at the drawn positions: 3 pixels farther in each frame.
fn assert_rectangles(line: &str) {
    let scene = parse(line);
    let objects = scene["objects"].as_array().expect("objects are a list");
    assert_eq!(objects.len(), 2, "{line}");
    let shifted = 3.0 * scene["sequence"].as_f64().expect("a number");
    for (x, y) in [
        (shifted + 8.5, 26.5),
        (WIDTH as f64 - 20.0 - shifted + 8.5, 86.5),
    ] {
        let near = |key: &str, object: &serde_json::Value, at: f64| {
            // Chroma has half the resolution.
            (object[key].as_f64().expect("a number") - at).abs() < 1.5
        };
        let found = objects
            .iter()
            .any(|object| near("x", object, x) && near("y", object, y));
        assert!(found, "nothing at {x}, {y}: {line}");
    }
}

#[test]
fn a_recording_in_several_files_replays_file_by_file() {
    let folder = folder();
    let record = |file: &str| {
        let arguments = [
            "--frames",
            "110",
            "--record",
            file,
            "--record-minutes",
            "0.02",
        ];
        run(
            folder.path(),
            &[&arguments[..], &["--json", "--no-publish"]].concat(),
        )
    };
    let ended = record("run.mcap");
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    assert!(ended.said("MB a minute"), "{:?}", ended.errors);
    assert!(ended.said("recording goes on in run-2.mcap; run.mcap is complete: "));
    let last = ended.errors.last().map_or("", String::as_str);
    assert!(
        last.contains("; 110 frames (") && last.ends_with(" in 3 files, the last run-3.mcap"),
        "{last}"
    );

    let replay = |file| printed(folder.path(), &["--device", file, "--json", "--no-publish"]);
    let files = ["run.mcap", "run-2.mcap", "run-3.mcap"].map(replay);
    assert_same(&ended.lines[..files[0].len()], &files[0]);
    let numbers =
        |lines: &[String]| -> Vec<u64> { lines.iter().map(|line| sequence_of(line)).collect() };
    assert_eq!(numbers(&files.concat()), numbers(&ended.lines));
    // Tracks start again with new ids, velocities, forecasts and merges. The robots' positions are
    // the same.
    for (line, live) in files.concat().iter().zip(&ended.lines) {
        let (found, expected) = (robots(line), robots(live));
        assert_eq!(found.len(), 6, "{}", sequence_of(line));
        for ((name, x, y), (expected_name, expected_x, expected_y)) in found.iter().zip(&expected) {
            assert_eq!(name, expected_name);
            let off = (x - expected_x).hypot(y - expected_y);
            assert!(
                off < 0.1,
                "frame {}: {name} is {off} px off",
                sequence_of(line)
            );
        }
    }

    // The same input gives the same files, regardless of thread scheduling.
    record("again.mcap");
    for number in ["", "-2", "-3"] {
        let file = |name: &str| {
            let path = folder.path().join(format!("{name}{number}.mcap"));
            fs::read(path).expect("it can be read")
        };
        assert!(file("run") == file("again"), "{number}");
    }

    // Existing files are not overwritten.
    fs::remove_file(folder.path().join("run.mcap")).expect("it can be removed");
    let refused = record("run.mcap");
    assert_eq!(refused.status, Some(1));
    assert!(
        refused.said("run-2.mcap exists already"),
        "{:?}",
        refused.errors
    );
}

#[test]
fn invalid_file_limits_are_wrong_arguments() {
    let folder = folder();
    for flag in ["--record-max", "--record-minutes"] {
        for value in ["0", "-1", "nan", "inf", "1e9", "many", ""] {
            let value = format!("{flag}={value}");
            let ended = run(folder.path(), &["--record", "run.mcap", &value]);
            assert_eq!(ended.status, Some(2), "{value}: {:?}", ended.errors);
        }
        let ended = run(folder.path(), &[flag, "1"]);
        assert_eq!(
            ended.status,
            Some(2),
            "without --record: {:?}",
            ended.errors
        );
    }
    assert!(!folder.path().join("run.mcap").exists());
}

/// Names and positions of the robots in a line.
fn robots(line: &str) -> Vec<(String, f64, f64)> {
    let scene = parse(line);
    let objects = scene["objects"].as_array().expect("a list").iter();
    let mut robots: Vec<_> = objects
        .filter_map(|object| {
            let number = |key| object[key].as_f64().expect("a number");
            let name = object["marker"].as_str()?.to_owned();
            Some((name, number("x"), number("y")))
        })
        .collect();
    robots.sort_by(|a, b| a.0.cmp(&b.0));
    robots
}
