//! Recorded data can be read back.

use std::fs;

use overcam::image::frame::{Frame, Picture, PixelFormat, decode};
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::record::{Recorder, Summary};
use overcam::run::slot::SourceInfo;
use overcam::source::replay::Recording;

use crate::fixture::{
    Played, SIZE, eventful_slots, folder, info, play, played, provenance, record, slots,
};

#[test]
fn every_stored_format_is_restored_exactly() {
    let folder = folder();
    for format in [
        PixelFormat::Grey,
        PixelFormat::Rgb,
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Nv12,
        PixelFormat::Jpeg,
    ] {
        // A camera's stamps count from its start, and are converted to the wall clock and back.
        for (live, first_ns) in [(false, 0), (true, 86_400_123_456_789)] {
            let path = folder.path().join(format!("{format:?}-{live}.mcap"));
            let slots = eventful_slots(format, first_ns);
            let summary = record(&path, &info(format, SIZE, live), &slots);
            let bytes = fs::metadata(&path).expect("the file is there").len();
            let expected = Summary {
                frames: 40,
                skipped: 2,
                missing: 5,
                bytes,
            };
            assert_eq!(summary, expected);

            let (frames, error) = play(&path);
            assert!(error.is_none(), "{error:?}");
            let recorded: Vec<Played> = slots.iter().map(played).collect();
            assert!(frames == recorded, "{format:?}, live: {live}");
        }
    }
}

#[test]
fn planar_formats_are_restored_as_the_colours_that_the_pipeline_sees() {
    let folder = folder();
    for format in [PixelFormat::I420, PixelFormat::I422, PixelFormat::I444] {
        let path = folder.path().join(format!("{format:?}.mcap"));
        let slots = eventful_slots(format, 0);
        record(&path, &info(format, SIZE, false), &slots);
        let recording = Recording::open(&path).expect("the recording can be opened");
        assert_eq!(recording.info().format, PixelFormat::Rgb);
        let (frames, _) = play(&path);
        assert_eq!(frames.len(), slots.len());
        for (frame, slot) in frames.iter().zip(&slots) {
            let mut colours = Picture::new(SIZE);
            decode(&slot.frame, &mut colours).expect("the frame has colours");
            let planes = colours.red.iter().zip(&colours.green).zip(&colours.blue);
            let rgb: Vec<u8> = planes.flat_map(|((r, g), b)| [*r, *g, *b]).collect();
            assert!(frame.bytes == rgb, "{format:?} {}", frame.sequence);
            assert_eq!(frame.full_range, slot.frame.full_range);
        }
    }
}

#[test]
fn a_recording_contains_its_settings() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    record(
        &path,
        &info(PixelFormat::Yuyv, SIZE, true),
        &slots(PixelFormat::Yuyv, 1, 0),
    );
    let recording = Recording::open(&path).expect("the recording can be opened");
    assert_eq!(*recording.provenance(), provenance());
    let expected = SourceInfo {
        name: path.display().to_string(),
        ..info(PixelFormat::Yuyv, SIZE, false)
    };
    assert_eq!(recording.info(), expected);
}

#[test]
fn a_recording_without_frames_is_one() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    record(&path, &info(PixelFormat::I420, SIZE, false), &[]);
    let recording = Recording::open(&path).expect("the recording can be opened");
    assert_eq!(recording.info().size, SIZE);
    assert_eq!(recording.info().format, PixelFormat::Rgb);
    assert!(matches!(play(&path), (frames, None) if frames.is_empty()));
}

#[test]
fn the_same_frames_give_the_same_file() {
    let folder = folder();
    let files = ["a.mcap", "b.mcap"].map(|name| {
        let path = folder.path().join(name);
        let slots = eventful_slots(PixelFormat::Nv12, 0);
        record(&path, &info(PixelFormat::Nv12, SIZE, false), &slots);
        fs::read(path).expect("the file can be read")
    });
    assert!(files[0] == files[1]);
}

#[test]
fn jpeg_keeps_all_but_the_exact_colours() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let mut slots = slots(PixelFormat::Yuyv, 3, 7);
    for slot in &mut slots {
        slot.frame.bytes.fill(128);
    }
    let info = info(PixelFormat::Yuyv, SIZE, false);
    let mode = ImageMode::Jpeg { quality: 90 };
    let mut recorder =
        Recorder::create(&path, &info, &provenance(), mode).expect("it can be created");
    for slot in &slots {
        recorder.write(slot).expect("the frame can be written");
    }
    recorder.finish().expect("it can be finished");
    let (frames, error) = play(&path);
    assert!(error.is_none(), "{error:?}");
    for (read, slot) in frames.iter().zip(&slots) {
        assert_eq!(read.format, PixelFormat::Jpeg);
        assert_eq!(
            (read.sequence, read.stamp_ns),
            (slot.frame.sequence, slot.frame.stamp_ns)
        );
        let mut colours = Picture::new(SIZE);
        let jpeg = Frame {
            format: read.format,
            size: read.size,
            bytes: read.bytes.clone(),
            ..Frame::empty()
        };
        decode(&jpeg, &mut colours).expect("the JPEG picture is whole");
        // Luma 128 of the limited range 16 to 235 is 130 of 255.
        assert!(colours.red.iter().all(|red| red.abs_diff(130) <= 1));
    }
}

#[test]
fn one_unusable_frame_does_not_end_a_recording() {
    let folder = folder();
    let path = folder.path().join("run.mcap");
    let info = info(PixelFormat::Yuyv, SIZE, false);
    let mut recorder = Recorder::create(&path, &info, &provenance(), ImageMode::Lossless)
        .expect("it can be created");
    let mut slots = slots(PixelFormat::Yuyv, 3, 0);
    slots[1].frame.bytes.pop();
    for (i, slot) in slots.iter().enumerate() {
        let result = recorder.write(slot);
        assert_eq!(result.is_err(), i == 1);
        if let Err(error) = result {
            assert!(!error.is_final());
            assert!(error.to_string().starts_with("frame 1 "), "{error}");
        }
    }
    let summary = recorder.finish().expect("it can be finished");
    assert_eq!((summary.frames, summary.missing), (2, 1));
    let (frames, error) = play(&path);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(frames, [played(&slots[0]), played(&slots[2])]);
}
