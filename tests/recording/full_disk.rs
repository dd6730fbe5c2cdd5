//! A disk that is full during the run, at the end, and from the start.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Command;

use overcam::image::frame::PixelFormat;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::record::{RecordError, Recorder};
use overcam::source::replay::ReplayError;

use crate::fixture::{
    Played, SIZE, assert_one_line, folder, info, play, played, provenance, slots,
};

/// A folder on a small disk, for [`on_a_small_disk`].
const SMALL_DISK: &str = "OVERCAM_TEST_SMALL_DISK";

#[test]
fn a_full_disk_ends_a_recording_in_one_line() {
    let folder = folder();
    let on_small_disk = |command: &str| {
        Command::new("unshare")
            .args(["--user", "--map-root-user", "--mount", "sh", "-c"])
            .arg(format!(
                "mount -t tmpfs -o size=1m overcam-test \"$0\" && {command}"
            ))
            .arg(folder.path())
            .arg(std::env::current_exe().expect("this program has a path"))
            .env(SMALL_DISK, folder.path())
            .output()
    };
    if !on_small_disk("true").is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no small disk can be mounted here (needs unshare and user namespaces)");
        return;
    }
    let output =
        on_small_disk("exec \"$1\" --exact full_disk::on_a_small_disk --ignored --nocapture")
            .expect("this program can be run");
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}{errors}");
    assert!(text.contains("1 passed"), "{text}{errors}");
}

#[test]
#[ignore = "is run by a_full_disk_ends_a_recording_in_one_line"]
fn on_a_small_disk() {
    let Some(folder) = std::env::var_os(SMALL_DISK) else {
        return;
    };
    let folder = Path::new(&folder);
    let info = info(PixelFormat::Grey, SIZE, false);
    let create = |name: &str| {
        Recorder::create(
            &folder.join(name),
            &info,
            &provenance(),
            ImageMode::Lossless,
        )
    };

    // Full during the run.
    let mut recorder = create("a.mcap").expect("there is room for the start");
    let slots = slots(PixelFormat::Grey, 2_000, 0);
    let error = slots
        .iter()
        .find_map(|slot| recorder.write(slot).err())
        .expect("6 MB do not fit into 1 MiB");
    assert!(error.is_final());
    assert_one_line(&error, &folder.join("a.mcap"));
    let RecordError::DiskFull { frames, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(recorder.written().frames, frames);
    assert!(matches!(
        recorder.write(&slots[0]),
        Err(RecordError::Stopped { .. })
    ));
    assert!(matches!(
        recorder.finish(),
        Err(RecordError::Stopped { .. })
    ));
    let assert_holds = |name: &str, n_frames: usize| {
        let (played_frames, error) = play(&folder.join(name));
        let recorded: Vec<Played> = slots[..n_frames].iter().map(played).collect();
        assert!(played_frames == recorded, "{} frames", played_frames.len());
        assert!(
            matches!(error, Some(ReplayError::Truncated { .. })),
            "{error:?}"
        );
    };
    assert!(frames > 100, "{frames} frames of 3 kB");
    assert_holds("a.mcap", frames as usize);

    // Full at the end.
    fs::remove_file(folder.join("a.mcap")).expect("the file can be removed");
    let mut recorder = create("b.mcap").expect("there is room again");
    for slot in &slots[..5] {
        recorder.write(slot).expect("there is room for some frames");
    }
    let mut filler = fs::File::create(folder.join("filler")).expect("there is room for a file");
    while filler.write_all(&[0; 512]).is_ok() {}
    let error = recorder
        .finish()
        .expect_err("there is no room for the rest");
    assert!(
        matches!(error, RecordError::DiskFull { frames: 1, .. }),
        "{error}"
    );
    assert_holds("b.mcap", 1);

    // Full from the start: no file is left.
    let error = create("c.mcap").map(drop).expect_err("there is no room");
    assert!(
        matches!(error, RecordError::DiskFull { frames: 0, .. }),
        "{error}"
    );
    assert!(!folder.join("c.mcap").exists());
}
