//! What survives a crash, truncation and damage.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use overcam::image::frame::PixelFormat;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::record::{FLUSH_INTERVAL_NS, Recorder};
use overcam::output::mcap::recover::recover;
use overcam::source::replay::{After, Recording, ReplayError};
use proptest::prelude::*;

use crate::fixture::{
    EVENTFUL, PERIOD_NS, Played, SIZE, assert_one_line, folder, info, play, provenance, slot, slots,
};

#[test]
fn the_file_never_lags_by_more_than_the_flush_interval() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let copy = folder.path().join("copy.mcap");
    let info = info(PixelFormat::Yuyv, SIZE, true);
    let mut recorder = Recorder::create(&path, &info, &provenance(), ImageMode::Lossless)
        .expect("it can be created");
    for slot in &slots(PixelFormat::Yuyv, 50, 5_000_000_000) {
        recorder.write(slot).expect("the frame can be written");
        fs::copy(&path, &copy).expect("the file can be copied");
        let (frames, error) = play(&copy);
        let newest = frames.last().expect("the first frame is there at once");
        assert!(slot.frame.stamp_ns - newest.stamp_ns < FLUSH_INTERVAL_NS);
        assert_eq!(recorder.written().frames, frames.len() as u64);
        match error {
            Some(ReplayError::Truncated { after, .. }) => {
                assert_eq!(after, After(Some(newest.sequence)));
            }
            other => panic!("{other:?}"),
        }
    }
}

/// The file to write, for [`records_until_it_is_killed`].
const KILLED_FILE: &str = "OVERCAM_TEST_KILLED_FILE";

#[test]
fn a_killed_process_loses_less_than_the_flush_interval() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let mut child = Command::new(std::env::current_exe().expect("this program has a path"))
        .args(["--exact", "damage::records_until_it_is_killed"])
        .args(["--ignored", "--nocapture"])
        .env(KILLED_FILE, &path)
        .stdout(Stdio::piped())
        .spawn()
        .expect("this program can be run");
    let output = child.stdout.take().expect("the output is piped");
    let mut written = BufReader::new(output)
        .lines()
        .map_while(Result::ok)
        .filter_map(|line| line.strip_prefix("written ")?.parse::<u64>().ok());
    assert!(written.any(|sequence| sequence == 100), "the child records");
    child.kill().expect("the child can be killed");
    let newest_written = written.last().unwrap_or(100);
    child.wait().expect("the child has ended");

    let (frames, error) = play(&path);
    assert!(
        matches!(error, Some(ReplayError::Truncated { .. })),
        "{error:?}"
    );
    let newest = frames.last().expect("there are frames").sequence;
    let lost_ns = newest_written.saturating_sub(newest) * PERIOD_NS;
    assert!(lost_ns < FLUSH_INTERVAL_NS, "lost {lost_ns} ns");

    let recovered = folder.path().join("recovered.mcap");
    let report = recover(&path, &recovered).expect("the file can be completed");
    assert_eq!((report.images, report.damaged), (frames.len() as u64, 0));
}

#[test]
#[ignore = "is run by a_killed_process_loses_less_than_the_flush_interval"]
fn records_until_it_is_killed() {
    let Some(path) = std::env::var_os(KILLED_FILE) else {
        return;
    };
    let info = info(PixelFormat::Grey, SIZE, true);
    let mut recorder =
        Recorder::create(Path::new(&path), &info, &provenance(), ImageMode::Lossless)
            .expect("it can be created");
    for sequence in 0.. {
        let slot = slot(PixelFormat::Grey, SIZE, sequence, sequence * PERIOD_NS);
        recorder.write(&slot).expect("the frame can be written");
        println!("written {sequence}");
    }
}

#[test]
fn a_cut_recording_plays_up_to_the_cut_and_can_be_completed() {
    let folder = folder();
    let (content, recorded) = &*EVENTFUL;
    let cut = folder.path().join("cut.mcap");
    let recovered = folder.path().join("recovered.mcap");
    let mut most_frames = 0;
    // Every length near both ends, where the records are small, and every 499th in between.
    let lengths = (0..content.len()).filter(|&length| {
        length < 200 || content.len() - length < 200 || length.is_multiple_of(499)
    });
    for length in lengths {
        fs::write(&cut, &content[..length]).expect("the cut file can be written");
        let (frames, error) = play(&cut);
        assert!(recorded.starts_with(&frames), "cut to {length} bytes");
        assert!(frames.len() >= most_frames, "cut to {length} bytes");
        most_frames = frames.len();
        match &error {
            None => assert_eq!(frames.len(), recorded.len(), "cut to {length} bytes"),
            Some(ReplayError::Open { .. }) => assert_eq!(length, 0),
            Some(ReplayError::Truncated { after, .. }) => {
                assert_eq!(after.0, frames.last().map(|frame| frame.sequence));
            }
            Some(other) => panic!("cut to {length} bytes: {other}"),
        }
        if length == 0 {
            continue;
        }
        let report = recover(&cut, &recovered).expect("the cut file can be completed");
        assert_eq!(report.images, frames.len() as u64);
        assert_eq!((report.complete, report.damaged), (error.is_none(), 0));
        if !frames.is_empty() {
            let (recovered_frames, error) = play(&recovered);
            assert!(error.is_none(), "{error:?}");
            assert!(recovered_frames == frames, "cut to {length} bytes");
        }
        fs::remove_file(&recovered).expect("the file can be removed");
    }
    assert_eq!(most_frames, recorded.len());
}

#[test]
fn a_recovered_recording_keeps_everything_around_a_damaged_chunk() {
    let folder = folder();
    let (mut content, recorded) = EVENTFUL.clone();
    let chunks = mcap::Summary::read(&content)
        .expect("the index can be read")
        .expect("there is an index")
        .chunk_indexes;
    assert!(chunks.len() >= 4, "{} chunks", chunks.len());
    let chunk = &chunks[2];
    let middle = chunk.chunk_start_offset + chunk.chunk_length / 2;
    content[middle as usize] ^= 0x10;
    let damaged = folder.path().join("damaged.mcap");
    fs::write(&damaged, &content).expect("the file can be written");

    let (frames, error) = play(&damaged);
    let n_before = frames.len();
    assert!(n_before > 0 && recorded.starts_with(&frames));
    let error = error.expect("damage is an error");
    assert!(matches!(error, ReplayError::Damaged { .. }), "{error}");
    assert_one_line(&error, &damaged);

    let recovered = folder.path().join("recovered.mcap");
    let report = recover(&damaged, &recovered).expect("the rest can be kept");
    assert!(report.complete);
    assert_eq!(report.damaged, 1);
    let (frames, error) = play(&recovered);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(report.images, frames.len() as u64);
    // Only the frame on which the colour range changes brings new definitions, and it is not in
    // this chunk.
    let n_lost = recorded.len() - frames.len();
    assert!(n_lost > 0);
    assert!(frames[..n_before] == recorded[..n_before]);
    assert!(frames[n_before..] == recorded[n_before + n_lost..]);
    let recording = Recording::open(&recovered).expect("the recording can be opened");
    assert_eq!(*recording.provenance(), provenance());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Damage is an error, or has no effect; it never results in a wrong pixel.
    #[test]
    fn damage_never_changes_a_pixel(damage in prop::collection::vec((any::<prop::sample::Index>(), 1_u8..), 1..4)) {
        let folder = folder();
        let (mut content, recorded) = EVENTFUL.clone();
        for (at, bits) in damage {
            let at = at.index(content.len());
            content[at] ^= bits;
        }
        let damaged = folder.path().join("damaged.mcap");
        fs::write(&damaged, &content).expect("the file can be written");
        let originals = |frames: &[Played]| {
            let mut recorded = recorded.iter();
            frames.iter().all(|frame| recorded.any(|original| original.bytes == frame.bytes))
        };
        prop_assert!(originals(&play(&damaged).0));
        let recovered = folder.path().join("recovered.mcap");
        if recover(&damaged, &recovered).is_ok() {
            prop_assert!(originals(&play(&recovered).0));
        }
    }
}
