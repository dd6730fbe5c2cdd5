//! A file of arguments: printed, edited, used, recorded and replayed.

use std::fs;

use crate::fixture::{folder, printed, run, write_markers};

#[test]
fn settings_are_printed_edited_run_recorded_and_replayed() {
    let folder = folder();
    let path = folder.path();
    write_markers(&path.join("lab-markers"), &["arrow", "tee"]);
    let printed_file = |arguments: &[&str]| printed(path, arguments).join("\n") + "\n";

    let start = printed_file(&["--print-config", "--area-min", "120"]);
    assert!(
        start.lines().any(|line| line == "area_min = 120"),
        "{start}"
    );
    let edited = start
        .replace("# threshold = 5.0", "threshold = 6.5")
        .replace("# no_publish = true", "no_publish = true")
        .replace("# json = true", "json = true")
        .replace("# markers = <DIR>", "markers = \"lab-markers\"");
    assert_ne!(edited, start);
    fs::create_dir(path.join("conf")).expect("made");
    fs::rename(path.join("lab-markers"), path.join("conf/lab-markers")).expect("moved");
    fs::write(path.join("conf/lab.toml"), &edited).expect("written");
    // Paths in it are relative to its own folder, and are printed relative to this one.
    let as_read = printed_file(&["--config", "conf/lab.toml", "--print-config"]);
    let expected = edited.replace("\"lab-markers\"", "\"conf/lab-markers\"");
    assert_eq!(as_read, expected);

    let arguments = ["--config", "conf/lab.toml", "--frames", "20"];
    let live = printed(path, &[&arguments[..], &["--record", "run.mcap"]].concat());
    assert_eq!(live.len(), 20);
    let replayed = printed(path, &["--device", "run.mcap", "--json", "--no-publish"]);
    assert_eq!(replayed, live);

    // The recording ranks between the file and the defaults.
    let of_recording = printed_file(&["--device", "run.mcap", "--print-config"]);
    for line in ["area_min = 120", "threshold = 6.5", "# shadow = 0.6"] {
        assert!(
            of_recording.contains(&format!("\n{line}")),
            "{of_recording}"
        );
    }
    fs::write(path.join("other.toml"), "threshold = 9\n").expect("written");
    let words = [
        "--device",
        "run.mcap",
        "--print-config",
        "--config",
        "other.toml",
    ];
    let of_both = printed_file(&words);
    for line in ["area_min = 120", "threshold = 9.0"] {
        assert!(of_both.contains(&format!("\n{line}")), "{of_both}");
    }
}

#[test]
fn a_wrong_file_is_refused_in_one_line() {
    let folder = folder();
    for (text, message) in [
        (
            "\nthreshhold = 5\n",
            "line 2: there is no setting threshhold; did you mean threshold?",
        ),
        (
            "shadow = 2\n",
            "line 1: invalid value '2' for '--shadow <SHARE>': give a number from 0 to 1",
        ),
        ("plate_min = 50\nplate_max = 20\n", "plate_max is 20"),
    ] {
        fs::write(folder.path().join("lab.toml"), text).expect("written");
        let ended = run(
            folder.path(),
            &["--config", "lab.toml", "--no-publish", "--frames", "1"],
        );
        assert_ne!(ended.status, Some(0));
        assert_eq!(ended.errors.len(), 1, "{:?}", ended.errors);
        assert!(ended.said(message), "{:?}", ended.errors);
    }
    let ended = run(folder.path(), &["--config", "none.toml"]);
    assert_eq!(ended.status, Some(2));
    assert!(ended.said("none.toml"), "{:?}", ended.errors);
}
