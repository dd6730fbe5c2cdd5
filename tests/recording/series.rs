//! A recording in several files.

use std::fs;
use std::path::Path;

use overcam::image::frame::PixelFormat;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::record::{RecordError, Summary};
use overcam::output::mcap::series::{Limits, NextFile, Series};
use overcam::run::slot::Slot;
use overcam::source::replay::Recording;

use crate::fixture::{
    PERIOD_NS, Played, SIZE, assert_one_line, eventful_slots, floor, folder, info, play, played,
    provenance, slots,
};

const MINUTES: Limits = Limits {
    bytes: None,
    duration_ns: Some(10 * PERIOD_NS),
};

fn series(path: &Path, live: bool, limits: Limits) -> Result<Series, RecordError> {
    let info = info(PixelFormat::Yuyv, SIZE, live);
    Series::create(path, &info, &provenance(), ImageMode::Lossless, limits)
}

/// Records slots. Each brings the current floor, with its number as the seed, when the recorder
/// asks for it.
fn record(path: &Path, live: bool, limits: Limits, slots: &mut [Slot]) -> (Vec<NextFile>, Summary) {
    let mut series = series(path, live, limits).expect("it can be created");
    let mut next_files = Vec::new();
    for slot in slots {
        if series.is_due(slot) {
            slot.floor_in_use = Some(floor(1000 + slot.frame.sequence, SIZE));
        }
        next_files.extend(series.write(slot).expect("it can be written"));
    }
    (next_files, series.finish().expect("it can be finished"))
}

/// The slots' frames in the order of the files.
fn play_all(paths: &[std::path::PathBuf]) -> Vec<Vec<Played>> {
    let play_whole = |path: &std::path::PathBuf| {
        let (frames, error) = play(path);
        assert!(error.is_none(), "{error:?}");
        let recording = Recording::open(path).expect("it can be opened");
        assert_eq!(*recording.provenance(), provenance());
        frames
    };
    paths.iter().map(play_whole).collect()
}

#[test]
fn every_frame_is_in_one_file_and_every_file_begins_with_the_floor() {
    let folder = folder();
    for (live, first_ns) in [(false, 0), (true, 86_400_123_456_789)] {
        let path = folder.path().join(format!("{live}.mcap"));
        let mut slots = slots(PixelFormat::Yuyv, 35, first_ns);
        slots[0].background = Some(floor(100, SIZE));
        let (next_files, summary) = record(&path, live, MINUTES, &mut slots);
        let mut paths = vec![path.clone()];
        for (n, next) in (2..).zip(&next_files) {
            assert_eq!(next.path, folder.path().join(format!("{live}-{n}.mcap")));
            assert_eq!(next.finished, paths[n - 2]);
            assert_eq!((next.summary.frames, next.summary.missing), (10, 0));
            paths.push(next.path.clone());
        }
        assert_eq!(paths.len(), 4);
        let bytes = |path: &std::path::PathBuf| fs::metadata(path).expect("it is there").len();
        let expected = Summary {
            frames: 35,
            bytes: paths.iter().map(bytes).sum(),
            ..Summary::default()
        };
        assert_eq!(summary, expected);
        let mut expected: Vec<Played> = slots.iter().map(played).collect();
        for first in [10, 20, 30] {
            expected[first].background = Some(floor(1000 + first as u64, SIZE));
        }
        assert!(play_all(&paths).concat() == expected);
    }
}

#[test]
fn a_file_never_exceeds_its_maximum_size() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let mut slots = slots(PixelFormat::Yuyv, 900, 0);
    slots[0].background = Some(floor(100, SIZE));
    let max = 2_000_000;
    let limits = Limits {
        bytes: Some(max),
        duration_ns: None,
    };
    let (next_files, summary) = record(&path, false, limits, &mut slots);
    assert!(
        next_files.len() >= 2 && summary.frames == 900,
        "{summary:?}"
    );
    for next in &next_files {
        assert!(next.summary.bytes <= max);
        // The reserved space is for frames in flight and their results, not for most of the file.
        assert!(next.summary.frames > 1, "{next:?}");
    }
    // A limit too small for a single frame.
    let path = folder.path().join("tiny.mcap");
    let limits = Limits {
        bytes: Some(1),
        duration_ns: None,
    };
    let (next_files, summary) = record(&path, false, limits, &mut slots[..3]);
    assert_eq!((next_files.len(), summary.frames), (2, 3));
    assert!(next_files.iter().all(|next| next.summary.frames == 1));
}

#[test]
fn gaps_and_new_floors_at_a_border_are_reported_once() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    // Frame 20 has its own floor and is skipped; 5 frames are missing before frame 35.
    let mut slots = eventful_slots(PixelFormat::Yuyv, 0);
    let (next_files, summary) = record(&path, false, MINUTES, &mut slots);
    assert_eq!(
        (summary.frames, summary.skipped, summary.missing),
        (40, 2, 5)
    );
    let mut paths = vec![path];
    paths.extend(next_files.into_iter().map(|next| next.path));
    let files = play_all(&paths);
    let second = &files[2][0];
    assert_eq!((second.sequence, second.skipped), (20, true));
    assert_eq!(second.background, Some(floor(200, SIZE)));
    let after_gap = &files[3][0];
    assert_eq!(after_gap.sequence, 35);
    assert_eq!(after_gap.background, Some(floor(1035, SIZE)));
}

#[test]
fn without_a_floor_of_the_run_the_last_known_one_is_used() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let mut slots = slots(PixelFormat::Yuyv, 100, 0);
    slots[3].background = Some(floor(100, SIZE));
    let mut series = series(&path, false, MINUTES).expect("it can be created");
    let mut next_files = Vec::new();
    for slot in &mut slots {
        next_files.extend(series.write(slot).expect("it can be written"));
    }
    series.finish().expect("it can be finished");
    assert_eq!(next_files.len(), 1);
    let (frames, _) = play(&next_files[0].path);
    assert_eq!(frames[0].sequence, next_files[0].summary.frames);
    assert_eq!(frames[0].background, Some(floor(100, SIZE)));
}

#[test]
fn no_file_is_overwritten() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let beside = |name: &str| folder.path().join(name);
    // Files of an older series, and others with similar names.
    for name in [
        "run-02.mcap",
        "run-1.mcap",
        "run-x.mcap",
        "runs-2.mcap",
        "run-2.txt",
    ] {
        fs::write(beside(name), "old").expect("it can be written");
    }
    fs::write(beside("run-7.mcap"), "old").expect("it can be written");
    let refused = series(&path, false, MINUTES).err().expect("it is refused");
    assert_one_line(&refused, &beside("run-7.mcap"));
    assert!(!path.exists());
    // Without limits there will be no second file.
    drop(series(&beside("run-x2.mcap"), false, Limits::default()).expect("it can be created"));
    fs::remove_file(beside("run-7.mcap")).expect("it can be removed");

    let mut series = series(&path, false, MINUTES).expect("it can be created");
    fs::write(beside("run-2.mcap"), "new").expect("it can be written");
    let mut next_files = Vec::new();
    for slot in &mut slots(PixelFormat::Yuyv, 25, 0) {
        slot.floor_in_use = series.is_due(slot).then(|| floor(1, SIZE));
        next_files.extend(series.write(slot).expect("it can be written"));
    }
    series.finish().expect("it can be finished");
    let paths: Vec<_> = next_files.iter().map(|next| next.path.clone()).collect();
    assert_eq!(paths, [beside("run-3.mcap"), beside("run-4.mcap")]);
    assert_eq!(fs::read(beside("run-2.mcap")).expect("it is there"), b"new");
}

#[test]
fn a_next_file_that_cannot_be_created_ends_the_recording_but_keeps_the_written_files() {
    let folder = folder();
    let place = folder.path().join("place");
    fs::create_dir(&place).expect("the folder can be made");
    let path = place.join("run.mcap");
    let mut series = series(&path, false, MINUTES).expect("it can be created");
    let mut slots = slots(PixelFormat::Yuyv, 13, 0);
    let moved = folder.path().join("moved");
    for slot in &mut slots[..10] {
        series.write(slot).expect("it can be written");
    }
    fs::rename(&place, &moved).expect("the folder can be renamed");
    slots[10].floor_in_use = Some(floor(1, SIZE));
    let error = series
        .write(&mut slots[10])
        .expect_err("there is no folder");
    assert!(error.is_final(), "{error}");
    assert_one_line(&error, &place.join("run-2.mcap"));
    let stopped = series.write(&mut slots[11]).expect_err("it has ended");
    assert!(matches!(stopped, RecordError::Stopped { .. }));
    assert_eq!(series.written().frames, 10);
    assert!(series.finish().is_err());
    let (frames, error) = play(&moved.join("run.mcap"));
    assert!(error.is_none() && frames.len() == 10, "{error:?}");
}
