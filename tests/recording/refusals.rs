//! Files that cannot be replayed, recovered or recorded are refused in one line that names them.

use std::fs;
use std::path::Path;

use overcam::image::frame::PixelFormat;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::record::{RecordError, Recorder};
use overcam::output::mcap::recover::{RecoverError, recover};

use crate::fixture::{SIZE, assert_one_line, folder, info, play, provenance, record, slots};

#[test]
fn what_is_no_recording_is_refused_in_one_line() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("empty.mcap"), b"").expect("the file can be written");
    fs::write(path("text.mcap"), b"once upon a time").expect("the file can be written");
    fs::create_dir(path("folder.mcap")).expect("the folder can be made");
    for (name, reason) in [
        ("missing.mcap", "No such file"),
        ("empty.mcap", "is empty"),
        ("text.mcap", "is not an MCAP file"),
        ("folder.mcap", "is a folder"),
    ] {
        let error = play(&path(name)).1.expect("it is no recording");
        assert_one_line(&error, &path(name));
        assert!(error.to_string().contains(reason), "{error}");

        let error = recover(&path(name), &path("new.mcap")).expect_err("nothing to recover");
        assert_one_line(&error, &path(name));
        assert!(error.to_string().contains(reason), "{error}");
        assert!(!path("new.mcap").exists());
    }
}

#[test]
fn places_where_nothing_can_be_recorded_are_refused_in_one_line() {
    let folder = folder();
    let info = info(PixelFormat::Grey, SIZE, false);
    let create = |path: &Path| {
        let recorder = Recorder::create(path, &info, &provenance(), ImageMode::Lossless);
        let error = recorder.map(drop).expect_err("it cannot be created");
        assert_one_line(&error, path);
        error
    };
    let existing = folder.path().join("old.mcap");
    fs::write(&existing, b"precious").expect("the file can be written");
    assert!(matches!(create(&existing), RecordError::Exists { .. }));
    assert_eq!(fs::read(&existing).expect("it is there"), b"precious");
    assert!(matches!(create(folder.path()), RecordError::Exists { .. }));

    let nowhere = folder.path().join("missing/run.mcap");
    assert!(matches!(
        create(&nowhere),
        RecordError::MissingFolder { .. }
    ));
    let below_a_file = existing.join("run.mcap");
    assert!(matches!(create(&below_a_file), RecordError::Create { .. }));

    let run = folder.path().join("run.mcap");
    record(&run, &info, &slots(PixelFormat::Grey, 2, 0));
    for output in [&existing, &run] {
        let error = recover(&run, output).expect_err("the output exists");
        assert!(
            matches!(error, RecoverError::Output(RecordError::Exists { .. })),
            "{error}"
        );
    }
    assert_eq!(play(&run).0.len(), 2);
}
